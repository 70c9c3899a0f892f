"""Accuracy to expect for a new person: bounds from a few people, and a test of them.

Arguments of all functions: ``right`` and ``total``, correctly classified and all captures of each
person [..., people]. ``total`` is at least 1. Accuracies are fractions of 1.

A person is one value. Spread and bounds are on the scale of angles (arcsine of the square root),
where the spread between people depends little on the accuracy (Anscombe 1948) and a bound stays
above 0. The angle is that of the mean accuracy, which few bad people move more than a mean angle.
Few people often resemble each other by chance. Their variance is therefore taken together with
that of `PRIOR_PEOPLE` more people, whose spread is `SPREAD`, and is never taken to be less than
their own. The page of this add-on has the coverage.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import nctdtr, stdtr, stdtrit

from bench.values import few

# SD between people, in radians: 8 points at 90 %, 14 at 50 %. Five systems have 0.11 to 0.12 on the
# 31 people of CoST (Jung et al. 2017).
SPREAD = 0.14
GESTURE_SPREAD = 0.25  # of the accuracy of one gesture; HAART's is 0.0 to 0.45
PRIOR_PEOPLE = 4  # people that this spread counts for
ADDED = 3 / 8  # of Anscombe: captures added to the right ones, and to the wrong ones
FEWEST_NEXT = 8  # people: the mean of fewer varies so much that its bound says little
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
        agrees: False if they are worse than certified (``p`` below the level of the test).
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
        spread: `SPREAD` for all gestures together, `gesture_spread` for one gesture.
    """
    right, total = np.asarray(right, float), np.asarray(total, float)
    mean, people = float((right / total).mean()), count_next_people(len(right))
    if len(right) < few.FEWEST_FOR_INTERVAL:
        return Bounds(mean, None, None, None)
    mean_low = lower_bound(right, total, MEAN_LEVEL, people, spread)
    person_low = lower_bound(right, total, PERSON_LEVEL, 1, spread)
    return Bounds(mean, float(mean_low), float(person_low), people)


def gesture_spread(counts: Iterable[tuple[np.ndarray, np.ndarray]]) -> float:
    """SD between people in the accuracy of one gesture: `GESTURE_SPREAD`, or that of all gestures.

    One gesture of one person is few captures, so its own spread is uncertain.

    Args:
        counts: ``right`` and ``total`` of each gesture.
    """
    squares = [
        _own_variance(right, total)[1] - _variance_within(total)
        for right, total in counts
        if len(right) >= few.FEWEST_FOR_INTERVAL
    ]
    return float(np.sqrt(max(GESTURE_SPREAD**2, np.mean(squares or [0]))))


def compare_with_certificate(
    certificate_right: np.ndarray,
    certificate_total: np.ndarray,
    right: np.ndarray,
    total: np.ndarray,
    level: float = ALPHA,
) -> Agreement | None:
    """Test whether people who came later are as accurate as certified: one-sided t-test on angles.

    The variance is that of the certificate, so a fault that harms people unequally cannot hide in
    its own spread. The test rejects exactly the people whose mean accuracy is below the bound for
    their number. Honest people are rejected with a probability of ``level`` at most. None if the
    certificate has fewer than five people and thus no bound.
    """
    certified = len(certificate_right)
    if certified < few.FEWEST_FOR_INTERVAL:
        return None
    angle, variance = _angle_and_variance(certificate_right, certificate_total, SPREAD)
    error = np.sqrt(variance * (1 / certified + 1 / len(right)))
    freedom = certified - 1 + PRIOR_PEOPLE
    later = np.arcsin(np.sqrt(_shares(right, total).mean()))
    p = stdtr(freedom, (later - angle) / error)
    mean = np.sin(angle) ** 2
    loss = angle - np.arcsin(np.sqrt(max(mean - POWER_LOSS, 0)))
    power = nctdtr(freedom, -loss / error, stdtrit(freedom, level))
    return Agreement(bool(p >= level), float(p), float(power))


def count_next_people(people: int) -> int:
    """Number of next people whose mean is bounded: half as many as were recorded, at least 8."""
    return max(FEWEST_NEXT, (people + 1) // 2)


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
    angle, variance = _angle_and_variance(right, total, spread)
    known = np.shape(right)[-1]
    quantile = stdtrit(known - 1 + PRIOR_PEOPLE, level)
    angle = angle - quantile * np.sqrt(variance * (1 / known + 1 / people))
    low = np.sin(np.clip(angle, 0, np.pi / 2)) ** 2
    added = 2 * ADDED * (1 / np.asarray(total, float)).mean(axis=-1)
    return np.clip(low + (low - 0.5) * added, 0, 1)  # without the added captures


def _angle_and_variance(
    right: np.ndarray, total: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Angle of the mean accuracy, and the variance of a person.

    The variance is that of the people together with other studies, or their own if it is larger.
    """
    angle, own = _own_variance(right, total)
    freedom = np.shape(right)[-1] - 1
    other = spread**2 + _variance_within(total)
    pooled = (freedom * own + PRIOR_PEOPLE * other) / (freedom + PRIOR_PEOPLE)
    return angle, np.maximum(own, pooled)


def _own_variance(right: np.ndarray, total: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle of the mean accuracy, and the variance of people around it, both as angles."""
    shares = _shares(right, total)
    mean = shares.mean(axis=-1)
    return np.arcsin(np.sqrt(mean)), shares.var(axis=-1, ddof=1) / (4 * mean * (1 - mean))


def _variance_within(total: np.ndarray) -> np.ndarray:
    """Variance of the angle of a person's captures, mean over people."""
    return (1 / (4 * np.asarray(total) + 2)).mean(axis=-1)


def _shares(right: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Accuracies, none of which is 0 or 1: a few captures are added."""
    return (np.asarray(right, float) + ADDED) / (np.asarray(total, float) + 2 * ADDED)
