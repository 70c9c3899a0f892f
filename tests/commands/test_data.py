"""``bench data``: show and ``bench.look`` give the same tables, exports come back, imports name what they replace."""

import shlex
from pathlib import Path

import pytest

import bench
from bench.cli import main
from bench.corpora.library import open_corpus

ONE = ["subjects=1", "variants=normal", "repetitions=1"]
FILES = {"captures.svg", "index.html"}


def test_the_command_and_the_function_show_the_same(capsys):
    some = "where=gesture in ['pat', 'tap']"
    assert main(["data", "show", "synth", "data.subjects=2", *ONE[1:], some, "out=here"]) == 0
    text = capsys.readouterr().out
    small = {"subjects": 2, "variants": ("normal",), "repetitions": 1}
    survey = bench.look("synth", where="gesture in ['pat', 'tap']", out="mine", **small)
    assert text.startswith(f"{survey}\n") and not Path("look").exists()
    assert {path.name for path in Path("here").iterdir()} == FILES
    assert Path("here/captures.svg").read_bytes() == Path("mine/captures.svg").read_bytes()
    assert survey.counts["captures"].tolist() == [1] * 4 and survey.durations[
        "gesture"
    ].tolist() == ["pat", "tap"]
    assert len(survey.taxels) == 64 and not len(survey.duplicates) and not len(survey.gaps)


@pytest.mark.parametrize(("few", "protocol"), [(3, "kfold protocol.folds=3 "), (1, "")])
def test_what_one_person_is_to_be_run_with_is_not_refused(few, protocol, monkeypatch, capsys):
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig", lambda self, path, **_: Path(path).write_text("<svg/>")
    )
    own = ["subjects=1", "variants=normal", f"repetitions={few}"]
    assert main(["data", "export", "synth", "one.csv", *own, "rate_hz=54"]) == 0
    assert (
        main(shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: bench ")))
        == 0
    )
    assert main(["data", "show", "copy"]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert (f"protocol={protocol}" in line) == line.startswith("next: ") == bool(protocol)
    assert not protocol or main([*shlex.split(line.removeprefix("next: bench ")), "dry=yes"]) == 0


@pytest.mark.parametrize("kind", ["table", "cost"])
def test_exported_captures_come_back_as_they_were_and_still_synthetic(kind, capsys):
    rate = ["rate_hz=54"] if kind == "table" else []  # which CoST's format cannot say
    assert main(["data", "export", "synth", "out file.csv", *ONE, *rate]) == 0
    words = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: "))[1:]
    assert words[:3] == ["data", "import", "table"]
    assert (
        main(words if kind == "table" else ["data", "import", "cost", "out file.csv", "name=copy"])
        == 0
    )
    again = open_corpus("copy", {})
    made = bench.corpus(
        "synth", subjects=1, variants=("normal",), repetitions=1, rate_hz=54.0 if rate else 135.0
    )
    assert again.synthetic and "synthetic" not in again.captures
    assert kind == "table" or again.captures.to_dict("list") == made.captures.to_dict("list")
    assert (again.rate_hz, again.full_scale, list(again.lengths)) == (
        made.rate_hz,
        made.full_scale,
        list(made.lengths),
    )
    upside = (
        made.frames[:, ::-1] if kind == "table" else made.frames
    )  # its rows are as they are in the file
    assert (again.frames == upside).all()
    assert main(["data", "verify", "copy"]) == 0
