"""Linear discriminants on a feature set, for captures or for windows of captures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import softmax
from sklearn.base import BaseEstimator, ClassifierMixin, TransformerMixin
from sklearn.pipeline import Pipeline

from bench.errors import InputError
from bench.features.base import capture_of_rows, is_constant, undamaged_rows
from bench.models.by_person import PerPersonPipeline
from bench.models.space import Range


@dataclass(frozen=True)
class TrainingStatistics:
    """Statistics of the training rows of `Discriminants`, which further rows can update.

    Attributes:
        mean, sd: mean and SD of the features [features]; all that follows is in these units.
        centres: means of the classes [classes, features].
        heavy: weight of the rows of each class [classes].
        scatter: scatter of the rows about the means of their classes [features, features].
    """

    mean: np.ndarray
    sd: np.ndarray
    centres: np.ndarray
    heavy: np.ndarray
    scatter: np.ndarray


@dataclass(frozen=True)
class RowSummary:
    """Statistics of some training rows of `Discriminants`, in units of the features; those of several parts add up.

    Attributes:
        classes: names of their classes [classes].
        heavy: weight of the rows of each class [classes].
        centres: means of the classes [classes, features].
        scatter: scatter of the rows about the means of their classes [features, features].
        squares: sums of squares about the means of the classes [features].
        low, high: least and largest values [features].
    """

    classes: np.ndarray
    heavy: np.ndarray
    centres: np.ndarray
    scatter: np.ndarray
    squares: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(eq=False, repr=False)
class Discriminants(ClassifierMixin, BaseEstimator):
    """Gaussian classes with one covariance, shrunk towards a multiple of the identity after standardisation.

    Rows that come from one capture (``capture`` of the index of a `pandas.DataFrame`) share what is particular to it. A
    label that is taken from n of them sees a mean whose covariance is that between captures plus one n-th of that
    within them; ``windows`` is this n, as far as windows that overlap are independent. With 1, or one row per capture,
    these are the usual linear discriminants. Classes count alike, however many captures they have.

    Args:
        shrinkage: shrinkage of the covariance, 0 to 1.
        windows: number of windows that decide on a label together.
        damaged: weight of a row of a damaged copy (``copy`` of the index is above 0); others count 1.

    Attributes:
        classes_: class names.
        coef_: [classes, features], of the features as they are given.
        intercept_: [classes].
        learnt_: statistics of the training rows.
    """

    shrinkage: float = 0.2
    windows: float = 1.0
    damaged: float = 1.0

    def fit(self, X: pd.DataFrame | np.ndarray, y: np.ndarray) -> Discriminants:
        """Learn from features [rows, n_features] and class names [rows]."""
        self.classes_, codes = np.unique(y, return_inverse=True)
        Z = np.asarray(X, dtype=np.float64)
        self.n_features_in_ = Z.shape[1]
        captures, weight = capture_of_rows(X), np.where(undamaged_rows(X), 1.0, self.damaged)
        mean = weight @ Z / weight.sum()
        sd = np.sqrt(weight @ (Z - mean) ** 2 / weight.sum())
        sd[is_constant(Z)] = np.inf
        Z = (Z - mean) / sd
        centres, heavy = mean_by_code(Z, codes, weight)
        Z -= centres[codes]
        self.learnt_ = TrainingStatistics(
            mean, sd, centres, heavy, self.weighted_scatter(Z, captures, weight)
        )
        self.solve_coefficients(weight.sum())
        return self

    def summarise_rows(self, X: pd.DataFrame, y: np.ndarray) -> RowSummary:
        """What `fit_summaries` needs of some rows of training."""
        classes, codes = np.unique(y, return_inverse=True)
        Z = np.asarray(X, dtype=np.float64)
        captures, weight = capture_of_rows(X), np.where(undamaged_rows(X), 1.0, self.damaged)
        low, high = Z.min(axis=0), Z.max(axis=0)
        centres, heavy = mean_by_code(Z, codes, weight)
        Z = Z - centres[codes]
        return RowSummary(
            classes,
            heavy,
            centres,
            self.weighted_scatter(Z, captures, weight),
            weight @ Z**2,
            low,
            high,
        )

    def fit_summaries(self, parts: Sequence[RowSummary]) -> Discriminants:
        """`fit` to the rows of several parts, which share no capture: equal but for rounding."""
        self.classes_, codes = np.unique(
            np.concatenate([part.classes for part in parts]), return_inverse=True
        )
        every, weight = (
            np.concatenate([part.centres for part in parts]),
            np.concatenate([part.heavy for part in parts]),
        )
        self.n_features_in_ = every.shape[1]
        centres, heavy = mean_by_code(every, codes, weight)
        apart = every - centres[codes]
        mean = heavy @ centres / heavy.sum()
        squares = (
            sum(part.squares for part in parts) + weight @ apart**2 + heavy @ (centres - mean) ** 2
        )
        sd = np.sqrt(squares / heavy.sum())
        sd[
            is_constant(np.stack([*(part.low for part in parts), *(part.high for part in parts)]))
        ] = np.inf
        scatter = self.windows * (apart.T * weight) @ apart
        for part in parts:
            scatter += part.scatter
        self.learnt_ = TrainingStatistics(
            mean, sd, (centres - mean) / sd, heavy, scatter / sd[:, None] / sd
        )
        self.solve_coefficients(heavy.sum())
        return self

    def weighted_scatter(
        self, Z: np.ndarray, captures: np.ndarray, weight: np.ndarray
    ) -> np.ndarray:
        """Of rows about the centres of their classes, what is particular to a capture counting more by ``windows``."""
        scatter = (Z.T * weight) @ Z
        if self.windows == 1:
            return scatter
        means, heavy = mean_by_code(Z, captures, weight)
        return scatter + (self.windows - 1) * (means.T * heavy) @ means

    def solve_coefficients(self, total: float) -> None:
        """Coefficients from what was learnt of rows with a total weight."""
        learnt = self.learnt_
        scatter = learnt.scatter / total
        size = np.trace(scatter) / len(scatter)
        scatter *= 1 - self.shrinkage
        scatter[np.diag_indices(len(scatter))] += self.shrinkage * size + 1e-9
        coef = np.linalg.solve(scatter, learnt.centres.T).T
        self.coef_ = coef / learnt.sd
        self.intercept_ = -0.5 * (coef * learnt.centres).sum(axis=1) - self.coef_ @ learnt.mean

    @property
    def constants_(self) -> int:
        """Mean and SD of the features: in single precision they must be measured from these before they are weighed."""
        return 2 * self.n_features_in_

    def decision_function(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Log density of each class, up to a common constant [rows, classes]."""
        return np.asarray(X, dtype=np.float64) @ self.coef_.T + self.intercept_

    def predict_proba(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [rows, classes]."""
        return softmax(self.decision_function(X), axis=1)

    def predict(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class names [rows]."""
        return self.classes_[self.decision_function(X).argmax(axis=1)]


def mean_by_code(
    values: np.ndarray, codes: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean of the rows of each code [codes, n], and the sum of their weights."""
    order = np.argsort(codes, kind="stable")
    first = np.flatnonzero(np.diff(codes[order], prepend=-1))
    heavy = np.add.reduceat(weight[order], first)
    return np.add.reduceat(values[order] * weight[order][:, None], first) / heavy[:, None], heavy


def lda(
    features: TransformerMixin, shrinkage: float = 0.2, windows: float = 1.0, damaged: float = 1.0
) -> Pipeline:
    """Linear discriminants: a Gaussian for each class with one covariance, shrunk towards a multiple of the identity.

    Features are standardised on the training captures. All classes have the same prior.

    Args:
        features: transformer from captures to a table.
        shrinkage: shrinkage of the covariance, 0 to 1. Default: ours, from the design of reflex on seven of HAART's
            people.
        windows: number of windows that decide on a label together; the covariance between captures counts so many
            times more than that within them. Default: linear discriminants as usual.
        damaged: weight of a damaged copy of a capture (model.faults=). Default: each copy counts as its capture.

    Raises:
        InputError: a shrinkage, a number of windows or a weight that cannot be.
    """
    if not 0 <= shrinkage <= 1:
        raise InputError(f"model.shrinkage={shrinkage:g}: give 0 to 1")
    if not 1 <= windows < float("inf"):
        raise InputError(f"model.windows={windows:g}: give 1 or more")
    if not 0 < damaged < float("inf"):
        raise InputError(f"model.damaged={damaged:g}: give a number above 0")
    return PerPersonPipeline(
        [("features", features), ("classifier", Discriminants(shrinkage, windows, damaged))]
    )


lda.space = {"shrinkage": Range(1e-3, 1, log=True), "windows": Range(1, 8, log=True)}
