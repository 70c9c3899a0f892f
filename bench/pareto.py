"""The Pareto front, once for searches, figures and choices."""

from __future__ import annotations

import numpy as np


def front(accuracy: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Points on the Pareto front: no other one is at least as accurate and as cheap, and better in one; bool [points].

    A point without a cost (nan) is on no front.
    """
    better = (accuracy[:, None] >= accuracy) & (cost[:, None] <= cost)
    strictly = (accuracy[:, None] > accuracy) | (cost[:, None] < cost)
    return np.isfinite(cost) & ~(better & strictly).any(axis=0)
