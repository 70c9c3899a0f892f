"""``bench data``: ``show`` and ``bench.look`` agree, and exported captures come back."""

import shlex
from pathlib import Path

import pytest

import bench
from bench.cli import main
from bench.commands.data import _export_corpus, _possible_protocol, import_and_print
from bench.corpora import download, sources
from bench.corpora.library import open_corpus
from bench.corpora.read import haart
from bench.grammar.options import parse_arguments
from bench.ground.scratch import data_folder
from tests.corpora.made import archive

SMALL = {"variants": ("normal",), "repetitions": 1}
ONE_PERSON = {"subjects": "1", "variants": "normal", "repetitions": "1"}


def test_the_command_and_the_function_show_the_same(capsys):
    where = "gesture in ['pat', 'tap']"
    typed = ["data.subjects=2", "variants=normal", "repetitions=1", f"where={where}"]
    assert main(["data", "show", "synth", *typed, "out=here"]) == 0
    text = capsys.readouterr().out
    survey = bench.look("synth", where=where, out="mine", subjects=2, **SMALL)
    assert text.startswith(f"{survey}\n") and not Path("look").exists()
    assert {path.name for path in Path("here").iterdir()} == {"captures.svg", "index.html"}
    assert Path("here/captures.svg").read_bytes() == Path("mine/captures.svg").read_bytes()
    assert survey.counts["captures"].tolist() == [1] * 4
    assert survey.durations["gesture"].tolist() == ["pat", "tap"]
    assert len(survey.taxels) == 64 and not len(survey.duplicates) and not len(survey.gaps)


@pytest.mark.parametrize(
    ("people", "captures", "protocol"),
    [(2, 1, "loso"), (1, 1, ""), (1, 3, "kfold protocol.folds=3"), (1, 10, "kfold")],
)
def test_a_corpus_is_run_with_a_protocol_that_it_is_large_enough_for(people, captures, protocol):
    corpus = bench.corpus("synth", subjects=people, variants=("normal",), repetitions=captures)
    assert _possible_protocol(corpus) == protocol
    if protocol:
        words = [word.split("=") for word in f"protocol={protocol}".split()]
        typed = {key.replace(".", "__"): value for key, value in words}
        small = {"data__subjects": people, "data__repetitions": captures}
        assert bench.plans(model="bayes", data__variants="normal", **small, **typed)


@pytest.mark.parametrize("kind", ["table", "cost"])
def test_exported_captures_come_back_as_they_were_and_still_synthetic(kind, capsys):
    rate = {"rate_hz": "54"} if kind == "table" else {}  # which CoST's format cannot say
    _export_corpus("synth", Path("out file.csv"), ONE_PERSON | rate)
    typed = capsys.readouterr().out.splitlines()[-1].removeprefix("next: bench data import ")
    _, file, *words = shlex.split(typed)
    import_and_print(kind, Path(file), parse_arguments(words, None) if rate else {"name": "copy"})
    again = open_corpus("copy", {})
    made = bench.corpus("synth", subjects=1, rate_hz=54.0 if rate else 135.0, **SMALL)
    assert again.synthetic and "synthetic" not in again.captures
    assert rate or again.captures.to_dict("list") == made.captures.to_dict("list")
    for name in ("rate_hz", "full_scale"):
        assert getattr(again, name) == getattr(made, name)
    assert list(again.lengths) == list(made.lengths)
    upside = made.frames[:, ::-1] if rate else made.frames  # rows of a table are as in the file
    assert (again.frames == upside).all()
    assert main(["data", "verify", "copy"]) == 0


def test_get_imports_a_release_that_is_the_published_one_and_no_other(
    monkeypatch, tmp_path, capsys
):
    def arrive(address, file):
        """Stand in for a download."""
        archive(file.parent, name=file.name)

    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path))
    monkeypatch.setattr(download, "_download_patiently", arrive)
    figures = {"train": {"captures": 1}, "test": {"captures": 1}}
    monkeypatch.setattr(haart, "PUBLISHED", figures)
    monkeypatch.setattr(haart, "PUBLISHED_SUBJECTS", 2)
    assert main(["data", "get", "haart"]) == 0
    assert "haart: 2 captures" in capsys.readouterr().out
    digest = open_corpus("haart", {}).digest
    changed = {**vars(sources.HAART), "digest": "0" * 16}
    monkeypatch.setattr(sources, "HAART", sources.Source(**changed))
    for wrong in ("other readings", "captures: 1 here, 578 published"):
        assert main(["data", "get", "haart"]) == 2
        error = capsys.readouterr().err
        assert wrong in error and 'bench data import haart "HAART DataSet.zip"' in error
        monkeypatch.setattr(haart, "PUBLISHED", {**figures, "train": {"captures": 578}})
    assert open_corpus("haart", {}).digest == digest
    assert not [*(data_folder() / "downloads").glob("*.zip*")]


@pytest.mark.parametrize(
    ("typed", "fact"),
    [
        (["cost"], "accept=yes"),
        (["har"], "did you mean haart?"),
        (["haart", "adress=x"], "did you mean address?"),
    ],
)
def test_get_refuses_before_it_downloads(typed, fact, capsys):
    assert main(["data", "get", *typed]) == 2
    assert fact in capsys.readouterr().err
