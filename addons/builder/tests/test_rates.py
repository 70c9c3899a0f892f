"""Bounds of rates and times of a new person, on generated people of known rates."""

import numpy as np
import pytest

from touchbench_builder import rates
from touchbench_builder.bounds import count_next_people
from touchbench_builder.rates import compare_rates, new_person_rate_bounds, new_person_time_bounds

REPEATS = 150


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    monkeypatch.setattr(rates, "DRAWS", 3000)


def draw_people(shape, mean, hours, people, rng):
    """True rates of people, counted events and hours."""
    true = rng.gamma(shape, mean / shape, people)
    return true, rng.poisson(true * hours), np.full(people, hours)


@pytest.mark.parametrize(
    ("shape", "mean", "hours", "known"),
    [(1000, 15, 0.3, 10), (1, 5, 0.3, 10), (0.6, 15, 0.3, 12), (6, 0.35, 48, 6)],
)
def test_bounds_of_rates_hold_and_honest_people_are_rarely_rejected(shape, mean, hours, known):
    rng, held, rejected = np.random.default_rng(4), [], []
    later = count_next_people(known)
    for _ in range(REPEATS):
        true, events, amounts = draw_people(shape, mean, hours, known + later, rng)
        bounds = new_person_rate_bounds(events[:known], amounts[:known])
        assert bounds.mean == pytest.approx(events[:known].sum() / amounts[:known].sum())
        held.append(
            (true[known:].mean() <= bounds.mean_high, (true[known:] <= bounds.person_high).mean())
        )
        sides = events[:known], amounts[:known], events[known:], amounts[known:]
        rejected.append(compare_rates(*sides) < 0.05)
    mean_held, person_held = np.mean(held, axis=0)
    assert mean_held >= 0.94 and person_held >= 0.88  # less chance of the repeats
    assert np.mean(rejected) <= 0.08
    certificate = np.full(known, mean * hours), np.full(known, hours)  # of equal people
    assert compare_rates(*certificate, np.full(later, 20 * mean * hours), sides[3]) < 0.0125


def test_bounds_without_any_event_and_of_too_few_people():
    found = new_person_rate_bounds(np.zeros(10), np.full(10, 0.5))
    # with one rate for all, 3 events in the 5 hours would be seen with 95 %
    assert found.mean == 0 and 0.3 < found.mean_high < 4 * 3 / 5
    assert new_person_rate_bounds([1, 2], [1, 1]) == rates.UpperBounds(1.5, None, None)
    assert new_person_time_bounds([0.5, 0.7]) == rates.UpperBounds(pytest.approx(0.6), None, None)


@pytest.mark.parametrize("sd", [0.05, 0.1, 0.2])
def test_bounds_of_times_hold(sd):
    rng, held = np.random.default_rng(2), []
    for _ in range(1000):
        times = np.exp(rng.normal(-0.4, sd, 18))
        bounds = new_person_time_bounds(times[:10])
        held.append(
            (times[10:].mean() <= bounds.mean_high, (times[10:] <= bounds.person_high).mean())
        )
    assert (np.mean(held, axis=0) >= [0.93, 0.89]).all()
