"""Accuracy to expect for a new person: bounds from a few people, and a test of them.

Arguments of all functions: ``right`` and ``total``, correctly classified and all captures of each
person [..., people]. ``total`` is at least 1. Accuracies are fractions of 1.

A person is one value. On the scale of angles (arcsine of the square root), the spread between
people depends little on the accuracy (Freeman and Tukey 1950), and Student's t is more accurate
than on shares, which end at 1. Few people often resemble each other by chance. Their variance is
therefore never taken to be less than its mean with that of `PRIOR_PEOPLE` people, whose spread
`SPREAD` is the upper end of what HAART shows. The page of this add-on has the coverage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import nctdtr, stdtr, stdtrit

from bench.values import few

# SD between people, in radians: HAART's is 0.03 to 0.12; 0.15 is 9 points at 90 %, 15 at 50 %.
SPREAD = 0.15
GESTURE_SPREAD = 0.25  # the same of the accuracy of one gesture: HAART's is 0.0 to 0.45
PRIOR_PEOPLE = 8  # people that this spread counts for
MEAN_LEVEL, PERSON_LEVEL = 0.95, 0.9  # probabilities of the two bounds
ALPHA = 0.05  # of the test
POWER_LOSS = 0.1  # the power of the test is that for this loss of accuracy


@dataclass(frozen=True)
class Bounds:
    """Accuracy to expect for a new person; the mean only, if there are fewer than five people.

    Attributes:
        mean: mean accuracy over people.
        mean_low: the mean of the next ``next_people`` people or more exceeds it with 95 %
            probability.
        person_low: the next person exceeds it with 90 % probability.
        next_people: number of next people.
    """

    mean: float
    mean_low: float | None
    person_low: float | None
    next_people: int | None


@dataclass(frozen=True)
class Agreement:
    """Result of the test of people who came later.

    Attributes:
        agrees: False if they are worse than certified (``p`` < 0.05).
        p: probability of people as bad as these or worse, if the certificate is true.
        power: probability that the test with so many people detects a loss of ten points.
    """

    agrees: bool
    p: float
    power: float


def new_person_bounds(right: np.ndarray, total: np.ndarray, spread: float = SPREAD) -> Bounds:
    """Bounds of the accuracy for a new person, of a system that was not fitted on the people.

    Args:
        right: number of correctly classified captures of each person. If the system was chosen
            among candidates, the captures are classified by the candidate that the other people
            choose.
        total: captures of each person.
        spread: `SPREAD` for all gestures together, `GESTURE_SPREAD` for one gesture.
    """
    right, total = np.asarray(right, float), np.asarray(total, float)
    mean, people = float((right / total).mean()), count_next_people(len(right))
    if len(right) < few.FEWEST_FOR_INTERVAL:
        return Bounds(mean, None, None, None)
    mean_low = lower_bound(right, total, MEAN_LEVEL, people, spread)
    person_low = lower_bound(right, total, PERSON_LEVEL, 1, spread)
    return Bounds(mean, float(mean_low), float(person_low), people)


def compare_with_certificate(
    certificate_right: np.ndarray,
    certificate_total: np.ndarray,
    right: np.ndarray,
    total: np.ndarray,
) -> Agreement | None:
    """Test whether people who came later are as accurate as certified: one-sided t-test on angles.

    The variance is that of the certificate, so a fault that harms people unequally cannot hide in
    its own spread. The test rejects exactly the people whose mean angle is below the bound for
    their number. None if the certificate has fewer than five people and thus no bound.
    """
    certified = len(certificate_right)
    if certified < few.FEWEST_FOR_INTERVAL:
        return None
    angle, variance = _mean_and_variance(certificate_right, certificate_total, SPREAD)
    error = np.sqrt(variance * (1 / certified + 1 / len(right)))
    p = stdtr(certified - 1, (_accuracy_angles(right, total).mean() - angle) / error)
    mean = np.sin(angle) ** 2
    loss = angle - np.arcsin(np.sqrt(max(mean - POWER_LOSS, 0)))
    power = nctdtr(certified - 1, -loss / error, stdtrit(certified - 1, ALPHA))
    return Agreement(bool(p >= ALPHA), float(p), float(power))


def count_next_people(people: int) -> int:
    """Number of next people whose mean is bounded: half as many as were recorded, at least 4."""
    return max(4, (people + 1) // 2)


def lower_bound(
    right: np.ndarray, total: np.ndarray, level: float, people: int, spread: float = SPREAD
) -> np.ndarray:
    """Bound that the mean accuracy of the next people exceeds with a probability.

    Args:
        right: correctly classified captures [..., people].
        total: captures [..., people].
        level: the probability.
        people: number of next people: 1 for the accuracy of the next person.
        spread: SD between people in other studies, in radians.
    """
    angle, variance = _mean_and_variance(right, total, spread)
    known = np.shape(right)[-1]
    angle = angle - stdtrit(known - 1, level) * np.sqrt(variance * (1 / known + 1 / people))
    low = np.sin(np.clip(angle, 0, np.pi / 2)) ** 2
    if people == 1:
        return low
    # The mean of accuracies is nearer to one half than the accuracy of the mean angle, here for a
    # normal distribution.
    return np.minimum(low, 0.5 + (low - 0.5) * np.exp(-2 * variance))


def _mean_and_variance(
    right: np.ndarray, total: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean angle of people, and the variance of a person.

    The variance is that of the people, or its mean with that of other studies if it is larger.
    """
    angles = _accuracy_angles(right, total)
    own, known = angles.var(axis=-1, ddof=1), angles.shape[-1]
    within = (1 / (4 * np.asarray(total) + 2)).mean(axis=-1)  # of a person's captures
    other = spread**2 + within
    pooled = ((known - 1) * own + PRIOR_PEOPLE * other) / (known - 1 + PRIOR_PEOPLE)
    return angles.mean(axis=-1), np.maximum(own, pooled)


def _accuracy_angles(right: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Freeman and Tukey's angles of accuracies, with a variance of 1 / (4 total + 2)."""
    right, total = np.asarray(right, float), np.asarray(total, float)
    low, high = right / (total + 1), (right + 1) / (total + 1)
    return (np.arcsin(np.sqrt(low)) + np.arcsin(np.sqrt(high))) / 2
