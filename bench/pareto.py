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


def staircase(accuracy: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Positions of the points of `front`, cheapest first, only the first of equal points; int [corners].

    A chart draws its line through them and names each once.
    """
    on = np.flatnonzero(front(accuracy, cost))
    _, first = np.unique(cost[on], return_index=True)
    return on[first]


def dominated_by(accuracy: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """For each point, another one that is at least as good in everything and better in something; -1 without one.

    Points with an unknown cost (nan) neither dominate nor are dominated.

    Args:
        accuracy: float [points].
        costs: float [points, costs].

    Returns:
        int [points]; of several, the most accurate.
    """
    known = np.isfinite(costs).all(axis=1) & np.isfinite(accuracy)
    worth = np.column_stack([accuracy, -costs])
    as_good = (worth[:, None] <= worth[None]).all(axis=2) & (worth[:, None] < worth[None]).any(axis=2)
    as_good &= known[:, None] & known[None]
    ranked = np.where(as_good, accuracy, -np.inf)
    return np.where(as_good.any(axis=1), ranked.argmax(axis=1), -1)
