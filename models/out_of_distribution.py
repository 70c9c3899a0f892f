"""Two classifiers for one table: one for usual rows, one for unusual ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from bench.features.base import is_constant, undamaged_rows
from bench.models.classic.lda import Discriminants
from bench.models.classic.perceptron import Perceptron
from bench.models.most_probable import MostProbable

UNUSUAL_SDS = 2.5  # SDs of undamaged training rows


@dataclass(eq=False, repr=False)
class GuardedDiscriminants(MostProbable):
    """Linear discriminants trained without damage, and a small network trained with it, mixed row by row.

    The more features of a row lie further than 2.5 SDs from the mean of the undamaged training rows, the more the
    network counts: nothing where none does, all from a share of ``doubt`` on. Rows of damaged copies are told by their
    index, as `bench.models.classic.lda.Discriminants` reads it. Where there are none, the network learns from the same
    rows.

    Args:
        windows: number of windows, see `bench.models.classic.lda.Discriminants`.
        units: number of units in the network's hidden layer.
        doubt: share of the features.
        seed: random seed of the network.

    Attributes:
        classes_: class names.
        linear_, robust_: the two, fitted.
        mean_, sd_: mean and SD of undamaged rows, float32 [features].
    """

    windows: float = 2.0
    units: int = 18
    doubt: float = 0.03
    seed: int = 0

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> GuardedDiscriminants:
        """Learn from features [rows, n_features], labelled by capture and copy, and class names [rows]."""
        sound = undamaged_rows(X)
        usual = X[sound]
        values = usual.to_numpy(dtype=np.float32)
        self.n_features_in_ = values.shape[1]
        self.mean_, self.sd_ = values.mean(axis=0), values.std(axis=0)
        self.sd_[is_constant(values) | (self.sd_ == 0)] = np.inf
        self.linear_ = Discriminants(windows=self.windows).fit(usual, y[sound])
        self.robust_ = Perceptron(self.units, seed=self.seed).fit(X, y)
        self.classes_ = self.linear_.classes_
        return self

    def network_weights(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Weight of the network, 0 to 1 [rows]; missing values are unusual."""
        with np.errstate(over="ignore"):  # beyond float32 is unusual, too
            usual = (
                np.abs(np.asarray(X, dtype=np.float32) - self.mean_)
                <= np.float32(UNUSUAL_SDS) * self.sd_
            )
        return np.minimum((~usual).mean(axis=1) / self.doubt, 1)

    def predict_proba(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [rows, classes]."""
        doubt = self.network_weights(X)[:, None]
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # of an endless feature, no number, which is not used
            values = np.asarray(X, dtype=np.float32)
            linear = np.where(doubt < 1, self.linear_.predict_proba(values), 0)
        return (1 - doubt) * linear + doubt * self.robust_.predict_proba(values)

    @property
    def activations_(self) -> int:
        """Features as the network sees them, and its units."""
        return self.n_features_in_ + self.units

    @property
    def parameters_(self) -> int:
        """Learnt numbers of both, and of the comparison of rows."""
        usual = self.mean_.size + self.sd_.size
        return (
            usual
            + self.linear_.coef_.size
            + self.linear_.intercept_.size
            + self.robust_.parameters_
        )
