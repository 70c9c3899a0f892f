"""Bounds for a new person: against a loop with scipy, and on simulated people."""

import itertools
import math
import runpy
import statistics
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from touchbench_builder.bounds import (
    ALPHA,
    compare_with_certificate,
    count_next_people,
    gesture_spread,
    lower_bound,
    new_person_bounds,
)
from touchbench_builder.check import LEVELS

STUDY = runpy.run_path(str(Path(__file__).parents[3] / "studies" / "coverage.py"))
ALIKE = (
    [41, 44, 43, 46, 45, 42],
    [50, 52, 50, 55, 53, 50],
)  # fewer differences than chance alone makes
UNLIKE = ([50, 12, 55, 30, 49], [60, 48, 56, 60, 50])


def angle_by_hand(right, total):
    shares = [(r + 3 / 8) / (n + 3 / 4) for r, n in zip(right, total, strict=True)]
    return math.asin(math.sqrt(statistics.mean(shares))), shares


def low_by_hand(right, total, level, people):
    """The rule of the page, and its parts: angle, variance, low angle."""
    angle, shares = angle_by_hand(right, total)
    known, mean = len(shares), statistics.mean(shares)
    own = statistics.variance(shares) / (4 * mean * (1 - mean))
    other = 0.14**2 + statistics.mean(1 / (4 * n + 2) for n in total)
    variance = max(own, ((known - 1) * own + 4 * other) / (known + 3))
    error = math.sqrt(variance / known + variance / people)
    low = angle - stats.t.ppf(level, known + 3) * error
    share = math.sin(low) ** 2
    low_share = share + 0.75 * (share - 0.5) * statistics.mean(1 / n for n in total)
    return low_share, angle, variance, low


@pytest.mark.parametrize("counts", (ALIKE, UNLIKE))
def test_bounds_are_those_of_a_loop(counts):
    found = new_person_bounds(*counts)
    accuracies = [r / n for r, n in zip(*counts, strict=True)]
    assert found.mean == pytest.approx(statistics.mean(accuracies))
    assert found.mean_low == pytest.approx(low_by_hand(*counts, 0.95, 8)[0])
    assert found.person_low == pytest.approx(low_by_hand(*counts, 0.9, 1)[0])
    assert found.next_people == 8
    assert [count_next_people(known) for known in (8, 16, 17, 31)] == [8, 8, 9, 16]


@pytest.mark.parametrize(
    ("right", "total", "mean", "lowest", "highest"),
    [([50] * 5, 50, 1, 0.85, 0.97), ([0] * 5, 50, 0, 0, 0), ([8, 9, 7, 8], 10, 0.8, None, None)],
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


QUICK = list(itertools.product(("beta", "bimodal", "logit"), (0.6, 0.9), (0.12,), (5, 8), (30, 60)))


def too_sharp(right, total, level, people):
    """Normal errors of the captures of all people together, as if all were alike."""
    share = right.sum(axis=-1) / total.sum(axis=-1)
    error = np.sqrt(share * (1 - share) / total.sum(axis=-1) + share * (1 - share) / total[..., 0])
    return share - stats.norm.ppf(level) * error / np.sqrt(people)


def test_bounds_hold_and_rules_that_are_too_sharp_do_not():
    assert STUDY["failing_cases"](lower_bound, QUICK, 1500).empty
    for rule in (STUDY["student"], too_sharp):
        assert not STUDY["failing_cases"](rule, QUICK, 1500).empty


@pytest.mark.nightly
def test_bounds_hold_for_all_simulated_people():
    assert STUDY["failing_cases"](lower_bound, STUDY["all_cases"]()).empty


def test_spread_of_a_gesture_is_that_of_all_gestures_if_they_differ_more_than_usual():
    rng = np.random.default_rng(0)
    for spread, expected in ((0.1, 0.25), (0.3, 0.3)):
        right = rng.binomial(40, 0.5 + spread * rng.choice([-1, 1], (60, 8)))
        found = gesture_spread((row, np.full(8, 40)) for row in right)
        assert found == pytest.approx(expected, abs=0.03)
    assert gesture_spread([([3, 4], [5, 5])]) == 0.25  # too few people


@pytest.mark.parametrize("case", [("beta", 0.75, 0.12, 6, 60), ("logit", 0.6, 0.12, 12, 30)])
def test_honest_people_are_rejected_about_as_often_as_the_level_allows(case):
    right, total, later = STUDY["simulate_counts"](case, 1500)
    honest, worse = STUDY["rejections"](right, total, later, np.full_like(later, case[4]))
    assert 2 <= honest <= 6 and worse >= 30


def test_all_tests_of_a_check_together_reject_honest_people_with_the_level_at_most():
    assert sum(LEVELS.values()) == pytest.approx(ALPHA)


def test_later_people_are_tested_by_the_bound_for_their_number():
    right, total = np.array(UNLIKE)
    later = np.array([31, 25, 35])
    _, angle, variance, _ = low_by_hand(*UNLIKE, 0.95, 1)
    later_angle, _ = angle_by_hand(later, [60] * 3)
    error = math.sqrt(variance / 5 + variance / 3)
    found = compare_with_certificate(right, total, later, np.full(3, 60))
    assert found.p == pytest.approx(stats.t.cdf((later_angle - angle) / error, 8))
    for level in (0.05, 0.0125):
        rejected = []
        for r in range(61):
            check = compare_with_certificate(right, total, [r, r], [60, 60], level)
            low = low_by_hand(*UNLIKE, 1 - level, 2)[3]
            assert check.agrees == (check.p >= level) == (angle_by_hand([r], [60])[0] >= low)
            rejected.append(not check.agrees)
        assert any(rejected) and not all(rejected)


def test_power_is_that_of_repeated_tests():
    certificate, later = (np.full(16, 54), np.full(16, 60)), 12
    rng, draws = np.random.default_rng(3), 40_000
    _, angle, variance, _ = low_by_hand(*certificate, 0.95, 1)
    lower = math.asin(math.sqrt(math.sin(angle) ** 2 - 0.1))
    known = rng.normal(angle, math.sqrt(variance / 16), draws)
    new = rng.normal(lower, math.sqrt(variance / later), draws)
    estimate = variance * rng.chisquare(19, draws) / 19
    found = (new - known) / np.sqrt(estimate * (1 / 16 + 1 / later)) < stats.t.ppf(0.05, 19)
    check = compare_with_certificate(*certificate, np.full(later, 54), np.full(later, 60))
    assert check.agrees
    assert check.power == pytest.approx(found.mean(), abs=0.01)
    assert compare_with_certificate(*certificate, [54], [60]).power < check.power
