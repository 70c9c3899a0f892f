"""Boosted trees (XGBoost) on a feature set: the usual strong baseline on tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.models.most_probable import MostProbable
from bench.models.space import Range


@dataclass(eq=False, repr=False)
class BoostedTrees(MostProbable):
    """`xgboost.XGBClassifier` for class names, which xgboost does not accept."""

    trees: int = 300
    depth: int = 4
    rate: float = 0.1
    seed: int = 0

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> BoostedTrees:
        """Boost on features [captures, n_features] and class names [captures]."""
        from xgboost import XGBClassifier

        self.n_features_in_ = np.shape(X)[1]
        self.classes_, codes = np.unique(y, return_inverse=True)
        self.booster_ = XGBClassifier(
            n_estimators=self.trees,
            max_depth=self.depth,
            learning_rate=self.rate,
            subsample=0.8,
            colsample_bytree=0.8,
            tree_method="hist",
            random_state=self.seed,
        ).fit(np.asarray(X), codes)
        return self

    def predict_proba(self, X: pd.DataFrame) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        return self.booster_.predict_proba(np.asarray(X))


def xgb(
    features: TransformerMixin, trees: int = 300, depth: int = 4, rate: float = 0.1, seed: int = 0
) -> Pipeline:
    """Boosted trees (XGBoost) on the raw features.

    They are no paper's system. Each tree uses 80 % of the captures and 80 % of the features; splits
    use histograms.

    Args:
        features: transformer from captures to a table.
        trees: boosting rounds. Default: ours.
        depth: largest depth of a tree. Default: ours.
        rate: learning rate. Default: ours.
        seed: random seed of the samples of captures and features.
    """
    check_value("model.trees", trees, trees >= 1, "at least 1")
    check_value("model.depth", depth, depth >= 1, "at least 1")
    check_value("model.rate", rate, rate > 0, "a value above 0")
    boosted = BoostedTrees(trees, depth, rate, seed)
    return Pipeline([("features", features), ("classifier", boosted)])


xgb.space = {"trees": Range(100, 600), "depth": Range(1, 6), "rate": Range(0.02, 0.3, log=True)}
