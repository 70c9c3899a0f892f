"""The gallery: its steps are commands, run in order in a folder and store of their own."""

import os
from importlib import import_module
from pathlib import Path

import pytest

from bench import cli
from bench.arguments import parse
from bench.commands import gallery
from bench.plan.cells import cells

OTHER_KEYS = {"out", "train_subjects"}


def test_steps_run_in_their_folder_until_one_fails(tmp_path, monkeypatch):
    made = []

    def main(step):
        made.append((step[0], Path.cwd(), os.environ.get("MLFLOW_TRACKING_URI")))
        os.environ["MLFLOW_TRACKING_URI"] = "sqlite:///of-the-step"  # as MLflow does
        return 3 if step[0] == "stress" else 0

    monkeypatch.setattr(cli, "main", main)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "sqlite:///mine")
    before = Path.cwd()
    assert gallery.gallery([f"out={tmp_path / 'g'}"]) == 3
    assert [name for name, *_ in made] == ["run", "run", "stress"]
    assert {folder for _, folder, _ in made} == {tmp_path / "g"} and made[0][2] is None
    assert os.environ["MLFLOW_TRACKING_URI"] == "sqlite:///mine" and Path.cwd() == before


@pytest.mark.parametrize("step", gallery.STEPS, ids=[" ".join(step) for step in gallery.STEPS])
def test_steps_name_systems_that_there_are(step):
    command, *arguments = step
    module, _, function = cli.COMMANDS[command][0].partition(":")
    assert callable(getattr(import_module(module), function))
    if arguments:
        values = parse(arguments, import_module(module).KEYS)
        assert all(cell.data == "synth" for cell in cells({k: v for k, v in values.items() if k not in OTHER_KEYS}))
