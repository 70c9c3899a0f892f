"""Rows of features, labelled by their capture and by which copy of it they are of (`bench.features.base.labels`)."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
import pandas as pd


def captures_of(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Capture of each row, numbered from 0; each of its own if rows are not labelled."""
    return np.unique(X.index.get_level_values("capture"), return_inverse=True)[1] if labelled(X) else np.arange(len(X))


def undamaged(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Rows without damage, bool [rows]."""
    return np.asarray(X.index.get_level_values("copy") == 0) if labelled(X) else np.ones(len(X), dtype=bool)


def labelled(X: pd.DataFrame | np.ndarray) -> TypeGuard[pd.DataFrame]:
    """Return True if the index of the rows is their capture and copy."""
    return isinstance(X, pd.DataFrame) and X.index.names == ["capture", "copy"]
