"""What a fold says of how far it is, from its process to the bar."""

import shutil
import sys
import time
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench import progress
from bench.cli import main
from bench.outcomes.results import FoldResult
from bench.progress import Message, messages, note, tell, telling
from bench.work import loop, workers
from models.nets.cnn85 import CNN85


def words(folder):
    return {said.fold: said.words for said in messages(folder)}


def test_what_is_told_is_seen_until_the_end(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    tell("nobody listens")
    with telling(tmp_path, "a"):
        tell("one")
        tell("two")
        assert words(tmp_path) == {"a": "two"}
    tell("again nobody")
    assert messages(tmp_path) == []
    with telling(None):
        tell("nobody")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["../victim", "{}/victim", ".hidden", "a/b", "nul\0", "x" * 300, ""])
def test_a_name_is_no_path(name, tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    victim, folder = tmp_path / "victim", tmp_path / "told"
    victim.write_text("mine")
    folder.mkdir()
    name = name.format(tmp_path)
    with telling(folder, name):
        tell("half")
        assert words(folder) == {name: "half"}
    assert victim.read_text() == "mine" and not list(folder.iterdir())


def test_the_inner_one_is_heard_first(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    with telling(tmp_path, "outer"):
        with telling(None):
            tell("one")
        assert words(tmp_path) == {"outer": "one"}
        with telling(tmp_path, "inner"):
            tell("two")
        tell("three")
        assert words(tmp_path) == {"outer": "three"}


def test_too_often_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 1e9)
    with telling(tmp_path, "a"):
        for number in range(100):
            tell(str(number))
        assert words(tmp_path) == {"a": "0"}


def test_a_folder_that_goes_stops_nobody(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    (tmp_path / "gone").mkdir()
    with telling(tmp_path / "gone", "a"):
        shutil.rmtree(tmp_path / "gone")
        tell("nobody")
    assert messages(tmp_path / "gone") == []


def test_the_bar_has_a_line_for_each_that_tells(tmp_path, monkeypatch):
    (tmp_path / "1").write_text(f'["svm", "bob", "epoch 2 of 9", 100, 0, {time.time() - 20}]')
    (tmp_path / "2").write_text('["svm", "anna", "3 trials", null, 0, 0]')
    (tmp_path / ".3").write_text("not yet")
    out = StringIO()
    monkeypatch.setattr(loop, "console", Console(file=out, width=100))
    with loop.progress(tmp_path) as bar:
        bar.add_task("svm on haart", total=2, key="svm", left="")
        for part in bar.get_renderables():
            loop.console.print(part)
    said = out.getvalue()
    assert "anna: 3 trials\n" in said.replace(" \n", "\n") and "bob: epoch 2 of 9, 1 min 20 s left" in said
    assert "not yet" not in said


def test_runs_of_one_title_are_told_apart(tmp_path):
    """Two seeds, say: of the first a fold needs 80 s still, of the second nobody knows anything."""
    note(tmp_path, Message("seed 0", "bob", "half", 100.0, time.time() - 20, time.time() - 20))
    note(tmp_path, Message("seed 1", "bob", "", None, time.time() - 20, time.time() - 20))
    with loop.progress(tmp_path) as bar:
        for key in ("seed 0", "seed 1"):
            bar.add_task("svm", total=1, key=key, left="")
        lines = [part for part in bar.get_renderables() if "bob" in str(part)]
        left = [task.fields["left"] for task in bar.tasks]
    assert left == ["1 min 20 s left", ""] and len(lines) == 1 and "svm: bob: half" in str(lines[0])


def test_a_fold_that_died_at_once_says_nothing_of_the_others(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(loop, "console", Console(file=sys.stdout, width=200))
    with loop.progress(tmp_path) as bar:
        task = bar.add_task("svm", total=3, completed=1, key="svm", left="", spent=[], workers=1)
        bar.line(task, FoldResult("1", error="The worker died"))
        bar.update(task, completed=2, spent=[9.0])
        bar.line(task, FoldResult("2", seconds=9.0))
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == ["svm: fold 1 failed, 1 of 3", "svm: fold 2 done after 9 s, 2 of 3, 9 s left"]


def test_a_fold_tells_under_its_name(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
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
    assert [said[:4] for said in seen] == [("key of svm", "anna", "", None), ("key of svm", "anna", "half", 3.0)]
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


@given(
    st.lists(st.floats(0.1, 100), min_size=1),
    st.lists(st.floats(0, 100), max_size=8),
    st.integers(0, 50),
    st.integers(1, 8),
)
def test_time_left_lies_between_all_at_once_and_one_by_one(spent, running, waiting, count):
    usual = np.mean(spent)
    rest = [max(usual - each, usual / 10) for each in running]
    found = progress.seconds_left(spent, [(each, None) for each in running], waiting, count)
    work = sum(rest) + waiting * usual
    assert work / max(count, len(running)) - 1e-6 <= found <= work + 1e-6
    assert found >= max([*rest, usual * bool(waiting)], default=0) - 1e-6


def test_where_no_bar_is_seen_a_line_tells_of_each_fold(capsys):
    """At once, with the time left; a terminal has the bar for that."""
    assert (
        main(["run", "model=bayes", "features=jung28", "data.subjects=3", "data.variants=normal", "data.repetitions=1"])
        == 0
    )
    said = [line for line in capsys.readouterr().err.splitlines() if " fold " in line]
    assert [line.split(" after ")[0] for line in said] == [
        f"bayes · jung28 | synth | loso: fold {name} done" for name in ("1", "2", "3")
    ]
    assert [" s left" in line for line in said] == [True, True, False] and said[2].endswith("3 of 3")


def test_seconds_as_people_say_them():
    assert [progress.span(s) for s in (-3, 0.4, 59.6, 200, 7510)] == [
        "0 s",
        "0 s",
        "1 min 0 s",
        "3 min 20 s",
        "2 h 5 min",
    ]


def test_a_network_says_how_long_it_takes(tmp_path, monkeypatch, corpus):
    """Every step of it, with what is left as if the steps so far were as long as those to come."""
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    clock = iter(range(1000))
    monkeypatch.setattr("models.nets.training.time", type("Clock", (), {"monotonic": lambda: next(clock)}))
    heard = []
    monkeypatch.setattr("models.nets.training.tell", lambda words, left: heard.append((words.split(",")[0], left)))
    CNN85(epochs=3, frames=10, batch=16).fit(corpus, corpus.gestures)
    steps = len(heard) // 3
    assert [left for _, left in heard] == [pytest.approx(3 * steps - n) for n in range(1, 3 * steps + 1)]
    assert heard[0][0] == "epoch 1 of 3" and heard[-1][0] == "epoch 3 of 3"
