"""The numbers of runs on recordings are those in ``numbers``; see `tests.net.numbers`."""

from pathlib import Path

import pytest

from tests.net import numbers
from touchbench_streams import watch

STREAMS = {name: value for name, value in numbers.ON.items() if name != "where"}


@pytest.mark.parametrize("detector", ["frames", "threshold"])
def test_numbers_are_what_they_were(detector, request, monkeypatch):
    monkeypatch.setitem(numbers.RUNS, detector, lambda: watch(model="bayes", detector=detector, **STREAMS))
    stored = Path(__file__).parent / f"numbers/watch_{detector}.csv"
    numbers.compare(stored, numbers.tables(detector), request.config.getoption("exact"))
