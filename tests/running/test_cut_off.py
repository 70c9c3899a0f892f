"""A command that is cut off between two steps of its bookkeeping; the next one mends the rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running import loop, saved
from bench.running.loop import run_plans
from bench.running.tracking import TrackedRun
from bench.store.client import connect
from tests import conftest
from tests.conftest import runs
from tests.running.fakes import DONE, Echo, MemoryStore

SMALL = ["model=bayes", "features=jung28", *conftest.SMALL[:-1]]


class Killed(BaseException):
    """As if the process had ended."""


def die(*_, **__):
    raise Killed


def kill_in(monkeypatch, owner, name, command):
    with monkeypatch.context() as patched:
        patched.setattr(owner, name, die)
        with pytest.raises(Killed):
            command()


@pytest.fixture
def store(monkeypatch):
    memory = MemoryStore()
    monkeypatch.setattr(loop, "connect", lambda writes: memory)
    return memory


def command():
    plans = make_plans(make_cells(dict(word.split("=") for word in SMALL)), 1)
    return run_plans([plan.with_cell(replace(plan.cell, run_kind=Echo())) for plan in plans])


@pytest.mark.parametrize("step", ["log_values", "log_artifact", "set_status", "delete_artifact"])
def test_a_run_that_was_only_begun_is_made_again_with_all_it_needs(step, store, monkeypatch):
    """Killed at each step of the store in turn."""
    kill_in(monkeypatch, store, step, command)
    (outcome,) = command()
    (run,) = store.runs_of_kind("echo")
    assert run.info.status == "FINISHED" and run.data.params["model"] == "bayes"
    assert (
        len(outcome.tables["folds"]) == 3
        and outcome.folds == "3/3"
        and not (run.folder / "folds").exists()
    )


HARMS = (
    lambda content: content[:-20],
    lambda content: content[: len(content) // 2] + b"x" + content[len(content) // 2 + 1 :],
    lambda content: content[:6] + b"\x20" + content[7:],  # a flag that Python's zip lacks
)


@pytest.mark.parametrize("harm", HARMS)
def test_a_fold_that_is_cut_off_or_damaged_is_named_and_done_again(
    harm, store, monkeypatch, capsys
):
    kill_in(monkeypatch, TrackedRun, "store_result", command)
    (run,) = store.runs_of_kind("echo")
    path = run.folder / "folds" / "1.zip"
    path.write_bytes(harm(path.read_bytes()))
    DONE.clear()
    (outcome,) = command()
    assert f"{path} is damaged; its fold is run again" in capsys.readouterr().err
    assert (
        DONE == [(0, "2")]
        and outcome.folds == "3/3"
        and len(outcome.tables["predictions"]) == 3 * 14
    )


def test_trials_and_choices_of_any_type_are_the_same_in_memory_and_after_a_resume(
    store, monkeypatch
):
    """How columns of each type are stored, is in tests/store/test_tables.py."""
    among = pd.DataFrame([[Echo, 8 / 3, "auto"], [Echo, 0.25, 8]], columns=["kind", 7, "C"])
    more = {"trials": among, "chosen": {"states": ("stuck", "dead"), "n": np.int64(3), 7: None}}
    more["history"] = [{"loss": 1 / 3}, {"loss": 1 / 9}]
    fold, tables = Echo.evaluate_fold, []
    monkeypatch.setattr(Echo, "evaluate_fold", lambda *all: replace(fold(*all), **more))
    for killed in (True, False):
        if killed:
            kill_in(monkeypatch, TrackedRun, "store_result", command)
        (result,) = command()
        tables.append([result.tables[name] for name in ("trials", "chosen", "history")])
        store.kept.clear()
    for one, other in zip(*tables, strict=True):
        pd.testing.assert_frame_equal(one, other, check_exact=True)
    trials, chosen, history = tables[0]
    assert (
        history["epoch"].tolist() == [1, 2] * 3 and history["loss"].tolist() == [1 / 3, 1 / 9] * 3
    )
    assert trials["7"].tolist() == [8 / 3, 0.25] * 3 and trials["C"].tolist() == ["auto", "8"] * 3
    assert (
        chosen["states"][0] == "('stuck', 'dead')"
        and chosen["n"].tolist() == [3] * 3
        and chosen["7"].isna().all()
    )


def test_a_fit_that_is_cut_off_can_be_repeated(monkeypatch):
    """While the folder is written, and before its numbers are stored."""

    def half(path, _):
        (Path(path) / "input_example.json").write_text("{}")
        raise Killed

    fit = lambda: main(["fit", *SMALL, "stopping=no", "out=saved"])  # noqa: E731
    with monkeypatch.context() as patched:
        patched.setattr(saved, "log_model", lambda _: None)
        patched.setattr(saved, "save_model", half)
        with pytest.raises(Killed):
            fit()
    assert not Path("saved").exists()
    kill_in(monkeypatch, connect().__class__, "log_values", fit)
    assert "RUNNING" in [r.info.status for r in runs("fit")[1]]
    assert fit() == 0 and (Path("saved") / "MLmodel").is_file()
    assert "RUNNING" not in [r.info.status for r in connect().runs_of_kind("fit")]
