"""Messages of folds, from their process to the bar, and the time left."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from bench import progress
from bench.progress import Message, messages, note, tell, telling
from bench.work import workers
from bench.work.bar import Bar
from bench.work.results import FoldResult


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)


def words(folder):
    return {message.fold: message.words for message in messages(folder)}


def test_the_last_message_is_seen_until_the_end_of_the_innermost(tmp_path, monkeypatch):
    tell("nobody listens")
    with telling(tmp_path, "outer"):
        tell("zero")
        tell("one")
        with telling(None):
            tell("two")
        assert words(tmp_path) == {"outer": "two"}
        with telling(tmp_path, "inner"):
            tell("three")
            assert words(tmp_path) == {"inner": "three", "outer": "two"}
        monkeypatch.setattr(progress, "OFTEN_S", 1e9)
        tell("too often")
        assert words(tmp_path) == {"outer": "two"}
    tell("again nobody")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["../victim", "{}/victim", ".hidden", "a/b", "nul\0", "x" * 300, ""])
def test_a_name_is_no_path(name, tmp_path):
    victim, folder = tmp_path / "victim", tmp_path / "messages"
    victim.write_text("mine")
    folder.mkdir()
    name = name.format(tmp_path)
    with telling(folder, name):
        tell("half")
        assert words(folder) == {name: "half"}
    assert victim.read_text() == "mine" and not list(folder.iterdir())


def test_a_fold_tells_under_its_name(tmp_path):
    seen = []

    class Telling:
        def fold(self, cell, corpus, fold, threads):
            seen.extend(messages(tmp_path))
            tell("half", 3.0)
            seen.extend(messages(tmp_path))
            time.sleep(0.05)
            return FoldResult(fold.name)

        def fold_metrics(self, result, rate_hz):
            return {"rate": rate_hz}

    corpus, fold = SimpleNamespace(rate_hz=9.0), SimpleNamespace(name="anna")
    result = workers.do_fold(Telling(), None, corpus, fold, 1, "key of svm", tmp_path)
    assert [message[:4] for message in seen] == [("key of svm", "anna", "", None), ("key of svm", "anna", "half", 3.0)]
    assert result.seconds >= 0.05 and result.scored == {"rate": 9.0} and messages(tmp_path) == []


def test_time_left_by_hand():
    left = progress.seconds_left
    assert left([], [], 5, 2) is None and left([], [(1.0, None)], 5, 2) is None
    assert left([10.0], [], 4, 2) == 20  # two rounds of two
    assert left([10.0, 20.0], [(5.0, None)], 0, 2) == 10  # a usual one takes 15
    assert left([10.0], [(30.0, None)], 0, 1) == 2  # longer than usual: the mean is 20 now, a tenth of it
    assert left([10.0], [(30.0, None)], 1, 1) == 22  # and the next one takes 20
    assert left([10.0], [(4.0, None), (4.0, None)], 1, 2) == 16  # the first that is free takes it
    assert left([], [(5.0, 5.0)], 3, 2) is None  # before a fold is done
    assert left([10.0], [(5.0, 5.0)], 3, 2) == 20  # 5 and 10 s end two, the other goes on at 5, 15 and 10, 20
    assert left([10.0], [(0.0, -3.0)], 0, 1) == 0


FOLDS_OF_UNEQUAL_SIZE = (57.0, 430.0, 29.0)  # seconds; recorded when lines had 57 s, 8 min 7 s and 29 s left


@pytest.mark.parametrize("seconds", [FOLDS_OF_UNEQUAL_SIZE, FOLDS_OF_UNEQUAL_SIZE[::-1], (20.0,) * 10])
def test_the_time_left_of_unequal_folds_does_not_jump(seconds, tmp_path, monkeypatch):
    """One worker, the bar drawn four times a second: never an estimate before a fold is done, never a leap after."""
    clock = 1000.0
    monkeypatch.setattr("bench.work.bar.time", SimpleNamespace(time=lambda: clock))
    seen = []
    bar = Bar(tmp_path)
    bar.begin("a", "svm", len(seconds), 0, lambda: 1)
    for number, needed in enumerate(seconds, 1):
        began = clock
        note(tmp_path, Message("a", str(number), "", None, began, began))
        while clock < began + needed:
            [*bar.get_renderables()]
            (run,) = bar.tasks
            assert bool(run.fields["left"]) == (number > 1) and run.fields["left"][:6] in ("", "about ", "less t")
            seen += [bar.shown[("a", "")][0]] if number > 1 else []
            clock += 0.25
        progress.forget(tmp_path, "a", str(number))
        bar.advance_fold("a", FoldResult(str(number), seconds=needed))
    assert (np.abs(np.diff(seen)) <= 0.25 + 0.01 * max(seconds)).all()
    if len({*seconds}) == 1:
        assert seen == pytest.approx([sum(seconds[1:]) - 0.25 * i for i in range(len(seen))], abs=1.0)


def test_an_estimate_counts_down_and_settles():
    assert progress.smoothed(None, 60.0, 0.0) == 60 and progress.smoothed(60.0, 50.0, 10.0) == 50
    assert progress.smoothed(30.0, 100.0, 0.0) == 30  # at once nothing changes
    assert progress.smoothed(30.0, 100.0, 20.0) == pytest.approx(100 - 90 / np.e)  # 10 by then, and on its way to 100
    assert progress.smoothed(5.0, 0.0, 10.0) == 0  # never below 0


def test_estimates_are_rough():
    words = {10: "10 s", 44: "40 s", 57: "1 min", 487: "8 min", 600: "10 min", 3540: "1 h", 5000: "1 h 20 min"}
    assert {seconds: progress.about(seconds) for seconds in words} == {s: f"about {text}" for s, text in words.items()}
    assert progress.about(9.9) == "less than 10 s"
