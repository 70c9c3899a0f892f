"""Uncertainty over people: intervals of a mean and a ratio, standard errors, bootstrap.

The bootstrap draws whole subjects, because captures of one subject are not independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.values import few

TOLERANCE = 1e-9  # relative and absolute; smaller gaps between accuracies are rounding
DRAWS = 2000


def mean_and_error(differences: np.ndarray) -> tuple[float, float]:
    """Mean of differences, one per subject, and its standard error; NaN for one subject."""
    error = differences.std(ddof=1) / np.sqrt(len(differences)) if len(differences) > 1 else np.nan
    return float(differences.mean()), float(error)


def within_one_standard_error(losses: np.ndarray) -> np.ndarray:
    """Test if the mean of losses [..., subjects] is at most its standard error, which is 0 for one.

    A loss is the accuracy of the best system minus that of another. NaN gives False.
    """
    # If two systems differ on one subject alone, mean and error are equal but for rounding.
    mean, people = losses.mean(axis=-1), losses.shape[-1]
    error = losses.std(axis=-1, ddof=1) / np.sqrt(people) if people > 1 else np.zeros(mean.shape)
    return mean - error <= TOLERANCE * np.maximum(1, np.maximum(np.abs(mean), error))


def loss_is_below_margin(losses: np.ndarray, margin: float) -> np.ndarray:
    """Test if mean losses are below a margin: one-sided paired t-test, p < 0.05.

    Args:
        losses: [systems, subjects].
        margin: in the unit of the losses.

    Returns:
        bool [systems]; all False for fewer than `bench.values.few.FEWEST_FOR_TEST` subjects.
    """
    from scipy.special import stdtr  # not scipy.stats, which takes half a second

    people, mean = losses.shape[1], losses.mean(axis=1)
    if people < few.FEWEST_FOR_TEST:
        return np.zeros(len(losses), bool)
    error = losses.std(axis=1, ddof=1) / np.sqrt(people)
    t = np.divide(mean - margin, error, out=np.full(mean.shape, np.inf), where=error > 0)
    return np.where(error > 0, stdtr(people - 1, t) < 0.05, mean < margin)


def mean_interval(values: np.ndarray) -> tuple[float, float]:
    """95 % t-interval of a mean over people; NaN for fewer than ``few.FEWEST_FOR_INTERVAL``."""
    if len(values) < few.FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    return t_interval(float(values.mean()), float(values.std(ddof=1)), len(values))


def t_interval(mean: float, sd: float, people: int) -> tuple[float, float]:
    """95 % t-interval from a mean and an SD over people; NaN for too few."""
    from scipy.special import stdtrit  # not scipy.stats, which takes half a second

    if people < few.FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    half = float(stdtrit(people - 1, 0.975)) * sd / np.sqrt(people)
    return float(mean - half), float(mean + half)


def draw_weights(sizes: Sequence[int], draws: int = DRAWS, seed: int = 0) -> list[np.ndarray]:
    """Draw people of several sets: how often each comes, an array int [draws, people] per set."""
    rng = np.random.default_rng(seed)
    return [rng.multinomial(size, np.full(size, 1 / size), draws) for size in sizes]


def percentile_interval(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Ends of the 95 % percentile interval of drawn values [draws, ...]: [2, ...]."""
    return np.quantile(values, (0.025, 0.975), axis=axis)


def ratio_interval(counts: np.ndarray) -> tuple[float, float]:
    """95 % bootstrap interval of a pooled ratio.

    Args:
        counts: numerator and denominator of each subject, [subjects, 2].

    Returns:
        The ends, from drawings with a denominator above 0; NaN if fewer than
        ``few.FEWEST_FOR_INTERVAL`` subjects have one.
    """
    if np.count_nonzero(counts[:, 1]) < few.FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    draws = np.random.default_rng(0).integers(0, len(counts), (DRAWS, len(counts)))
    sums = counts[draws].sum(axis=1)
    sums = sums[sums[:, 1] > 0]
    low, high = percentile_interval(sums[:, 0] / sums[:, 1])
    return float(low), float(high)
