"""Linear discriminants on a feature set, for captures or for windows of captures."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import softmax
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.features.base import capture_of_rows, is_constant, undamaged_rows
from bench.models.by_person import PerPersonPipeline
from bench.models.classic.row_summaries import (
    RowSummary,
    SummaryTree,
    TrainingStatistics,
    mean_by_code,
    summarise_rows,
    weighted_scatter,
)
from bench.models.most_probable import MostProbable
from bench.models.search.inner_folds import split_subjects
from bench.models.space import Range

# What ``tune`` chooses from; of equals the first one. They do not depend on any data.
WINDOWS = 1.0, 4.0
SHRINKAGES = 0.4, 0.2, 0.1, 0.05, 0.025


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
        tune: True to choose ``shrinkage`` and ``windows`` by leaving out each training subject
            (`choose_settings`).

    Attributes:
        classes_: class names.
        shrinkage_, windows_: those that were used.
        coef_: [classes, features], of features that are not standardised.
        intercept_: [classes].
        learnt_: statistics of the training rows.
    """

    shrinkage: float = 0.2
    windows: float = 1.0
    damaged: float = 1.0
    tune: bool = False

    def fit(
        self, X: pd.DataFrame | np.ndarray, y: np.ndarray, subjects: np.ndarray | None = None
    ) -> Discriminants:
        """Learn from features [rows, n_features], class names and, to tune, subjects [rows]."""
        self.shrinkage_, self.windows_ = self.shrinkage, self.windows
        if self.tune:
            self.shrinkage_, self.windows_ = choose_settings(X, y, subjects, self.damaged)
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
        scatter = weighted_scatter(Z, capture_of_rows(X), row_weights, self.windows_)
        self.learnt_ = TrainingStatistics(mean, sd, class_means, weights, scatter)
        self.solve_coefficients(row_weights.sum())
        return self

    def summarise_rows(self, X: pd.DataFrame, y: np.ndarray) -> RowSummary:
        """Summarise some training rows for `fit_summary`."""
        return summarise_rows(X, y, [self.windows], self.damaged)

    def fit_summary(self, summary: RowSummary) -> Discriminants:
        """Fit to the rows of a summary for ``windows``; equals `fit` to them but for rounding."""
        self.shrinkage_, self.windows_ = self.shrinkage, self.windows
        self.classes_, self.learnt_ = summary.classes, summary.standardise(self.windows)
        self.n_features_in_ = len(self.learnt_.mean)
        self.solve_coefficients(summary.weights.sum())
        return self

    def solve_coefficients(self, total_weight: float) -> None:
        """Compute the coefficients from the statistics of training rows of a total weight."""
        learnt = self.learnt_
        scatter = learnt.scatter / total_weight
        mean_variance = np.trace(scatter) / len(scatter)
        scatter *= 1 - self.shrinkage_
        scatter[np.diag_indices(len(scatter))] += self.shrinkage_ * mean_variance + 1e-9
        coef = np.linalg.solve(scatter, learnt.class_means.T).T
        self.coef_ = coef / learnt.sd
        self.intercept_ = -0.5 * (coef * learnt.class_means).sum(axis=1) - self.coef_ @ learnt.mean

    @property
    def chosen_(self) -> dict[str, object]:
        """Settings that it has chosen itself."""
        settings = {"shrinkage": self.shrinkage_, "windows": self.windows_}
        return settings if self.tune else {}

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


def choose_settings(
    X: pd.DataFrame, y: np.ndarray, subjects: np.ndarray, damaged: float
) -> tuple[float, float]:
    """Choose shrinkage and windows by the accuracy on captures of left-out subjects.

    Each combination of `SHRINKAGES` and `WINDOWS` is trained without each subject. The best has the
    highest mean accuracy over the subjects, on their undamaged captures. Rows whose subject is ""
    are in each training part.

    Raises:
        InputError: there is only one subject.
    """
    captures = capture_of_rows(X)
    has_windows = len(np.unique(captures)) < len(captures)
    settings = [*itertools.product(WINDOWS if has_windows else WINDOWS[:1], SHRINKAGES)]
    windows = sorted({number for number, _ in settings})
    own, added = np.flatnonzero(subjects != ""), np.flatnonzero(subjects == "")
    rows_of_persons = [own[rows] for _, rows in split_subjects(subjects[own], "loso")]
    tree, accuracies = SummaryTree(), np.zeros((len(rows_of_persons), len(settings)))
    for key, rows in enumerate([*rows_of_persons, added] if len(added) else rows_of_persons):
        tree.persons[key] = summarise_rows(X.iloc[rows], y[rows], windows, damaged)
    for key, rows in enumerate(rows_of_persons):
        others = tree.merge(tuple(each for each in tree.persons if each != key))
        judged = rows[undamaged_rows(X)[rows]]
        Z, codes = X.iloc[judged].to_numpy(np.float64), captures[judged]
        first = np.unique(codes, return_index=True)[1]
        models = [Discriminants(each, number).fit_summary(others) for number, each in settings]
        proba = np.concatenate([model.predict_proba(Z) for model in models], axis=1)
        means, _ = mean_by_code(proba, codes, np.ones(len(Z)))
        best = means.reshape(len(first), len(settings), -1).argmax(axis=2)
        is_correct = others.classes[best] == y[judged[first]][:, None]
        accuracies[key] = is_correct.mean(axis=0)
    number, shrinkage = settings[accuracies.mean(axis=0).round(9).argmax()]
    return shrinkage, number


def lda(
    features: TransformerMixin,
    shrinkage: float = 0.2,
    windows: float = 1.0,
    damaged: float = 1.0,
    tune: bool = False,
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
        tune: yes: choose shrinkage and windows by leaving out each training subject in turn, from
            ten combinations. Default: ours, the values above.

    Raises:
        InputError: a parameter is out of its range.
    """
    check_value("model.shrinkage", shrinkage, 0 <= shrinkage <= 1, "0 to 1")
    check_value("model.windows", windows, 1 <= windows < float("inf"), "1 or more")
    check_value("model.damaged", damaged, 0 < damaged < float("inf"), "a number above 0")
    classifier = Discriminants(shrinkage, windows, damaged, tune)
    return PerPersonPipeline([("features", features), ("classifier", classifier)])


lda.space = {"shrinkage": Range(1e-3, 1, log=True), "windows": Range(1, 8, log=True)}
