"""Positions of captures as folds keep them: neighbours as a stretch, since people's captures mostly are.

A fold of LOSO among 2,500,000 captures would take 10 MB otherwise, for each of its people.
"""

from __future__ import annotations

import numpy as np


def stretches_of(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Positions as stretches, if that is shorter.

    Args:
        positions: int32 or int64 [positions], in any order.

    Returns:
        The first position of each stretch [stretches] and how many follow each other, int64; or the positions
        themselves and None.
    """
    first = np.flatnonzero(np.diff(positions, prepend=positions[:1] - 2) != 1)
    if 2 * len(first) >= len(positions):
        return positions, None
    return positions[first], np.diff(first, append=len(positions))


def positions_of(first: np.ndarray, lengths: np.ndarray | None) -> np.ndarray:
    """The positions of `stretches_of`."""
    if lengths is None:
        return first
    steps = np.ones(int(lengths.sum()), dtype=first.dtype)
    ends = np.cumsum(lengths[:-1], dtype=np.int64)
    steps[0] = first[0]
    steps[ends] = first[1:] - (first[:-1] + lengths[:-1] - 1)
    return np.cumsum(steps, dtype=first.dtype)
