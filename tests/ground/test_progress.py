"""Durations in words."""

import pytest

from bench.ground.progress import format_estimate, format_seconds


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (59.6, "1 min 0 s"), (200, "3 min 20 s"), (7500, "2 h 5 min")],
)
def test_a_duration(seconds, words):
    assert format_seconds(seconds) == words


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "1 s"), (8.4, "8 s"), (88, "90 s"), (170, "3 min"), (5400, "90 min"), (6000, "2 h")],
)
def test_an_estimate_is_rounded(seconds, words):
    assert format_estimate(seconds) == f"about {words}"
