"""A command that is cut off between two steps of its bookkeeping: the next one leaves nothing half made."""

from dataclasses import replace
from pathlib import Path

import mlflow.pyfunc
import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.errors import InputError
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.tables import read_table
from bench.work import loop
from bench.work.loop import execute
from bench.work.tracking import TrackedRun
from tests.conftest import runs
from tests.work.fakes import Echo, Memory

SMALL = ["model=bayes", "features=jung28", "data.subjects=3", "data.variants=normal", "data.repetitions=1"]


class Killed(BaseException):
    """As if the process had ended."""


def die(*_, **__):
    raise Killed


def killed_in(monkeypatch, owner, name, command):
    with monkeypatch.context() as patched:
        patched.setattr(owner, name, die)
        with pytest.raises(Killed):
            command()


@pytest.fixture
def store(monkeypatch):
    memory = Memory()
    monkeypatch.setattr(loop, "connect", lambda writes: memory)
    return memory


def command():
    plans = planned(cells(dict(word.split("=") for word in SMALL)), 1)
    return execute([plan.of(replace(plan.cell, study=Echo())) for plan in plans])


@pytest.mark.parametrize("step", ["log", "log_captures", "begin", "keep", "end"])
def test_a_run_that_was_only_begun_is_made_again_with_all_it_needs(step, store, monkeypatch):
    """Killed at each step of the store in turn."""
    killed_in(monkeypatch, store, step, command)
    (outcome,) = command()
    (run,) = store.parents("echo")
    assert run.info.status == "FINISHED" and run.data.params["model"] == "bayes" and run.inputs.dataset_inputs
    folds = store.folds(run.info.run_id)
    assert len(folds) == 3 and outcome.folds == "3/3" and {f.info.status for f in folds} == {"FINISHED"}


def test_trials_of_a_finished_fold_are_read_back_to_the_last_bit(store, monkeypatch):
    among = pd.DataFrame({"accuracy": 8 / np.arange(1, 100)})  # pandas' usual reader gets a third of them wrong
    add = TrackedRun.add
    with monkeypatch.context() as patched:
        patched.setattr(TrackedRun, "add", lambda self, result, *by: add(self, replace(result, trials=among), *by))
        killed_in(patched, TrackedRun, "close", command)
    command()
    (run,) = store.parents("echo")
    table = pd.read_csv(store.fetched(run.info.run_id, "trials.csv"), float_precision="round_trip")
    assert table["accuracy"].tolist() == among["accuracy"].tolist() * 3


def test_a_damaged_table_of_a_fold_is_named(store, monkeypatch):
    killed_in(monkeypatch, TrackedRun, "close", command)
    fold = store.folds(store.parents("echo")[0].info.run_id)[0]
    path = store.fetched(fold.info.run_id, "fold") / "predictions.parquet"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match=f"predictions of .*fold {fold.data.tags['touchbench.fold']}. .*is damaged"):
        command()


def test_trials_and_choices_of_any_type_are_the_same_in_memory_and_after_a_resume(store, monkeypatch):
    """Also where names are there twice; a finished fold is not lost."""
    rows = [[Echo, ("stuck", "dead"), "auto", 1, 0.5, None], [Echo, ("stuck", 3), 8, 2, 0.25, "03"]]
    among = pd.DataFrame(rows, columns=["kind", "states", "C", 7, "score", "C"])
    told = {"trials": among, "chosen": {"states": ("stuck", "dead"), "C": "None", "n": np.int64(3), 7: None}}
    add, tables = TrackedRun.add, []
    for killed in (True, False):
        with monkeypatch.context() as patched:
            patched.setattr(TrackedRun, "add", lambda self, result, *by: add(self, replace(result, **told), *by))
            if killed:
                killed_in(patched, TrackedRun, "close", command)
            (result,) = command()
        tables.append([result.tables[name] for name in ("trials", "chosen")])
        (run,) = store.parents("echo")
        for name, table in zip(("trials", "chosen"), tables[-1], strict=True):
            stored = read_table(lambda file, run=run: store.fetched(run.info.run_id, file), name)
            pd.testing.assert_frame_equal(stored, table, check_dtype=False)
            lines = store.fetched(run.info.run_id, f"{name}.csv").read_text().splitlines()
            assert lines == table.to_csv(index=False).splitlines()
        store.runs.clear()
    for one, other in zip(*tables, strict=True):
        pd.testing.assert_frame_equal(one, other, check_dtype=False)
    trials, chosen = tables[0]
    assert [*trials] == ["kind", "states", "C", "7", "score", "C.1", "fold"]
    assert trials["states"][0] == chosen["states"][0] == "('stuck', 'dead')" and trials["C"][1] == "8"
    assert trials["7"].tolist() == [1, 2] * 3 and trials["score"].dtype == float and trials["C.1"][1] == "03"
    assert chosen["C"][0] == "None" and chosen["n"].tolist() == [3] * 3 and chosen["7"].isna().all()


def test_a_fit_that_is_cut_off_can_be_repeated(monkeypatch):
    """Before its numbers are stored, while the folder is written, and while the model is stored."""

    def half(path, **_):
        Path(path).mkdir()
        (Path(path) / "input_example.json").write_text("{}")
        raise Killed

    fit = lambda: main(["fit", *SMALL, "stopping=no", "out=saved"])  # noqa: E731
    killed_in(monkeypatch, mlflow.pyfunc, "log_model", fit)
    assert [r.info.status for r in runs("fit")[1]] == ["FAILED"] or not Path("saved").exists()
    with monkeypatch.context() as patched:
        patched.setattr(mlflow.pyfunc, "save_model", half)
        patched.setattr("bench.scratch.owner", lambda: "nowhere-0-")
        with pytest.raises(Killed):
            fit()
    assert not Path("saved").exists()
    killed_in(monkeypatch, connect().__class__, "log", fit)
    assert "RUNNING" in [r.info.status for r in runs("fit")[1]]
    assert fit() == 0 and (Path("saved") / "MLmodel").is_file()
    assert "RUNNING" not in [r.info.status for r in connect().of_kind("fit")]
