"""AdaBoost on small trees (one of the classifiers of Gaus et al. 2015)."""

from sklearn.base import TransformerMixin
from sklearn.ensemble import AdaBoostClassifier
from sklearn.pipeline import Pipeline
from sklearn.tree import DecisionTreeClassifier

from bench.errors import check_value
from bench.models.space import Range


def boost(features: TransformerMixin, rounds: int = 300, depth: int = 8, seed: int = 0) -> Pipeline:
    """AdaBoost (SAMME) of decision trees on the raw features.

    Gaus et al. 2015 used a multi-class boosting package and do not state its trees and rounds. Each
    split tries the square root of the number of features, which makes 300 rounds on 1382 features
    affordable.

    Args:
        features: transformer from captures to a table.
        rounds: number of trees. Default: our reading.
        depth: largest depth of a tree. Default: our reading.
        seed: random seed of the tried features.
    """
    check_value("model.rounds", rounds, rounds >= 1, "at least 1")
    check_value("model.depth", depth, depth >= 1, "at least 1")
    tree = DecisionTreeClassifier(max_depth=depth, max_features="sqrt")
    boosted = AdaBoostClassifier(tree, n_estimators=rounds, random_state=seed)
    return Pipeline([("features", features), ("classifier", boosted)])


boost.space = {"rounds": Range(100, 500), "depth": Range(2, 12)}
