"""The demo: its commands are those that it prints, in a store of their own, and what it prints next can be typed."""

import os
from pathlib import Path

import pytest

from bench import cli
from bench.arguments import parse
from bench.commands import demo
from bench.options import keys
from bench.plan.cells import cells


def test_steps_run_in_their_folder_until_one_fails(tmp_path, monkeypatch, capsys):
    made = []

    def main(step):
        made.append((step[0], Path.cwd(), os.environ.get("MLFLOW_TRACKING_URI")))
        os.environ["MLFLOW_TRACKING_URI"] = "sqlite:///of-the-step"  # as MLflow does
        return 3 if step[0] == "stress" else 0

    monkeypatch.setattr(cli, "main", main)
    monkeypatch.setattr(demo, "_best", lambda: [["model=lda"], ["model=svm"]])
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "sqlite:///mine")
    before = Path.cwd()
    assert demo.demo([f"out={tmp_path / 'd'}"]) == 3
    assert [name for name, *_ in made] == ["run", "run", "stream", "stream", "stress"]
    assert {folder for _, folder, _ in made} == {tmp_path / "d"} and {uri for *_, uri in made} == {None}
    assert os.environ["MLFLOW_TRACKING_URI"] == "sqlite:///mine" and Path.cwd() == before
    output = capsys.readouterr().out
    assert "synthetic" in output.splitlines()[0] and output.count("$ bench ") == 5


@pytest.mark.parametrize("step", [*demo.RUNS, *demo.VERDICTS, *(tuple(s.split()[1:]) for s in demo.NEXT[1:])])
def test_its_commands_can_be_typed(step):
    values = parse(step[1:], keys(step[0]))
    assert step[0] == "choose" or cells(values)
