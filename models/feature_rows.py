"""Rows of features that tell which capture, and which copy of it, they are of (`features.base.labels`)."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
import pandas as pd


def captures_of(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Of which capture each row is, numbered from 0; each of its own where the rows do not tell."""
    return np.unique(X.index.get_level_values("capture"), return_inverse=True)[1] if told(X) else np.arange(len(X))


def undamaged(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Which rows are not of a damaged copy, bool [rows]."""
    return np.asarray(X.index.get_level_values("copy") == 0) if told(X) else np.ones(len(X), dtype=bool)


def told(X: pd.DataFrame | np.ndarray) -> TypeGuard[pd.DataFrame]:
    """Whether rows are told apart by capture and copy."""
    return isinstance(X, pd.DataFrame) and X.index.names == ["capture", "copy"]
