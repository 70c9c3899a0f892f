"""Random forest, the classifier of Ta, Balli Altuglu and Gaus in the 2015 challenge."""

from sklearn.base import TransformerMixin
from sklearn.ensemble import RandomForestClassifier
from sklearn.pipeline import Pipeline

from bench.corpus import InputError


def rf(features: TransformerMixin, trees: int = 500, leaf: int = 1, seed: int = 0) -> Pipeline:
    """Trees on the raw features, square root of their number tried at each split.

    Args:
        features: transformer from captures to a table.
        trees: number of trees.
        leaf: fewest captures in a leaf.
        seed: of the bootstrap and the tried features.

    Raises:
        InputError: a count below 1.
    """
    if trees < 1 or leaf < 1:
        raise InputError(f"model.trees={trees} model.leaf={leaf}: give at least 1")
    forest = RandomForestClassifier(trees, min_samples_leaf=leaf, random_state=seed)
    return Pipeline([("features", features), ("classifier", forest)])
