"""The Pareto front, once for searches, figures and choices."""

from __future__ import annotations

import numpy as np


def is_on_front(accuracy: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Points on the Pareto front: no other one is at least as accurate and as cheap, and better in one; bool [points].

    A point without a cost (nan) is on no front.
    """
    order = np.lexsort((-accuracy, cost))
    sound, cheap = accuracy[order], cost[order]
    first = np.searchsorted(cheap, cheap)  # of the points of equal cost, the most accurate
    of_cheaper = np.concatenate([[np.nan], np.fmax.accumulate(sound)])[first]
    on = np.empty(len(order), bool)
    on[order] = np.isfinite(cheap) & ~((of_cheaper >= sound) | (sound[first] > sound))
    return on


def front_corners(accuracy: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Positions of the points of `is_on_front`, cheapest first, only the first of equal points; int [corners].

    A chart draws its line through them and names each once.
    """
    on = np.flatnonzero(is_on_front(accuracy, cost))
    _, first = np.unique(cost[on], return_index=True)
    return on[first]
