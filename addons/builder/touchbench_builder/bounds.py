"""What accuracy to expect for a new person: bounds from a few people, and the test of them on people who came later.

Args of all functions: ``right`` and ``total``, correctly classified and all captures of each person [..., people].
``total`` is at least 1. Accuracies are fractions of 1.

A person is one value. On the scale of angles (arcsine of the square root), the spread between people depends little on
the accuracy (Freeman and Tukey 1950), and Student's t holds better than on accuracies, which end at 1. Few people often
resemble each other by chance. Their variance is therefore never taken to be less than its mean with that of `WEIGHT`
people, whose spread `SPREAD` is the upper end of what HAART shows. The page of this add-on has the coverage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import nctdtr, stdtr, stdtrit

from bench.values import few

SPREAD = 0.15  # SD between people, in radians: HAART's is 0.03 to 0.12; 0.15 is 9 points at 90 % and 15 at 50 %
GESTURE_SPREAD = 0.25  # the same of the accuracy of one gesture: HAART's is 0.0 to 0.45
WEIGHT = 8  # people that this spread counts for
MEAN_LEVEL, PERSON_LEVEL = 0.95, 0.9  # probabilities of the two bounds
ALPHA = 0.05  # of the test
DROP = 0.1  # the power of the test is that for this loss of accuracy


@dataclass(frozen=True)
class Bounds:
    """What to expect for a new person; of fewer than five people the mean alone."""

    mean: float  # accuracy, over people
    mean_low: (
        float | None
    )  # with 95 % probability, the mean of the next ``next_people`` people or more exceeds it
    person_low: float | None  # the next person exceeds it with 90 % probability
    next_people: int | None


@dataclass(frozen=True)
class Check:
    """Result of the test of people who came later."""

    agrees: bool  # False if they are worse than certified (``p`` < 0.05)
    p: float  # probability of people as bad as these or worse, if the certificate is true
    power: float  # probability that the test finds a loss of ten points of accuracy with so many people


def new_person(right: np.ndarray, total: np.ndarray, spread: float = SPREAD) -> Bounds:
    """The accuracy to expect for a new person, of a system that never saw the people of the counts.

    Args:
        right: number of correctly classified captures of each person. If the system was chosen among candidates, the
            captures are classified by the candidate that the other people choose.
        total: captures of each person.
        spread: `SPREAD` for all gestures together, `GESTURE_SPREAD` for one gesture.
    """
    right, total = np.asarray(right, float), np.asarray(total, float)
    mean, people = float((right / total).mean()), ahead(len(right))
    if len(right) < few.INTERVAL:
        return Bounds(mean, None, None, None)
    mean_low = lower_bound(right, total, MEAN_LEVEL, people, spread)
    return Bounds(
        mean, float(mean_low), float(lower_bound(right, total, PERSON_LEVEL, 1, spread)), people
    )


def agrees(
    certificate_right: np.ndarray,
    certificate_total: np.ndarray,
    right: np.ndarray,
    total: np.ndarray,
) -> Check | None:
    """Whether people who came later are as accurate as certified: a one-sided t-test on angles.

    The variance is that of the certificate, so that a fault that harms people unequally cannot hide in its own spread.
    The test rejects exactly the people whose mean angle is below the bound for their number. None if the certificate
    has fewer than five people and thus no bound.
    """
    certified = len(certificate_right)
    if certified < few.INTERVAL:
        return None
    angle, variance = _people(certificate_right, certificate_total, SPREAD)
    error = np.sqrt(variance * (1 / certified + 1 / len(right)))
    p = stdtr(certified - 1, (_angles(right, total).mean() - angle) / error)
    mean = np.sin(angle) ** 2
    loss = angle - np.arcsin(np.sqrt(max(mean - DROP, 0)))
    power = nctdtr(certified - 1, -loss / error, stdtrit(certified - 1, ALPHA))
    return Check(bool(p >= ALPHA), float(p), float(power))


def ahead(people: int) -> int:
    """For how many next people the bound of the mean is: half as many as are known, at least four."""
    return max(4, (people + 1) // 2)


def lower_bound(
    right: np.ndarray, total: np.ndarray, level: float, people: int, spread: float = SPREAD
) -> np.ndarray:
    """What the mean accuracy of so many next people exceeds with this probability.

    Args:
        right: correctly classified captures [..., people].
        total: captures [..., people].
        level: the probability.
        people: number of next people: 1 for the accuracy of a next person.
        spread: SD between people that is known from other studies, in radians.
    """
    angle, variance = _people(right, total, spread)
    known = np.shape(right)[-1]
    angle = angle - stdtrit(known - 1, level) * np.sqrt(variance * (1 / known + 1 / people))
    low = np.sin(np.clip(angle, 0, np.pi / 2)) ** 2
    if people == 1:
        return low
    # The mean of accuracies is nearer to one half than the accuracy of the mean angle, here that of a normal spread
    return np.minimum(low, 0.5 + (low - 0.5) * np.exp(-2 * variance))


def _people(right: np.ndarray, total: np.ndarray, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean angle of people, and the variance of one: their own, or its mean with that of other studies, if larger."""
    angles = _angles(right, total)
    own, known = angles.var(axis=-1, ddof=1), angles.shape[-1]
    other = spread**2 + (1 / (4 * np.asarray(total) + 2)).mean(
        axis=-1
    )  # between people, and of a person's captures
    return angles.mean(axis=-1), np.maximum(
        own, ((known - 1) * own + WEIGHT * other) / (known - 1 + WEIGHT)
    )


def _angles(right: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Freeman and Tukey's angles of accuracies, with a variance of 1 / (4 total + 2)."""
    right, total = np.asarray(right, float), np.asarray(total, float)
    return (
        np.arcsin(np.sqrt(right / (total + 1))) + np.arcsin(np.sqrt((right + 1) / (total + 1)))
    ) / 2
