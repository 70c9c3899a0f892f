"""The rule of one standard error in exact fractions, and fronts by a loop over all pairs."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.values.intervals import mean_and_error, ratio_interval, within_one_standard_error
from bench.values.pareto import is_on_front

ONE_PERSON = [(n, k, m) for n in range(2, 31) for m in (6, 7, 11, 84) for k in (0, m // 3, m - 1)]


def exactly_within(lost):
    """Mean against standard error, both squared, in fractions."""
    mean = sum(lost) / len(lost)
    square = sum((x - mean) ** 2 for x in lost) / (len(lost) - 1) / len(lost)
    return mean <= 0 or mean**2 <= square


def people(n, k, m):
    """Two systems that differ on the last of n people by one of m captures, as exact fractions."""
    rest = [Fraction((3 * i + k) % (m + 1), m) for i in range(n - 1)]
    return [*rest, Fraction(k + 1, m)], [*rest, Fraction(k, m)]


def test_a_loss_on_one_person_equals_its_standard_error():
    for case in ONE_PERSON:
        best, other = people(*case)
        assert exactly_within([a - b for a, b in zip(best, other, strict=True)])
        for scale in (1, 100):
            lost = scale * np.array(best, dtype=float) - scale * np.array(other, dtype=float)
            assert within_one_standard_error(lost), case


def test_it_is_the_exact_rule_where_several_people_differ():
    rng = np.random.default_rng(0)
    for _ in range(500):
        lost = [Fraction(int(d), 84) for d in rng.integers(-2, 4, rng.integers(2, 31))]
        assert within_one_standard_error(np.array(lost, dtype=float)) == exactly_within(lost), lost
    assert not within_one_standard_error(np.array([0.1])) and within_one_standard_error(
        np.array([1e-16])
    )
    assert mean_and_error(np.array([1.0, 3.0])) == (2.0, 1.0) and np.isnan(
        mean_and_error(np.array([2.0]))[1]
    )


VALUES = st.sampled_from([0.0, 1.0, 2.0, 3.0, np.nan])


@given(st.lists(st.tuples(VALUES.filter(lambda v: v == v), VALUES), max_size=12))
def test_the_front_has_what_no_other_point_beats(points):
    """A point beats one that is no better in both, if it is better in one; nan is on no front."""

    def beats(p, q):
        return p[0] >= q[0] and p[1] <= q[1] and p != q

    accuracy, cost = np.array(points).reshape(-1, 2).T
    expected = [q[1] == q[1] and not any(beats(p, q) for p in points) for q in points]
    assert is_on_front(accuracy, cost).tolist() == expected


def test_the_interval_of_a_ratio_is_that_of_people_drawn_with_the_usual_seed():
    hits, captures = np.array([5, 0, 3, 1, 2]), np.array([5, 1, 4, 2, 2])
    draws = np.random.default_rng(0).integers(0, 5, (2000, 5))
    shares = [sum(hits[draw]) / sum(captures[draw]) for draw in draws]
    interval = ratio_interval(np.stack([hits, captures], axis=1))
    assert interval == pytest.approx(np.quantile(shares, [0.025, 0.975]))
