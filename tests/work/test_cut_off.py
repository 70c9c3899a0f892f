"""A command that is cut off between two steps of its bookkeeping: the next one leaves nothing half made."""

from dataclasses import replace
from pathlib import Path

import mlflow.pyfunc
import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.outcomes.store import Store, connect
from bench.work.tracking import TrackedRun
from tests.conftest import runs

SMALL = ["model=bayes", "features=jung28", "data.subjects=3", "data.variants=normal"]


class Killed(BaseException):
    """As if the process had ended."""


def killed_in(monkeypatch, what, name, command):
    def die(*_, **__):
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(what, name, die)
        with pytest.raises(Killed):
            main(command)


@pytest.mark.parametrize("step", ["log", "log_captures"])
def test_a_run_that_was_only_begun_is_made_again_with_all_it_needs(step, monkeypatch):
    killed_in(monkeypatch, Store, step, ["run", *SMALL])
    assert main(["run", *SMALL]) == 0
    _, (run,) = runs("cell")
    assert run.info.status == "FINISHED" and run.data.params["model"] == "bayes" and run.inputs.dataset_inputs


def test_a_fit_that_was_cut_off_does_not_stay_running(monkeypatch):
    killed_in(monkeypatch, Store, "log", ["fit", *SMALL])
    assert [r.info.status for r in runs("fit")[1]] == ["RUNNING"]
    assert main(["fit", *SMALL]) == 0
    assert [r.info.status for r in connect().of_kind("fit")] == ["FINISHED"]


def test_a_model_that_was_cut_off_while_it_was_saved_does_not_block_the_next(monkeypatch, capsys):
    def half(path, **_):
        Path(path).mkdir()
        (Path(path) / "input_example.json").write_text("{}")
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(mlflow.pyfunc, "save_model", half)
        patched.setattr("bench.scratch.owner", lambda: "nowhere-0-")
        with pytest.raises(Killed):
            main(["fit", *SMALL, "out=saved"])
    assert not Path("saved").exists()
    assert main(["fit", *SMALL, "out=saved"]) == 0
    assert (Path("saved") / "MLmodel").is_file()


def test_what_a_finished_fold_chose_among_is_read_back_to_the_last_bit(monkeypatch):
    among = pd.DataFrame({"accuracy": 8 / np.arange(1, 100)})  # pandas' usual reader gets a third of them wrong
    add = TrackedRun.add
    with monkeypatch.context() as patched:
        patched.setattr(TrackedRun, "add", lambda self, result, *by: add(self, replace(result, trials=among), *by))
        killed_in(patched, TrackedRun, "close", ["run", *SMALL])
    assert main(["run", *SMALL]) == 0
    (run,) = connect().of_kind("cell")
    found = pd.read_csv(connect().fetched(run.info.run_id, "trials.csv"), float_precision="round_trip")
    assert found["accuracy"].tolist() == among["accuracy"].tolist() * 3


def test_a_fit_that_is_cut_off_while_it_is_stored_can_be_repeated(monkeypatch):
    killed_in(monkeypatch, mlflow.pyfunc, "log_model", ["fit", *SMALL, "out=saved"])
    assert main(["fit", *SMALL, "out=saved"]) == 0
    assert (Path("saved") / "MLmodel").is_file()
    assert "FINISHED" in [r.info.status for r in connect().of_kind("fit")]
