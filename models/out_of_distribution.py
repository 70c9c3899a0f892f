"""Two classifiers for one table: one for rows that look like training, one for the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from bench.features.base import is_constant, undamaged_rows, without_sources
from bench.models.classic.lda import Discriminants
from bench.models.classic.perceptron import Perceptron
from bench.models.most_probable import MostProbable

UNUSUAL_SDS = 2.5  # SDs of undamaged training rows


@dataclass(eq=False, repr=False)
class GuardedDiscriminants(MostProbable):
    """Linear discriminants, mixed row by row with a small network trained on damaged copies.

    The network's weight grows with the share of features beyond 2.5 SDs from the mean of the
    undamaged training rows: 0 without such a feature, 1 from a share of ``doubt`` on. The index of
    the rows marks damaged copies, as in `bench.models.classic.lda.Discriminants`. Without copies,
    the network learns from the same rows.

    Args:
        windows: number of windows, see `bench.models.classic.lda.Discriminants`.
        units: number of units in the network's hidden layer.
        doubt: share of the features.
        seed: random seed of the network.
        tune: True if the discriminants choose their shrinkage and number of windows.

    Attributes:
        classes_: class names.
        linear_, robust_: the two, fitted.
        mean_, sd_: mean and SD of undamaged rows, float32 [features].
    """

    windows: float = 2.0
    units: int = 18
    doubt: float = 0.03
    seed: int = 0
    tune: bool = False

    def fit(
        self, X: pd.DataFrame, y: np.ndarray, subjects: np.ndarray | None = None
    ) -> GuardedDiscriminants:
        """Fit to features [rows, n_features] with an index of capture and copy.

        ``y`` and ``subjects`` are class names and, to tune, subjects of the rows.
        """
        undamaged = undamaged_rows(X)
        values = X[undamaged].to_numpy(dtype=np.float32)
        self.n_features_in_ = values.shape[1]
        self.mean_, self.sd_ = values.mean(axis=0), values.std(axis=0)
        self.sd_[is_constant(values) | (self.sd_ == 0)] = np.inf
        self.linear_ = Discriminants(windows=self.windows, tune=self.tune)
        self.linear_.fit(X[undamaged], y[undamaged], subjects[undamaged] if self.tune else None)
        self.robust_ = Perceptron(self.units, seed=self.seed).fit(without_sources(X), y)
        self.classes_ = self.linear_.classes_
        return self

    def network_weights(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Weight of the network, 0 to 1 [rows]; missing values are unusual."""
        with np.errstate(over="ignore"):  # values beyond float32 are unusual, too
            distance = np.abs(np.asarray(X, dtype=np.float32) - self.mean_)
            is_usual = distance <= np.float32(UNUSUAL_SDS) * self.sd_
        return np.minimum((~is_usual).mean(axis=1) / self.doubt, 1)

    def predict_proba(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [rows, classes]."""
        weight = self.network_weights(X)[:, None]
        # an infinite feature makes the discriminants NaN, which are not used then
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.asarray(X, dtype=np.float32)
            linear = np.where(weight < 1, self.linear_.predict_proba(values), 0)
        return (1 - weight) * linear + weight * self.robust_.predict_proba(values)

    @property
    def chosen_(self) -> dict[str, object]:
        """Settings that the discriminants have chosen."""
        return self.linear_.chosen_

    @property
    def activations_(self) -> int:
        """Number of the network's inputs and units."""
        return self.n_features_in_ + self.units

    @property
    def parameters_(self) -> int:
        """Number of learnt values of both classifiers, and of means and SDs."""
        linear = self.linear_.coef_.size + self.linear_.intercept_.size
        return self.mean_.size + self.sd_.size + linear + self.robust_.parameters_
