"""Missed touches at a rate of false alarms, by hand and by a naive loop."""

import numpy as np
import pandas as pd
import pytest

from bench.intervals import weights
from touchbench_streams.curve import missed_at, swept


def sweep_of(rows):
    """Rows of a sweep from (offset, subject, hits, alarms, reports)."""
    return pd.DataFrame(rows, columns=["offset", "subject", "hits", "alarms", "reports"])


def test_the_best_threshold_that_keeps_to_the_rate_counts():
    table = sweep_of(
        [
            *((-1.0, "a", 10, 30, 80), (-1.0, "b", 10, 0, 10)),  # reports always
            *((0.0, "a", 9, 4, 13), (0.0, "b", 9, 1, 11)),
            *((1.0, "a", 6, 1, 8), (1.0, "b", 7, 0, 7)),
            (2.0, "a", 1, 0, 1),  # not tried for the other subject
        ]
    )
    numbers = missed_at(swept(table), pd.Series({"a": 10, "b": 10}), pd.Series({"a": 0.5, "b": 0.5}))
    assert numbers["missed_at_5"] == pytest.approx(1 - 18 / 20)
    assert numbers["missed_at_1"] == pytest.approx(1 - 13 / 20)
    assert np.isnan(numbers["missed_at_5_low"])  # two people


def test_the_interval_is_that_of_drawings():
    rng = np.random.default_rng(3)
    people, offsets = list("abcdef"), np.arange(-2.0, 3.0)
    touches = dict(zip(people, [8, 5, 12, 9, 7, 0], strict=True))
    hours = dict(zip(people, [0.5, 0.2, 0.4, 0.6, 0.3, 0.4], strict=True))
    table = sweep_of(
        [(o, p, h := rng.integers(0, touches[p] + 1), a := rng.integers(0, 9), h + a) for p in people for o in offsets]
    )
    numbers = missed_at(swept(table), pd.Series(touches)[:5], pd.Series(hours))
    counted = {(row.offset, row.subject): (row.hits, row.alarms) for row in table.itertuples()}
    least = []
    for drawing in weights([6])[0].tolist():
        times, most = dict(zip(people, drawing, strict=True)), -1
        for offset in offsets:
            hits, alarms = (sum(counted[offset, p][k] * times[p] for p in people) for k in (0, 1))
            if alarms <= 10 * sum(hours[p] * times[p] for p in people):
                most = max(most, hits)
        total = sum(touches[p] * times[p] for p in people)
        least += [1 - most / total] if most >= 0 and total else []
    ends = [numbers["missed_at_10_low"], numbers["missed_at_10_high"]]
    np.testing.assert_allclose(ends, np.quantile(least, [0.025, 0.975]))
