"""Stored numbers of every system, feature set, fault and kind of run: see `tests.net.numbers`."""

from contextlib import nullcontext

import pytest

from tests.net import numbers

SLOW = ("jung2017_svm_rbf", "ta2015_svm", "reflex")

CASES = [
    pytest.param(*case, id="-".join(case), marks=[pytest.mark.nightly] * (case[1] in SLOW))
    for case in numbers.cases()
]


@pytest.mark.parametrize(("group", "name"), CASES)
def test_numbers_are_what_they_were(request, group, name):
    stored, found = numbers.FOLDER / group / f"{name}.csv", numbers.GROUPS[group](name)
    if request.config.getoption("golden"):
        found.to_csv(stored, index=False)
    numbers.compare(stored, found, request.config.getoption("exact"))


def test_all_that_is_stored_is_compared_and_a_changed_digit_is_found():
    assert set(numbers.stored()) == set(numbers.cases())
    stored = numbers.FOLDER / "models/svm.csv"
    for factor, exact, differs in (
        (1 + 4e-16, True, True),
        (1.01, False, True),
        (1 + 1e-9, False, False),
    ):
        changed = numbers.read(stored)
        changed.iloc[3, 1] *= factor
        with pytest.raises(AssertionError, match=changed.columns[1]) if differs else nullcontext():
            numbers.compare(stored, changed, exact)
