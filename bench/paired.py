"""Paired differences over subjects: their mean, its standard error, and the rule of one standard error."""

from __future__ import annotations

import numpy as np

from bench import few

TOLERANCE = 1e-9  # relative and absolute: accuracies are shares of captures, so that smaller gaps are rounding


def mean_and_error(differences: np.ndarray) -> tuple[float, float]:
    """Mean and its standard error; the error is NaN for fewer than two subjects.

    Args:
        differences: one per subject.
    """
    error = differences.std(ddof=1) / np.sqrt(len(differences)) if len(differences) > 1 else np.nan
    return float(differences.mean()), float(error)


def within_one_standard_error(losses: np.ndarray) -> np.ndarray:
    """Whether the mean loss is at most its standard error; of one subject, whether there is no loss.

    Where two systems differ on one subject alone, the mean loss equals its standard error, whatever the number of
    subjects. Both are rounded, so that they are compared with a tolerance.

    Args:
        losses: accuracy of the best system minus that of another, float [..., subjects].

    Returns:
        bool [...]; False where a loss is NaN.
    """
    mean, people = losses.mean(axis=-1), losses.shape[-1]
    error = losses.std(axis=-1, ddof=1) / np.sqrt(people) if people > 1 else np.zeros(mean.shape)
    return mean - error <= TOLERANCE * np.maximum(1, np.maximum(np.abs(mean), error))


def interval(values: np.ndarray) -> tuple[float, float]:
    """95 % interval of a mean over people, by Student's t; NaN for fewer than `bench.few.INTERVAL` people."""
    if len(values) < few.INTERVAL:
        return np.nan, np.nan
    return t_interval(float(values.mean()), float(values.std(ddof=1)), len(values))


def t_interval(mean: float, sd: float, people: int) -> tuple[float, float]:
    """The same of a mean and an SD over people."""
    from scipy.special import stdtrit  # not scipy.stats, which takes half a second

    if people < few.INTERVAL:
        return np.nan, np.nan
    half = float(stdtrit(people - 1, 0.975)) * sd / np.sqrt(people)
    return float(mean - half), float(mean + half)


def share_interval(mean: float, sd: float, people: int) -> tuple[float, float]:
    """The same of a share, which is from 0 to 1."""
    low, high = np.clip(t_interval(mean, sd, people), 0, 1)
    return float(low), float(high)
