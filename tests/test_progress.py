"""What a fold says of how far it is, from its process to the bar."""

from io import StringIO

import pytest
from rich.console import Console

from bench import progress
from bench.progress import tell, telling, told
from bench.work import loop, workers


def test_what_is_told_is_seen_until_the_end(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    tell("nobody listens")
    with telling(tmp_path, "a"):
        tell("one")
        tell("two")
        assert told(tmp_path) == {"a": "two"}
    tell("again nobody")
    assert told(tmp_path) == {}
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
        assert told(folder) == {name: "half"}
    assert victim.read_text() == "mine" and not list(folder.iterdir())


def test_the_inner_one_is_heard_first(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    with telling(tmp_path, "outer"):
        with telling(None):
            tell("one")
        assert told(tmp_path) == {"outer": "one"}
        with telling(tmp_path, "inner"):
            tell("two")
        tell("three")
        assert told(tmp_path) == {"outer": "three"}


def test_too_often_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 1e9)
    with telling(tmp_path, "a"):
        for number in range(100):
            tell(str(number))
        assert told(tmp_path) == {"a": "0"}


def test_a_folder_that_goes_stops_nobody(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    (tmp_path / "gone").mkdir()
    with telling(tmp_path / "gone", "a"):
        (tmp_path / "gone").rmdir()
        tell("nobody")
    assert told(tmp_path / "gone") == {}


def test_the_bar_has_a_line_for_each_that_tells(tmp_path, monkeypatch):
    (tmp_path / "1").write_text('["bob", "epoch 2 of 9"]')
    (tmp_path / "2").write_text('["anna", "3 trials, 5 s left"]')
    (tmp_path / ".3").write_text("not yet")
    out = StringIO()
    monkeypatch.setattr(loop, "console", Console(file=out, width=100))
    with loop.progress(tmp_path) as bar:
        bar.add_task("svm", total=2)
        for part in bar.get_renderables():
            loop.console.print(part)
    said = out.getvalue()
    assert "anna: 3 trials, 5 s left" in said and "bob: epoch 2 of 9" in said and "not yet" not in said


def test_a_fold_tells_under_its_name(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)

    class Telling:
        def fold(self, cell, corpus, fold, threads):
            tell("half")
            return told(tmp_path)

    class Fold:
        name = "anna"

    assert workers.do_fold(Telling(), None, None, Fold(), 1, tmp_path) == {"anna": "half"}
    assert told(tmp_path) == {}
