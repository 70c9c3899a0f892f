"""Random forests, as Ta, Balli Altuglu and Gaus used in 2015, and extremely randomised trees."""

from sklearn.base import ClassifierMixin, TransformerMixin
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.models.space import Range


def rf(
    features: TransformerMixin, trees: int = 500, leaf: int = 1, tried: float = 0.0, seed: int = 0
) -> Pipeline:
    """Random forest on the raw features.

    Args:
        features: transformer from captures to a table.
        trees: number of trees. Default: our reading of the systems of 2015, most of which do not
            state it.
        leaf: fewest captures in a leaf. Default: that of scikit-learn.
        tried: share of the features that is tried at each split; 0 for the square root of their
            number. Default: that of scikit-learn.
        seed: random seed of the bootstrap and the tried features.
    """
    return _make_pipeline(RandomForestClassifier, features, trees, leaf, tried, seed)


def et(
    features: TransformerMixin, trees: int = 500, leaf: int = 1, tried: float = 0.0, seed: int = 0
) -> Pipeline:
    """Extremely randomised trees on the raw features.

    They are no paper's system.

    Args:
        features: transformer from captures to a table.
        trees: number of trees. Default: that of rf.
        leaf: fewest captures in a leaf. Default: that of scikit-learn.
        tried: share of the features that is tried at each split; 0 for the square root of their
            number. Default: that of scikit-learn.
        seed: random seed of the tried features and splits.
    """
    return _make_pipeline(ExtraTreesClassifier, features, trees, leaf, tried, seed)


def _make_pipeline(
    kind: type[ClassifierMixin],
    features: TransformerMixin,
    trees: int,
    leaf: int,
    tried: float,
    seed: int,
) -> Pipeline:
    check_value("model.trees", trees, trees >= 1, "at least 1")
    check_value("model.leaf", leaf, leaf >= 1, "at least 1")
    check_value("model.tried", tried, 0 <= tried <= 1, "a share from 0 to 1")
    forest = kind(trees, min_samples_leaf=leaf, max_features=tried or "sqrt", random_state=seed)
    return Pipeline([("features", features), ("classifier", forest)])


rf.space = et.space = {"leaf": Range(1, 8, log=True), "tried": Range(0.02, 0.5, log=True)}
