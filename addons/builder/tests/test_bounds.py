"""Bounds for a new person: against loops with scipy, and on generated people of known mean."""

import math
import statistics

import numpy as np
import pytest
from scipy import stats

from touchbench_builder.bounds import (
    compare_with_certificate,
    count_next_people,
    lower_bound,
    new_person_bounds,
)

ALIKE = (
    [41, 44, 43, 46, 45, 42],
    [50, 52, 50, 55, 53, 50],
)  # fewer differences than chance alone makes
UNLIKE = ([50, 12, 55, 30, 49], [60, 48, 56, 60, 50])


def by_hand(right, total, level, people):
    """The rule of the page, one person after the other."""
    angles = []
    for r, n in zip(right, total, strict=True):
        angles.append(
            (math.asin(math.sqrt(r / (n + 1))) + math.asin(math.sqrt((r + 1) / (n + 1)))) / 2
        )
    known = len(angles)
    other = 0.15**2 + sum(1 / (4 * n + 2) for n in total) / known
    own = statistics.variance(angles)
    variance = max(own, ((known - 1) * own + 8 * other) / (known + 7))
    mean = sum(angles) / known
    return (
        mean,
        variance,
        mean - stats.t.ppf(level, known - 1) * math.sqrt(variance / known + variance / people),
    )


def generated(mean, sd, people, bad=0.0):
    """Counts of 4,000 draws of people, 60 captures each; a share ``bad`` of people loses 30 %."""
    rng = np.random.default_rng(7)
    size = mean * (1 - mean) / sd**2 - 1
    accuracy = rng.beta(mean * size, (1 - mean) * size, (4000, people))
    return rng.binomial(60, accuracy * np.where(rng.random(accuracy.shape) < bad, 0.7, 1))


@pytest.mark.parametrize("counts", (ALIKE, UNLIKE))
def test_bounds_are_those_of_a_loop(counts):
    found = new_person_bounds(*counts)
    _, variance, low = by_hand(*counts, 0.95, 4)
    assert found.mean == pytest.approx(
        sum(r / n for r, n in zip(*counts, strict=True)) / len(counts[0])
    )
    expected = stats.norm.expect(
        lambda angle: math.sin(angle) ** 2, loc=low, scale=math.sqrt(variance), lb=-9, ub=9
    )
    assert found.mean_low == pytest.approx(min(expected, math.sin(low) ** 2), abs=1e-6)
    assert found.person_low == pytest.approx(math.sin(by_hand(*counts, 0.9, 1)[2]) ** 2)
    assert found.next_people == 4 and [count_next_people(known) for known in (8, 9, 16, 31)] == [
        4,
        5,
        8,
        16,
    ]


@pytest.mark.parametrize(
    ("right", "total", "mean", "lowest", "highest"),
    [([50] * 5, 50, 1, 0.8, 0.95), ([0] * 5, 50, 0, 0, 0), ([8, 9, 7, 8], 10, 0.8, None, None)],
)
def test_bounds_without_an_error_without_a_correct_capture_and_of_too_few_people(
    right, total, mean, lowest, highest
):
    found = new_person_bounds(right, [total] * len(right))
    assert found.mean == pytest.approx(mean)
    if lowest is None:
        assert (found.mean_low, found.person_low, found.next_people) == (None, None, None)
        assert compare_with_certificate(right, [total] * len(right), [1], [total]) is None
    else:
        assert lowest <= found.mean_low <= highest and lowest <= found.person_low <= highest


@pytest.mark.parametrize(
    ("mean", "sd", "bad"), ((0.7, 0.15, 0), (0.8, 0.1, 0.1), (0.9, 0.05, 0.1), (0.98, 0.02, 0))
)
@pytest.mark.parametrize("known", (5, 8))
def test_bounds_hold_where_students_t_does_not(mean, sd, bad, known):
    counts = generated(mean, sd, known + 4, bad)
    right, later, total = counts[:, :known], counts[:, known:] / 60, np.full(known, 60)
    low, person = lower_bound(right, total, 0.95, 4), lower_bound(right, total, 0.9, 1)
    assert np.mean(low <= later.mean(axis=1)) >= 0.95
    assert (
        np.mean(low <= mean * (1 - 0.3 * bad)) >= 0.98
    )  # of everybody: more certain than that of four
    assert np.mean(person[:, None] <= later) >= 0.9
    shares = right / 60
    student = shares.mean(1) - stats.t.ppf(0.95, known - 1) * stats.sem(shares, axis=1)
    assert np.mean(student <= later.mean(axis=1)) < 0.9


def test_later_people_are_tested_by_the_bound_for_their_number():
    right, total = np.array(UNLIKE)
    later = np.array([31, 25, 35])
    mean, variance, _ = by_hand(*UNLIKE, 0.95, 1)
    angles = [by_hand([r, r], [60, 60], 0.9, 1)[0] for r in later]
    error = math.sqrt(variance / 5 + variance / 3)
    found = compare_with_certificate(right, total, later, np.full(3, 60))
    assert found.p == pytest.approx(stats.t.cdf((np.mean(angles) - mean) / error, 4))
    rejected = []
    for r in range(61):
        check = compare_with_certificate(right, total, [r, r], [60, 60])
        low = by_hand(*UNLIKE, 0.95, 2)[2]
        assert check.agrees == (check.p >= 0.05) == (by_hand([r, r], [60, 60], 0.9, 1)[0] >= low)
        rejected.append(not check.agrees)
    assert any(rejected) and not all(rejected)


def test_power_is_that_of_repeated_tests():
    certificate, later = (np.full(16, 54), np.full(16, 60)), 12
    rng, draws = np.random.default_rng(3), 40_000
    mean, variance, _ = by_hand(*certificate, 0.95, 1)
    lower = math.asin(math.sqrt(math.sin(mean) ** 2 - 0.1))
    known = rng.normal(mean, math.sqrt(variance / 16), draws)
    new = rng.normal(lower, math.sqrt(variance / later), draws)
    estimate = variance * rng.chisquare(15, draws) / 15
    found = (new - known) / np.sqrt(estimate * (1 / 16 + 1 / later)) < stats.t.ppf(0.05, 15)
    check = compare_with_certificate(*certificate, np.full(later, 54), np.full(later, 60))
    assert check.agrees
    assert check.power == pytest.approx(found.mean(), abs=0.01)
    assert compare_with_certificate(*certificate, [54], [60]).power < check.power
