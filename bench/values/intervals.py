"""Uncertainty over people: intervals of a mean and of a ratio, one standard error, people drawn with replacement.

Whole subjects are drawn, because captures of one are not independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.values import few

TOLERANCE = 1e-9  # relative and absolute: accuracies are shares of captures, so that smaller gaps are rounding
DRAWS = 2000


def mean_and_error(differences: np.ndarray) -> tuple[float, float]:
    """Mean of differences, one per subject, and its standard error, which is NaN for fewer than two subjects."""
    error = differences.std(ddof=1) / np.sqrt(len(differences)) if len(differences) > 1 else np.nan
    return float(differences.mean()), float(error)


def within_one_standard_error(losses: np.ndarray) -> np.ndarray:
    """Whether the mean of losses [..., subjects] is at most its standard error; of one subject, if there is no loss.

    A loss is the accuracy of the best system less that of another. NaN gives False.
    """
    # where two systems differ on one subject alone, mean and error are equal but for rounding, hence the tolerance
    mean, people = losses.mean(axis=-1), losses.shape[-1]
    error = losses.std(axis=-1, ddof=1) / np.sqrt(people) if people > 1 else np.zeros(mean.shape)
    return mean - error <= TOLERANCE * np.maximum(1, np.maximum(np.abs(mean), error))


def loss_is_below_margin(losses: np.ndarray, margin: float) -> np.ndarray:
    """Whether a one-sided paired t-test shows the mean loss to be less than a margin (p < 0.05), bool [systems].

    The losses are [systems, subjects]; fewer than `bench.values.few.FEWEST_FOR_TEST` people show nothing.
    """
    from scipy.special import stdtr  # not scipy.stats, which takes half a second

    people, mean = losses.shape[1], losses.mean(axis=1)
    if people < few.FEWEST_FOR_TEST:
        return np.zeros(len(losses), bool)
    error = losses.std(axis=1, ddof=1) / np.sqrt(people)
    t = np.divide(mean - margin, error, out=np.full(mean.shape, np.inf), where=error > 0)
    return np.where(error > 0, stdtr(people - 1, t) < 0.05, mean < margin)


def mean_interval(values: np.ndarray) -> tuple[float, float]:
    """95 % interval of a mean over people, by Student's t; NaN for fewer than `bench.values.few.FEWEST_FOR_INTERVAL` people."""
    if len(values) < few.FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    return t_interval(float(values.mean()), float(values.std(ddof=1)), len(values))


def t_interval(mean: float, sd: float, people: int) -> tuple[float, float]:
    """The same of a mean and an SD over people."""
    from scipy.special import stdtrit  # not scipy.stats, which takes half a second

    if people < few.FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    half = float(stdtrit(people - 1, 0.975)) * sd / np.sqrt(people)
    return float(mean - half), float(mean + half)


def share_interval(mean: float, sd: float, people: int) -> tuple[float, float]:
    """The same of a share, which is from 0 to 1."""
    low, high = np.clip(t_interval(mean, sd, people), 0, 1)
    return float(low), float(high)


def draw_people(people: int) -> np.ndarray:
    """Numbers of the people in each of `DRAWS` drawings, int [draws, people]; one may come several times."""
    return np.random.default_rng(0).integers(0, people, (DRAWS, people))


def draw_weights(sizes: Sequence[int], draws: int = DRAWS, seed: int = 0) -> list[np.ndarray]:
    """How often each person of sets of these sizes is in each drawing, int [draws, people]; sets keep their size."""
    rng = np.random.default_rng(seed)
    return [rng.multinomial(size, np.full(size, 1 / size), draws) for size in sizes]


def percentile_interval(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Ends of the 95 % percentile interval of what the drawings gave, [2, ...]."""
    return np.quantile(values, (0.025, 0.975), axis=axis)


def ratio_interval(counts: np.ndarray) -> tuple[float, float]:
    """95 % interval of a pooled ratio, of the numerator and denominator of each subject [subjects, 2].

    Drawings whose denominators are all 0 are left out. NaN if fewer than `bench.values.few.FEWEST_FOR_INTERVAL` are above 0.
    """
    if np.count_nonzero(counts[:, 1]) < few.FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    sums = counts[draw_people(len(counts))].sum(axis=1)
    sums = sums[sums[:, 1] > 0]
    low, high = percentile_interval(sums[:, 0] / sums[:, 1])
    return float(low), float(high)
