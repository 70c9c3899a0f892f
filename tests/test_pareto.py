"""Fronts, beside a comparison of all pairs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.pareto import front

VALUES = st.sampled_from([0.0, 1.0, 2.0, 3.0, np.nan])


@given(st.lists(st.tuples(VALUES.filter(lambda v: v == v), VALUES), max_size=12))
def test_the_front_has_what_no_other_point_beats(points):
    """A point beats another one that is no more accurate and no cheaper, if it is better in one; nan is on no front."""

    def beats(p, q):
        return p[0] >= q[0] and p[1] <= q[1] and p != q

    accuracy, cost = np.array(points).reshape(-1, 2).T
    expected = [q[1] == q[1] and not any(beats(p, q) for p in points) for q in points]
    assert front(accuracy, cost).tolist() == expected
