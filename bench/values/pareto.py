"""The Pareto front of accuracy and cost, for searches, figures and choices."""

from __future__ import annotations

import numpy as np


def is_on_front(accuracy: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Find the points on the Pareto front: bool [points].

    No other point is at least as accurate and as cheap, and better in one of both. A point without
    a cost (NaN) is on no front.
    """
    order = np.lexsort((-accuracy, cost))
    accuracies, costs = accuracy[order], cost[order]
    first = np.searchsorted(costs, costs)  # the most accurate point of equal cost
    best_cheaper = np.concatenate([[np.nan], np.fmax.accumulate(accuracies)])[first]
    is_beaten = (best_cheaper >= accuracies) | (accuracies[first] > accuracies)
    mask = np.empty(len(order), bool)
    mask[order] = np.isfinite(costs) & ~is_beaten
    return mask


def front_corners(accuracy: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Indices of the points on the front, cheapest first, one of equal points: int [corners]."""
    indices = np.flatnonzero(is_on_front(accuracy, cost))
    _, first = np.unique(cost[indices], return_index=True)
    return indices[first]
