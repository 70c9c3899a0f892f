"""The loop with a store in memory, and once a run tracked whole in MLflow."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from filelock import FileLock

from bench.errors import ClusterError, InputError
from bench.ground.machine import Machine
from bench.ground.scratch import data_folder
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans, share_cores
from bench.running import loop, workers
from bench.running.fold import peak_memory, reset_peak_memory
from bench.running.loop import Interrupted, estimate_seconds, run_plans
from bench.running.workers import FoldExecutor
from tests.running.fakes import DONE, MEASURED, Echo, Memory

SMALL = ["data.subjects=4", "data.variants=normal", "jobs=2"]
TINY = {"data.subjects": 4, "data.variants": "normal", "data.repetitions": 1}


class Backwards(FoldExecutor):
    """Folds in this process, the last one first; they are cut off before fold number ``stop`` is done."""

    stop, how = -1, KeyboardInterrupt

    def run_folds(self, plan, missing):
        for fold in reversed(missing):
            if len(DONE) == self.stop:
                raise self.how
            yield from super().run_folds(plan, [fold])


@pytest.fixture
def store(monkeypatch):
    DONE.clear()
    memory = Memory()
    monkeypatch.setattr(loop, "connect", lambda writes: memory)
    monkeypatch.setattr(workers, "ProcessExecutor", Backwards)
    monkeypatch.setattr(Echo, "fails", {})
    return memory


@pytest.fixture(scope="module")
def plan():
    (plan,) = make_plans(make_cells({"model": "bayes", "features": "jung28", **TINY}), 1)
    return plan


def todo(plan, *numbers):
    return [plan.with_cell(replace(plan.cell, run_kind=Echo(number))) for number in numbers]


def test_outcomes_come_in_the_order_of_the_plans_and_folds_in_that_of_the_protocol(
    store, plan, capsys, monkeypatch
):
    monkeypatch.setattr(
        Echo, "fold_metrics", lambda self, result, rate_hz: {"score": int(result.name) / 3}
    )
    outcomes = run_plans(todo(plan, 0, 1, 0))  # the same again is computed once
    assert [o["echo.number"] for o in outcomes] == ["0", "1", "0"] and store.statuses() == [
        "FINISHED"
    ] * 2
    assert "run 2 of 2" in (said := capsys.readouterr().err) and "stored" not in said
    assert (
        len(run_plans(todo(plan, 1))) == 1
        and "1 of 1 run already stored" in capsys.readouterr().err
    )
    assert (
        len(run_plans(todo(plan, 1, 0, 1))) == 3
        and capsys.readouterr().err.strip() == "2 of 2 runs already stored"
    )
    assert (
        DONE == [(n, f) for n in range(2) for f in "4321"]
        and outcomes[2]["run_id"] == outcomes[0]["run_id"]
    )
    for outcome in outcomes:
        predictions, folds = outcome.tables["predictions"], outcome.tables["folds"]
        assert predictions["capture"].tolist() == [int(i) for i in plan.corpus.index]
        assert outcome.is_complete and not outcome.errors and "fold/score" not in outcome
        assert outcome.metrics == {"captures": len(plan.corpus), "folds": 4, "folds_failed": 0}
        assert folds["fold"].tolist() == [*"1234"] and folds["score"].tolist() == [
            1 / 3,
            2 / 3,
            1,
            4 / 3,
        ]
        assert {*folds["status"]} == {"FINISHED"} and {*folds["error"]} == {""}
    for run in store.runs_of_kind(
        "echo"
    ):  # the folds are tables of the run, and steps of its numbers
        assert [run.data.steps[i]["fold/score"] for i in range(4)] == [1 / 3, 2 / 3, 1, 4 / 3]
        assert not (run.folder / "folds").exists()


def test_the_time_left_is_that_of_finished_folds(store, plan):
    """Of the run itself, else of one that differs in its protocol; the folds that failed do not count."""
    run_plans(todo(plan, 0))
    table = pd.DataFrame(
        {"status": ["FINISHED", "FINISHED", "FAILED"], "seconds": [2.0, 4.0, 90.0]}
    )
    table.to_parquet(store.runs_of_kind("echo")[0].folder / "folds.parquet")
    protocol = replace(plan.cell.protocol, name="kfold")
    like = (plan.with_cell(replace(plan.cell, run_kind=Echo(0), protocol=protocol)), 4)
    other, none = estimate_seconds(store, [like, (todo(plan, 2)[0], 4)])
    assert other == pytest.approx(4 * 3 / min(plan.workers, 4)) and none is None


@pytest.mark.parametrize(
    ("how", "error"), [(KeyboardInterrupt, Interrupted), (ClusterError, ClusterError)]
)
def test_what_is_cut_off_goes_on_and_ends_the_same(how, error, store, plan, monkeypatch):
    monkeypatch.setattr(Backwards, "stop", 5)
    monkeypatch.setattr(Backwards, "how", how)
    with pytest.raises(error):
        run_plans(todo(plan, 0, 1))
    assert len(DONE) == 5 and store.statuses() == ["FINISHED", "KILLED"]
    monkeypatch.setattr(Backwards, "stop", -1)
    resumed = run_plans(todo(plan, 0, 1))
    assert len(DONE) == 8 and len({*DONE}) == 8 and store.statuses() == ["FINISHED"] * 2
    folds = {**MEASURED}
    monkeypatch.setattr(loop, "connect", lambda writes: Memory())
    for number, (a, b) in enumerate(zip(resumed, run_plans(todo(plan, 0, 1)), strict=True)):
        assert a.tables["predictions"].equals(b.tables["predictions"]) and a.metrics == b.metrics
        assert [vars(r) | {"predictions": 0, "seconds": 0, "scored": 0} for r in folds[number]] == [
            vars(r) | {"predictions": 0, "seconds": 0, "scored": 0} for r in MEASURED[number]
        ]


def test_a_failed_fold_is_recorded_the_others_go_on_and_it_alone_is_tried_again(
    store, plan, monkeypatch, capsys
):
    monkeypatch.setattr(
        Echo,
        "fails",
        {"2": SystemExit("enough \udcff"), "3": ValueError("not finite\n  at frame 7")},
    )
    (outcome,) = run_plans(todo(plan, 0))
    assert (
        [r.name for r in MEASURED[0]] == ["1", "4"]
        and not outcome.is_complete
        and set(outcome.errors) == {"2", "3"}
    )
    assert "ValueError: not finite" in Path(outcome.errors["3"].where).read_text()
    assert store.statuses() == ["FAILED"] and outcome.folds == "2/4"
    assert outcome.tables["folds"]["status"].tolist() == [
        "FINISHED",
        "FAILED",
        "FAILED",
        "FINISHED",
    ]
    errors = outcome.tables["folds"]["error"].tolist()
    said = [error.partition(" (fakes.py, line ")[0] for error in errors]
    assert (
        said == ["", "SystemExit: enough \\udcff", "ValueError: not finite", ""] and said != errors
    )
    err = capsys.readouterr().err
    assert f"fold 2 failed: {errors[1]}\n" in err and f"fold 3 failed: {errors[2]}\n" in err
    Echo.fails.clear()
    DONE.clear()
    (outcome,) = run_plans(todo(plan, 0))
    assert DONE == [(0, "3"), (0, "2")] and not outcome.errors and store.statuses() == ["FINISHED"]
    monkeypatch.setattr(Echo, "fails", {f: ValueError() for f in "1234"})
    (outcome,) = run_plans(todo(plan, 1))
    assert (
        not outcome.has_scores
        and outcome.metrics == {"folds": 0, "folds_failed": 4}
        and store.statuses()[1] == "FAILED"
    )


def test_a_run_of_another_process_ends_the_command_after_those_before_it(store, plan):
    one, two = todo(plan, 0, 1)
    (data_folder() / "locks").mkdir(parents=True)
    with (
        FileLock(data_folder() / "locks" / f"{two.key}.lock"),
        pytest.raises(InputError, match="another process"),
    ):
        run_plans([one, two])
    assert {number for number, _ in DONE} == {0} and store.statuses() == ["FINISHED"]
    assert len(run_plans([one, two])) == 2  # all locks are free again


def test_a_run_names_its_machines(store, plan, monkeypatch):
    machines = iter([Machine("fast", "avx2"), Machine("slow", "sse")] * 2)
    monkeypatch.setattr("bench.running.workers.this_machine", lambda: next(machines))
    for _ in range(2):  # as it ends, and as it is stored
        (run,) = run_plans(todo(plan, 0))
        assert run["cpu"] == "fast; slow" and run["simd"] == "avx2; sse"


def test_peak_memory_is_that_of_the_fold_alone():
    reset_peak_memory()
    before = peak_memory()
    array = np.ones(60_000_000)  # 480 MB
    assert peak_memory() > before + array.nbytes / 2
    del array
    reset_peak_memory()
    assert peak_memory() < before + 240_000_000


def test_cores_are_shared_out():
    cores = len(os.sched_getaffinity(0))
    assert share_cores(None, 100) == (cores, 1) and share_cores(None, 1) == (1, cores)
    assert share_cores(1, 100) == (1, cores)
    for jobs in (1, 2, 3, 64):
        workers, threads = share_cores(jobs, 10)
        assert workers * threads <= cores
