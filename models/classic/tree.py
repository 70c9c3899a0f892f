"""One decision tree, pruned (Jung et al. 2017, section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline
from sklearn.tree import DecisionTreeClassifier

from bench.errors import check_value
from bench.models.most_probable import MostProbable


@dataclass(eq=False, repr=False)
class PrunedTree(MostProbable):
    """CART with Gini impurity, grown in full and pruned along its cost-complexity sequence.

    One step cuts all links that are equally weak; the first one also cuts those that cost nothing.
    Pruning stops before there are fewer leaves than classes: the trees of separable classes have
    few steps, and a root alone would predict one class.
    """

    level: int = 10
    seed: int = 0

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> PrunedTree:
        """Grow and prune on features [captures, n_features] and class names [captures]."""
        X = np.asarray(X)
        self.n_features_in_ = X.shape[1]
        full_tree = DecisionTreeClassifier(random_state=self.seed)
        alphas = np.maximum(full_tree.cost_complexity_pruning_path(X, y).ccp_alphas, 0)
        # scikit-learn lists equally weak links one by one, with penalties that differ by rounding
        step_alphas = alphas[np.append(np.diff(alphas) > 1e-9, True)]
        for alpha in step_alphas[min(self.level, len(step_alphas) - 1) :: -1]:
            self.tree_ = DecisionTreeClassifier(random_state=self.seed, ccp_alpha=alpha).fit(X, y)
            self.classes_ = self.tree_.classes_
            if self.tree_.get_n_leaves() >= len(self.classes_):
                break
        return self

    def predict_proba(self, X: pd.DataFrame) -> np.ndarray:
        """Shares of the classes in the leaf [captures, classes]."""
        return self.tree_.predict_proba(np.asarray(X))


def tree(features: TransformerMixin, level: int = 10, seed: int = 0) -> Pipeline:
    """Decision tree (CART, Gini) on raw features, grown in full and pruned by cost-complexity.

    Args:
        features: transformer from captures to a table.
        level: steps of the pruning sequence that are taken; 0 leaves the full tree. Pruning stops
            before there are fewer leaves than gestures. Default: our reading; Jung et al. 2017
            search the level.
        seed: random seed of the order in which equal splits are tried.
    """
    check_value("model.level", level, level >= 0, "a number from 0 on")
    return Pipeline([("features", features), ("classifier", PrunedTree(level, seed))])


tree.space = {"level": [5, 10, 15, 20, 25, 30]}
