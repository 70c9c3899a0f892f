"""Messages of folds, from their process to the bar, and the time left."""

import time
from types import SimpleNamespace

import pytest

from bench import progress
from bench.outcomes.results import FoldResult
from bench.progress import messages, tell, telling
from bench.work import workers


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
    assert left([10.0], [(30.0, None)], 0, 1) == 1  # longer than usual: a tenth of it
    assert left([10.0], [(4.0, None), (4.0, None)], 1, 2) == 16  # the first that is free takes it
    assert left([], [(5.0, 5.0)], 3, 2) == 20  # 5 and 10 s end two, the other goes on at 5, 15 and 10, 20
    assert left([], [(0.0, -3.0)], 0, 1) == 0
