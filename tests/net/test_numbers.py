"""The numbers of every system, feature set, fault and kind of run are those in ``numbers``; see `tests.net.numbers`."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.net import numbers

SLOW = ("jung2017_svm_rbf", "ta2015_svm", "reflex")

CASES = [
    pytest.param(*case, id="-".join(case), marks=[pytest.mark.nightly] * (case[1] in SLOW)) for case in numbers.cases()
]


@pytest.mark.parametrize(("group", "name"), CASES)
def test_numbers_are_what_they_were(request, group, name):
    stored, found = numbers.FOLDER / group / f"{name}.csv", Path("found.csv")
    numbers.GROUPS[group](name).to_csv(found, index=False)
    if request.config.getoption("golden"):
        stored.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(found, stored)
    exact = request.config.getoption("exact")
    assert [*numbers.differences(numbers.read(stored), numbers.read(found), exact)] == []


def test_all_that_is_stored_is_compared():
    assert set(numbers.stored()) == set(numbers.cases())


def test_a_changed_last_digit_is_told():
    before = numbers.read(numbers.FOLDER / "models/svm.csv")
    after = before.copy()
    after.iloc[3, 1] = np.nextafter(after.iloc[3, 1], 2)
    (line,) = numbers.differences(before, after, exact=True)
    assert line.startswith(f"{before.columns[1]} in rows [3]: ")
    assert not [*numbers.differences(before, after, exact=False)]
