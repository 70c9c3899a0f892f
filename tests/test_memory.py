"""Sizes that cannot be are refused before any memory is asked for."""

import resource
from pathlib import Path

import psutil
import pytest

from bench.errors import InputError
from bench.memory import available
from bench.options import KEYS, parse
from bench.plan.cells import cells
from bench.plan.plan import planned


def test_the_limit_of_a_container_counts_where_it_is_lower(monkeypatch):
    free, real = psutil.virtual_memory().available, Path.read_text
    assert 0 < available() <= psutil.virtual_memory().total
    for text, expected in (("1000\n", 1000), ("max\n", free), (f"{2**62}", free)):
        read = lambda self, text=text: text if "cgroup" in str(self) else real(self)  # noqa: E731
        monkeypatch.setattr(Path, "read_text", read)
        monkeypatch.setattr(psutil, "virtual_memory", lambda: type("M", (), {"available": free}))
        assert available() == expected


@pytest.mark.parametrize(
    ("typed", "fact"),
    [
        ("data.rows=1000000 data.cols=1000000", "TB of memory"),
        ("data.rate_hz=1e308", "of memory"),
        ("data.subjects=1000000000000", "1000000"),
        ("model=cnn85 model.frames=1000000 model.batch=1000000", "256 TB"),
        ("model=rf model.trees=99999999999999999999", "1000000"),
        ("model=rf seed=4294967296", "4294967295"),
        ("model=" + 3000 * "a", "zhou2016_lrcn"),
        (3000 * "a" + "=1", "no key"),
    ],
)
def test_sizes_that_cannot_be_are_refused(typed, fact):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=fact):
        planned(cells(parse(typed.split(" "), KEYS)), 1)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB
