"""Linear discriminants on a feature set, for captures or for windows of captures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import softmax
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.features.base import capture_of_rows, is_constant, undamaged_rows
from bench.models.by_person import PerPersonPipeline
from bench.models.most_probable import MostProbable
from bench.models.space import Range


@dataclass(frozen=True)
class TrainingStatistics:
    """Statistics of all training rows of `Discriminants`, which the people add-on updates.

    Attributes:
        mean, sd: mean and SD of the features [features]; the following ones are of standardised
            features.
        class_means: means of the classes [classes, features].
        weights: total weight of the rows of each class [classes].
        scatter: scatter of the rows about the means of their classes [features, features].
    """

    mean: np.ndarray
    sd: np.ndarray
    class_means: np.ndarray
    weights: np.ndarray
    scatter: np.ndarray


@dataclass(frozen=True)
class RowSummary:
    """Statistics of some training rows of `Discriminants`, in the units of the features.

    Attributes:
        classes: names of their classes [classes].
        weights: total weight of the rows of each class [classes].
        class_means: means of the classes [classes, features].
        scatter: scatter of the rows about the means of their classes [features, features].
        squares: sums of squares about the means of the classes [features].
        minimum, maximum: extreme values [features].
    """

    classes: np.ndarray
    weights: np.ndarray
    class_means: np.ndarray
    scatter: np.ndarray
    squares: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray


@dataclass(eq=False, repr=False)
class Discriminants(MostProbable):
    """Gaussian classes with one covariance, shrunk towards a multiple of the identity.

    Rows of one capture (``capture`` of the index of a `pandas.DataFrame`) are not independent. The
    mean of n of them has the covariance between captures plus one n-th of the covariance within
    captures; ``windows`` is this n, which is smaller than the number of overlapping windows. With
    1, or with one row per capture, these are the usual linear discriminants. All classes have the
    same prior.

    Args:
        shrinkage: shrinkage of the covariance, 0 to 1.
        windows: number of windows that decide on a label together.
        damaged: weight of a row of a damaged copy (``copy`` of the index is above 0); others count
            1.

    Attributes:
        classes_: class names.
        coef_: [classes, features], of features that are not standardised.
        intercept_: [classes].
        learnt_: statistics of the training rows.
    """

    shrinkage: float = 0.2
    windows: float = 1.0
    damaged: float = 1.0

    def fit(self, X: pd.DataFrame | np.ndarray, y: np.ndarray) -> Discriminants:
        """Learn from features [rows, n_features] and class names [rows]."""
        self.classes_, codes = np.unique(y, return_inverse=True)
        Z = np.array(X, dtype=np.float64)  # a copy, changed in place to save memory
        self.n_features_in_ = Z.shape[1]
        row_weights = np.where(undamaged_rows(X), 1.0, self.damaged)
        mean = row_weights @ Z / row_weights.sum()
        constant = is_constant(Z)
        Z -= mean
        sd = np.sqrt(row_weights @ Z**2 / row_weights.sum())
        sd[constant] = np.inf
        Z /= sd
        class_means, weights = mean_by_code(Z, codes, row_weights)
        Z -= class_means[codes]
        scatter = self.weighted_scatter(Z, capture_of_rows(X), row_weights)
        self.learnt_ = TrainingStatistics(mean, sd, class_means, weights, scatter)
        self.solve_coefficients(row_weights.sum())
        return self

    def summarise_rows(self, X: pd.DataFrame, y: np.ndarray) -> RowSummary:
        """Summarise some training rows for `fit_summaries`."""
        classes, codes = np.unique(y, return_inverse=True)
        Z = np.asarray(X, dtype=np.float64)
        row_weights = np.where(undamaged_rows(X), 1.0, self.damaged)
        class_means, weights = mean_by_code(Z, codes, row_weights)
        centred = Z - class_means[codes]
        scatter = self.weighted_scatter(centred, capture_of_rows(X), row_weights)
        squares = row_weights @ centred**2
        return RowSummary(
            classes, weights, class_means, scatter, squares, Z.min(axis=0), Z.max(axis=0)
        )

    def fit_summaries(self, summaries: Sequence[RowSummary]) -> Discriminants:
        """Fit to parts that share no capture; equals `fit` to all rows but for rounding."""
        part_classes = np.concatenate([summary.classes for summary in summaries])
        part_means = np.concatenate([summary.class_means for summary in summaries])
        part_weights = np.concatenate([summary.weights for summary in summaries])
        self.classes_, codes = np.unique(part_classes, return_inverse=True)
        self.n_features_in_ = part_means.shape[1]
        class_means, weights = mean_by_code(part_means, codes, part_weights)
        deviations = part_means - class_means[codes]
        mean = weights @ class_means / weights.sum()
        squares = sum(summary.squares for summary in summaries)
        squares = squares + part_weights @ deviations**2 + weights @ (class_means - mean) ** 2
        sd = np.sqrt(squares / weights.sum())
        extremes = [summary.minimum for summary in summaries]
        extremes += [summary.maximum for summary in summaries]
        sd[is_constant(np.stack(extremes))] = np.inf
        scatter = self.windows * (deviations.T * part_weights) @ deviations
        for summary in summaries:
            scatter += summary.scatter
        scaled_means, scaled_scatter = (class_means - mean) / sd, scatter / sd[:, None] / sd
        self.learnt_ = TrainingStatistics(mean, sd, scaled_means, weights, scaled_scatter)
        self.solve_coefficients(weights.sum())
        return self

    def weighted_scatter(
        self, centred: np.ndarray, captures: np.ndarray, row_weights: np.ndarray
    ) -> np.ndarray:
        """Scatter about class means, that between captures weighted by ``windows``."""
        scatter = (centred.T * row_weights) @ centred
        if self.windows == 1:
            return scatter
        means, weights = mean_by_code(centred, captures, row_weights)
        return scatter + (self.windows - 1) * (means.T * weights) @ means

    def solve_coefficients(self, total_weight: float) -> None:
        """Compute the coefficients from the statistics of training rows of a total weight."""
        learnt = self.learnt_
        scatter = learnt.scatter / total_weight
        mean_variance = np.trace(scatter) / len(scatter)
        scatter *= 1 - self.shrinkage
        scatter[np.diag_indices(len(scatter))] += self.shrinkage * mean_variance + 1e-9
        coef = np.linalg.solve(scatter, learnt.class_means.T).T
        self.coef_ = coef / learnt.sd
        self.intercept_ = -0.5 * (coef * learnt.class_means).sum(axis=1) - self.coef_ @ learnt.mean

    @property
    def constants_(self) -> int:
        """Number of means and SDs, as single precision needs features to be standardised first."""
        return 2 * self.n_features_in_

    def decision_function(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Log density of each class, up to a common constant [rows, classes]."""
        return np.asarray(X, dtype=np.float64) @ self.coef_.T + self.intercept_

    def predict_proba(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [rows, classes]."""
        return softmax(self.decision_function(X), axis=1)


def mean_by_code(
    values: np.ndarray, codes: np.ndarray, row_weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean of the rows of each code [codes, n], and the sum of their weights [codes]."""
    order = np.argsort(codes, kind="stable")
    first = np.flatnonzero(np.diff(codes[order], prepend=-1))
    weights = np.add.reduceat(row_weights[order], first)
    ordered = values[order]
    ordered *= row_weights[order][:, None]
    sums = np.add.reduceat(ordered, first)
    return sums / weights[:, None], weights


def lda(
    features: TransformerMixin, shrinkage: float = 0.2, windows: float = 1.0, damaged: float = 1.0
) -> Pipeline:
    """Linear discriminants: one covariance, shrunk towards a multiple of the identity.

    Features are standardised on the training captures. All classes have the same prior.

    Args:
        features: transformer from captures to a table.
        shrinkage: shrinkage of the covariance, 0 to 1. Default: ours, from the design of reflex on
            seven of HAART's people.
        windows: number of windows that decide on a label together; the covariance between captures
            counts this many times more than that within them. Default: the usual linear
            discriminants.
        damaged: weight of a damaged copy of a capture (model.faults=). Default: each copy counts as
            its capture.

    Raises:
        InputError: a parameter is out of its range.
    """
    check_value("model.shrinkage", shrinkage, 0 <= shrinkage <= 1, "0 to 1")
    check_value("model.windows", windows, 1 <= windows < float("inf"), "1 or more")
    check_value("model.damaged", damaged, 0 < damaged < float("inf"), "a number above 0")
    classifier = Discriminants(shrinkage, windows, damaged)
    return PerPersonPipeline([("features", features), ("classifier", classifier)])


lda.space = {"shrinkage": Range(1e-3, 1, log=True), "windows": Range(1, 8, log=True)}
