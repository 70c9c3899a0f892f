"""``bench data show`` and ``bench.look``: the same words, and mistakes in one line."""

from pathlib import Path

import pytest

import bench
from bench.cli import main

SMALL = ["data.subjects=2", "variants=normal"]  # with and without data.
FILES = {"pressure.png", "pressure.svg", "films.png", "films.svg", "motion.gif", "index.html"}


def test_the_command_and_the_function_say_the_same(capsys):
    assert main(["data", "show", "synth", *SMALL, "where=gesture in ['pat', 'tap']", "out=here"]) == 0
    said = capsys.readouterr().out
    found = bench.look("synth", where="gesture in ['pat', 'tap']", subjects=2, variants=("normal",))
    assert said.startswith(f"{found}\n") and "synthetic: generated captures, not people" in said
    assert {p.name for p in Path("here").iterdir()} == FILES and not Path("look").exists()
    assert found.counts["captures"].tolist() == [1] * 4 and found.durations["gesture"].tolist() == ["pat", "tap"]
    assert len(found.taxels) == 64 and not len(found.duplicates) and not len(found.gaps)


def test_it_writes_into_look_and_animates_the_capture_that_is_asked_for(capsys):
    bench.look("synth", subjects=1, variants=("normal",), out="mine", capture=3)
    assert main(["data", "show", "synth", "subjects=1", "variants=normal", "capture=3"]) == 0
    assert {p.name for p in Path("look").iterdir()} == FILES
    assert Path("look/motion.gif").read_bytes() == Path("mine/motion.gif").read_bytes()
    assert "capture 3, at the speed" in Path("look/index.html").read_text()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["show"], "say which corpus, as in bench data show synth; known: synth"),
        (["show", "where=x"], "say which corpus"),
        (["show", "synht"], "data=synht: not imported; did you mean synth"),
        (["synth"], "bench data synth: say what to do with it, such as bench data show synth"),
        (["shwo", "synth"], "bench data shwo: did you mean show?"),
        (["show", "synth", "subject=2"], "no parameter 'subject'; did you mean subjects"),
        (["show", "synth", "subjects=2", "data.subjects=3"], "data.subjects= is given twice"),
        (["show", "synth", "subjects=2,3"], "one corpus at a time"),
        (["show", "synth", "subjects=1", "capture=42"], "capture=42: not among the 42 captures looked at"),
        (["show", "synth", "subjects=1", "capture=one"], "capture=one: give a whole number"),
        (["show", "synth", "subjects=1", "where=cover == 'x'"], "no column 'cover'"),
        (["show", "synth", "subjects=1", "out=file/x"], "out=file/x: file/x cannot be written"),
        (["export", "synth", "o.csv", "subjects=1,2"], "one corpus at a time"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(words, told, capsys):
    Path("file").write_text("mine")
    assert main(["data", *words]) == 2
    said = capsys.readouterr()
    assert told in said.err and said.err.count("\n") == 1 and not said.out
    assert not Path("look").exists() and not Path("o.csv").exists() and Path("file").read_text() == "mine"


def test_a_folder_in_the_place_of_a_file_is_told_in_one_line(capsys):
    Path("look/films.png").mkdir(parents=True)
    assert main(["data", "show", "synth", "subjects=1", "variants=normal"]) == 2
    assert "out=look: look/films.png cannot be written (Is a directory)" in capsys.readouterr().err
