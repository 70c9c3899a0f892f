"""``bench data show`` and ``bench.look``: the same words, and mistakes in one line."""

import shlex
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.cli import main
from bench.corpora.library import open_corpus
from tests.conftest import random_corpus
from tests.corpora.test_duplicates import copied

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


def test_classes_of_another_column_are_counted(capsys):
    assert main(["data", "export", "synth", "arm.csv", "subjects=2"]) == 0
    assert main(["data", "import", "cost", "arm.csv", "name=arm"]) == 0
    assert main(["data", "show", "arm", "target=variant", "out=here"]) == 0
    said = capsys.readouterr().out
    counted = open_corpus("arm", {}).captures["variant"].value_counts()
    rows = [line.split() for line in said.partition("Classes of target=variant:")[2].splitlines()[2:5]]
    assert rows == [[name, str(counted[name]), "2"] for name in sorted(counted.index)]
    found = bench.look("arm", target="variant")
    assert found.classes["captures"].tolist() == counted.sort_index().tolist()
    assert main(["data", "show", "arm", "target=reaction"]) == 2
    assert "target=reaction: arm has no full column 'reaction'; known: subject" in capsys.readouterr().err


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


def test_what_it_says_to_type_next_runs_and_has_a_system_on_windows(capsys):
    assert main(["data", "show", "synth", *SMALL]) == 0
    words = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: "))[1:]
    assert words[:2] == ["run", "data=synth"]
    assert main([*words, "data.subjects=2", "data.variants=normal", "jobs=1"]) == 0
    assert "window=1" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["table", "cost"])
def test_exported_captures_come_back_as_they_were_and_still_synthetic(kind, capsys):
    asked = ["subjects=2", "variants=normal"]
    if kind == "table":
        asked.append("rate_hz=54")  # which CoST's format cannot say
    assert main(["data", "export", "synth", "out file.csv", *asked]) == 0
    words = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: "))[1:]
    assert words[:3] == ["data", "import", "table"]
    assert main(words if kind == "table" else ["data", "import", "cost", "out file.csv", "name=copy"]) == 0
    again, said = open_corpus("copy", {}), capsys.readouterr().out
    made = bench.corpus("synth", subjects=2, variants=("normal",), rate_hz=54.0 if kind == "table" else 135.0)
    assert again.synthetic and "28 synthetic captures" in said
    assert (again.rate_hz, again.full_scale, len(again)) == (made.rate_hz, made.full_scale, len(made))
    assert list(again.lengths) == list(made.lengths) and "synthetic" not in again.captures
    upside = made.frames[:, ::-1] if kind == "table" else made.frames  # its rows stand as they are in the file
    assert (again.frames == upside).all()
    assert main(["data"]) == 0 and "28 synthetic captures" in capsys.readouterr().out
    assert main(["run", "data=copy", "model=lda", "features=jung28", "jobs=1"]) == 0
    assert "copy (synthetic)" in capsys.readouterr().out


def test_an_import_says_what_it_replaces_and_its_warnings_take_a_line(capsys):
    assert main(["data", "export", "synth", "one.csv", "subjects=1", "variants=normal"]) == 0
    assert main(["data", "export", "synth", "two.csv", "subjects=2", "variants=normal"]) == 0
    capsys.readouterr()
    assert main(["data", "import", "cost", "one.csv", "name=mine"]) == 0
    first, old = capsys.readouterr(), open_corpus("mine", {})
    assert "replaces" not in first.out and first.err.count("\n") == 1
    warnings = old.info["warnings"]
    assert len(warnings) > 20 and f"warning: {len(warnings)} of them: {'; '.join(warnings[:3])}; for all:" in first.err
    assert main(["data", "import", "cost", "one.csv", "name=mine"]) == 0
    assert "replaces" not in capsys.readouterr().out  # the same captures
    assert main(["data", "import", "cost", "two.csv", "name=mine"]) == 0
    said = capsys.readouterr().out
    assert f"mine: replaces 14 captures, digest {old.digest[:16]}\n" in said and len(open_corpus("mine", {})) == 28
    assert main(["data", "show", "mine"]) == 0
    shown = capsys.readouterr().out
    assert all(f"\n  {warning}\n" in shown for warning in open_corpus("mine", {}).info["warnings"])


def test_the_same_capture_of_two_subjects_is_named_by_import_and_show_and_refused_by_a_run(capsys):
    corpus = copied(random_corpus(subjects=2, longest=20), [(10, 1), (4, 3)])
    offsets = np.append(corpus.starts, len(corpus.frames))
    labels = {name: corpus.captures[name].to_numpy(dtype="U") for name in ("subject", "gesture")}
    np.savez("mine.npz", frames=corpus.frames, offsets=offsets, **labels)
    pair = "capture 1 (subject 1, gesture pat) = capture 10 (subject 2, gesture pat)"
    assert main(["data", "import", "table", "mine.npz", "name=mine", "rate_hz=50"]) == 0
    told = capsys.readouterr().err
    assert told.startswith("warning: 4 captures have the same frames as another one (groups: 2, of several")
    assert pair in told and told.count("\n") == 1
    assert main(["data", "show", "mine"]) == 0
    shown = capsys.readouterr().out
    assert "4 captures share their frames with another one, in 2 groups; 1 of them under several subjects" in shown
    assert "capture 1, subject 1, gesture pat = capture 10, subject 2\n" in shown and pair in shown
    assert main(["run", "data=mine", "model=lda", "features=touch"]) == 2
    refused = capsys.readouterr().err
    assert "under another subject: 2, such as 1 (subject 1) and 10 (subject 2); leave this one out" in refused
    assert refused.count("\n") == 1 and "…" not in refused
