"""Resampling over people: whole subjects are drawn with replacement, because captures of one are not independent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import few

DRAWS = 2000
ENDS = (0.025, 0.975)  # of a 95 % interval


def drawn(people: int, draws: int = DRAWS, seed: int = 0) -> np.ndarray:
    """Numbers of the people in each drawing, int [draws, people]; one may come several times."""
    return np.random.default_rng(seed).integers(0, people, (draws, people))


def weights(sizes: Sequence[int], draws: int = DRAWS, seed: int = 0) -> list[np.ndarray]:
    """How often each person of each set is in each drawing, int [draws, people]; sets keep their size.

    Args:
        sizes: number of people of each set.
        draws: number of drawings.
        seed: seed of the drawings.
    """
    rng = np.random.default_rng(seed)
    return [rng.multinomial(size, np.full(size, 1 / size), draws) for size in sizes]


def interval(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Ends of the 95 % percentile interval of what the drawings gave, [2, ...]."""
    return np.quantile(values, ENDS, axis=axis)


def ratio_interval(counts: np.ndarray, draws: int = DRAWS, seed: int = 0) -> tuple[float, float]:
    """95 % interval of a pooled ratio.

    Draws whose denominators are all 0 are left out. Returns NaN, NaN if fewer than `bench.few.INTERVAL` denominators
    are above 0.

    Args:
        counts: numerator and denominator of each subject [subjects, 2], such as hits and captures.
        draws: number of drawings.
        seed: seed of the drawings.
    """
    if np.count_nonzero(counts[:, 1]) < few.INTERVAL:
        return np.nan, np.nan
    sums = counts[drawn(len(counts), draws, seed)].sum(axis=1)
    sums = sums[sums[:, 1] > 0]
    low, high = interval(sums[:, 0] / sums[:, 1])
    return float(low), float(high)
