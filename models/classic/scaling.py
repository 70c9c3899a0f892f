"""Scalers under which a feature that is constant in training stays constant.

A feature that never varies in training has no range to be scaled by. scikit-learn's scalers then
pass its differences on unscaled. If all training captures are equally long, a shorter one would
move its duration by hundreds of training ranges, which would dominate any kernel. Here such a
feature always has its training value.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.preprocessing import MinMaxScaler, StandardScaler

from bench.features.base import is_constant


class RangeScaler(MinMaxScaler):
    """Training range to 0..1, or another ``feature_range``; a constant feature is its lower end."""

    def fit(self, X: pd.DataFrame | np.ndarray, y: object = None) -> RangeScaler:
        """Learn the range of each feature [captures, n_features]."""
        super().fit(X, y)
        constant = is_constant(X)
        self.scale_[constant] = 0
        self.min_[constant] = self.feature_range[0]
        return self


class ZScaler(StandardScaler):
    """Mean 0 and SD 1 in training; a constant feature is 0."""

    def fit(
        self, X: pd.DataFrame | np.ndarray, y: object = None, sample_weight: object = None
    ) -> ZScaler:
        """Learn mean and SD of each feature [captures, n_features]."""
        super().fit(X, y, sample_weight)
        self.scale_[is_constant(X)] = np.inf
        return self
