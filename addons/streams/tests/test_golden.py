"""Refusals and help of the commands on streams, and numbers of runs, as golden files."""

from pathlib import Path

import pytest

from addons.streams.tests.people import TINY
from tests.net import numbers
from tests.net.build import step
from touchbench_streams import watch

STREAMS = {name: value for name, value in numbers.ON.items() if name != "where"}
LDA = ["model=lda", "features=touch"]
WRONG = [
    *(
        ["watch", *TINY, *LDA, *words]
        for words in (
            ["where=variant == 'normal'"],
            ["background=quiet"],
            ["unknown=hug"],
            ["protocol=kfold", "protocol.folds=2"],
            ["target=variant"],
            ["under=late_start"],
            ["under=nosie"],
            ["detector=threshold,frames", "detector.up=nan"],
        )
    ),
    *(
        ["fit", *TINY[:-1], *LDA, "out=rec", *words]
        for words in (
            ["detector=frames,threshold"],
            ["detector=ear"],
            ["detector=threshold", "detector.wait=1"],
            ["false_alarms=-1"],
            ["watch=no", "detector.wait=1"],
        )
    ),
    ["run", *TINY, *LDA, "form=c", "detector=frames", "detector.wiat=0.5"],
    *(
        ["choose", "max_latency=1s", word]
        for word in ("by=decision", "max_decision=1s", "unit=window", "clock=64MHz")
    ),
    ["live"],
    ["live", "nowhere"],
]


def test_help_and_refusals_are_what_they_were(golden):
    golden("help.txt", step(["watch", "--help"]) + step(["live", "--help"]))
    golden("refusals.txt", "".join(map(step, WRONG)))


@pytest.mark.parametrize("detector", ["frames", "threshold"])
def test_numbers_are_what_they_were(detector, request, monkeypatch):
    monkeypatch.setitem(
        numbers.RUNS, detector, lambda: watch(model="bayes", detector=detector, **STREAMS)
    )
    stored = Path(__file__).parent / f"numbers/watch_{detector}.csv"
    numbers.compare(stored, numbers.tables(detector), request.config.getoption("exact"))
