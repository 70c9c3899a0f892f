"""A bounded run of `tests.fuzz.commands`."""

from tests.fuzz.commands import CLASSES, fuzz, judged


def test_lines_from_the_grammar_are_done_or_refused(tmp_path):
    counts, bad = fuzz(60, 1, tmp_path)
    assert not bad
    assert counts["refused"] > 10 and counts["right"] > 3


def test_bad_ends_are_told_from_good_ones():
    assert judged(2, "bench: no\n")[0] == "refused"
    for code, said in ((2, ""), (2, "bench: a\nbench: b\n"), (2, "bench: " + "a" * 400), (1, "bench: no"), (3, "")):
        assert judged(code, said)[0] == "wrong"
    assert judged("Traceback ...", "")[0] == judged(0, "Traceback (most")[0] == "traceback"
    assert judged(1, "fold 1 failed: no")[0] == "fold failed"
    assert set(CLASSES[3:]) == {"wrong", "traceback", "beyond"}
