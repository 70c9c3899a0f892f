"""The Pareto front, once for searches, figures and choices."""

from __future__ import annotations

import numpy as np


def front(accuracy: np.ndarray, cost: np.ndarray) -> np.ndarray:
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
    by = np.full(len(accuracy), -1)
    known = np.isfinite(costs).all(axis=1) & np.isfinite(accuracy)
    order = np.lexsort((*costs.T[::-1], -accuracy))  # what dominates a point comes before it
    order = order[known[order]]
    ranked, size = -accuracy[order], 0
    front = np.empty(len(order), int)  # of the points so far, the most accurate first
    for i in order:
        if len(better := _better(front[:size], i, accuracy, costs)):
            alike = slice(*(np.searchsorted(ranked, -accuracy[better[0]], side) for side in ("left", "right")))
            by[i] = _better(order[alike], i, accuracy, costs).min()
        else:
            front[size] = i
            size += 1
    return by


def _better(points: np.ndarray, than: int, accuracy: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Those of some points, at least as accurate as another one, that are as cheap as it, too, and better in one."""
    as_cheap = points[(costs[points] <= costs[than]).all(axis=1)]
    strictly = (accuracy[as_cheap] > accuracy[than]) | (costs[as_cheap] < costs[than]).any(axis=1)
    return as_cheap[strictly]
