"""A bounded run of `tests.fuzz.folders`; the long one is by hand."""

from tests.fuzz.folders import fuzz


def test_damaged_folders_are_refused_or_right():
    counts, bad = fuzz(40, 0)
    assert not bad, bad
    assert counts["all", "refused"] > 8 and counts["all", "right"] > 8
    assert counts["all", "refused"] + counts["all", "right"] == 40
