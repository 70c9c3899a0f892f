"""``bench data``: show and ``bench.look`` give the same tables, exports come back, imports name what they replace."""

import shlex
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.cli import main
from bench.corpora.library import open_corpus
from tests.conftest import random_corpus
from tests.corpora.test_duplicates import copied

ONE = ["subjects=1", "variants=normal", "repetitions=1"]
FILES = {"pressure.png", "pressure.svg", "films.png", "films.svg", "motion.gif", "index.html"}


def test_the_command_and_the_function_show_the_same(capsys):
    some = "where=gesture in ['pat', 'tap']"
    assert main(["data", "show", "synth", "data.subjects=2", *ONE[1:], some, "out=here", "capture=17"]) == 0
    text = capsys.readouterr().out
    small = {"subjects": 2, "variants": ("normal",), "repetitions": 1}
    survey = bench.look("synth", where="gesture in ['pat', 'tap']", out="mine", capture=17, **small)
    assert text.startswith(f"{survey}\n") and not Path("look").exists()
    assert {path.name for path in Path("here").iterdir()} == FILES
    assert Path("here/motion.gif").read_bytes() == Path("mine/motion.gif").read_bytes()
    assert survey.counts["captures"].tolist() == [1] * 4 and survey.durations["gesture"].tolist() == ["pat", "tap"]
    assert len(survey.taxels) == 64 and not len(survey.duplicates) and not len(survey.gaps)


@pytest.mark.parametrize("kind", ["table", "cost"])
def test_exported_captures_come_back_as_they_were_and_still_synthetic(kind, capsys):
    rate = ["rate_hz=54"] if kind == "table" else []  # which CoST's format cannot say
    assert main(["data", "export", "synth", "out file.csv", *ONE, *rate]) == 0
    words = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: "))[1:]
    assert words[:3] == ["data", "import", "table"]
    assert main(words if kind == "table" else ["data", "import", "cost", "out file.csv", "name=copy"]) == 0
    again = open_corpus("copy", {})
    made = bench.corpus("synth", subjects=1, variants=("normal",), repetitions=1, rate_hz=54.0 if rate else 135.0)
    assert again.synthetic and "synthetic" not in again.captures
    assert (again.rate_hz, again.full_scale, list(again.lengths)) == (made.rate_hz, made.full_scale, list(made.lengths))
    upside = made.frames[:, ::-1] if kind == "table" else made.frames  # its rows are as they are in the file
    assert (again.frames == upside).all()
    assert main(["data", "verify", "copy"]) == 0


def test_an_import_names_what_it_replaces_and_its_warnings_take_a_line(capsys):
    assert main(["data", "export", "synth", "one.csv", *ONE]) == 0
    assert main(["data", "export", "synth", "two.csv", "subjects=2", *ONE[1:]]) == 0
    capsys.readouterr()
    assert main(["data", "import", "cost", "one.csv", "name=mine"]) == 0
    first, old = capsys.readouterr(), open_corpus("mine", {})
    warnings = old.info["warnings"]
    assert len(warnings) > 20 and first.err.count("\n") == 1 and warnings[0] in first.err
    assert main(["data", "import", "cost", "one.csv", "name=mine"]) == 0
    same = capsys.readouterr().out
    assert old.digest[:16] not in first.out.partition("captures,")[0] and "replaces" not in first.out + same
    assert main(["data", "import", "cost", "two.csv", "name=mine"]) == 0
    assert f"mine: replaces 14 captures, digest {old.digest[:16]}\n" in capsys.readouterr().out
    assert len(open_corpus("mine", {})) == 28


def test_the_same_capture_of_two_subjects_is_named_by_import_and_refused_by_a_run(capsys):
    corpus = copied(random_corpus(subjects=2, longest=20), [(10, 1), (4, 3)])
    offsets = np.append(corpus.starts, len(corpus.frames))
    labels = {name: corpus.captures[name].to_numpy(dtype="U") for name in ("subject", "gesture")}
    np.savez("mine.npz", frames=corpus.frames, offsets=offsets, **labels)
    assert main(["data", "import", "table", "mine.npz", "name=mine", "rate_hz=50"]) == 0
    line = capsys.readouterr().err
    assert "capture 1 (subject 1, gesture pat) = capture 10 (subject 2, gesture pat)" in line and line.count("\n") == 1
    assert main(["run", "data=mine", "model=lda", "features=touch"]) == 2
    line = capsys.readouterr().err
    assert "1 (subject 1) and 10 (subject 2)" in line and line.count("\n") == 1


def test_files_that_were_changed_are_found(capsys):
    assert main(["data", "export", "synth", "one.csv", *ONE]) == 0
    assert main(["data", "import", "cost", "one.csv", "name=mine"]) == 0
    frames = next(Path("home", "corpora", "mine").rglob("frames.npy"))
    frames.chmod(0o644)
    frames.write_bytes(frames.read_bytes()[:-2] + b"\7\7")
    assert main(["data", "verify", "mine"]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "damaged:" in line]
    assert line.startswith("frames.npy")
