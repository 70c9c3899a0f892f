"""Sizes that cannot be are refused before any memory is asked for."""

import resource

import pytest

from bench.errors import InputError
from bench.options import KEYS, parse
from bench.plan.cells import cells
from bench.plan.plan import planned


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
