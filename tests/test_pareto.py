"""Fronts and dominating points, beside a comparison of all pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.pareto import dominated_by, front

VALUES = st.sampled_from([0.0, 1.0, 2.0, 3.0, np.nan])


@pytest.mark.parametrize("number", [1, 3])
@given(st.data())
def test_dominated_by_is_what_all_pairs_give(number, data):
    """Of several, the most accurate, and of these the first; the front has those of one cost that nothing dominates."""
    points = np.array(data.draw(st.lists(st.tuples(*[VALUES] * (number + 1)), max_size=12))).reshape(-1, number + 1)
    accuracy, costs = points[:, 0], points[:, 1:]
    expected = []
    for point in points:
        others = [i for i, p in enumerate(points) if p[0] >= point[0] and (p[1:] <= point[1:]).all()]
        better = [i for i in others if points[i, 0] > point[0] or (points[i, 1:] < point[1:]).any()]
        expected.append(max(better, key=lambda i: (accuracy[i], -i), default=-1))
    known = ~np.isnan(points).any(axis=1)
    assert dominated_by(accuracy, costs).tolist() == np.where(known, expected, -1).tolist()
    if number == 1:
        assert front(accuracy, costs[:, 0])[known].tolist() == (np.array(expected)[known] < 0).tolist()
        assert not front(accuracy, costs[:, 0])[np.isnan(costs[:, 0])].any()
