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
from bench.store.tables import write_table
from tests.running.fakes import DONE, MEASURED, Echo, MemoryStore

TINY = {"data.subjects": 4, "data.variants": "normal", "data.repetitions": 1}


class Backwards(FoldExecutor):
    """Runs folds in this process, the last one first; cut off before fold number ``stop``."""

    stop, error = -1, KeyboardInterrupt

    def run_folds(self, plan, missing):
        for fold in reversed(missing):
            if len(DONE) == self.stop:
                raise self.error
            yield from super().run_folds(plan, [fold])


@pytest.fixture
def store(monkeypatch):
    DONE.clear()
    memory = MemoryStore()
    monkeypatch.setattr(loop, "connect", lambda writes: memory)
    monkeypatch.setattr(workers, "ProcessExecutor", Backwards)
    monkeypatch.setattr(Echo, "fails", {})
    return memory


@pytest.fixture(scope="module")
def plan():
    (plan,) = make_plans(make_cells({"model": "bayes", "features": "jung28", **TINY}), 1)
    return plan


def echo_plans(plan, *numbers):
    return [plan.with_cell(replace(plan.cell, run_kind=Echo(number))) for number in numbers]


def test_results_have_the_order_of_the_plans_and_folds_that_of_the_protocol(store, plan, capsys):
    results = run_plans(echo_plans(plan, 0, 1, 0))  # the same again is computed once
    assert [result["echo.number"] for result in results] == ["0", "1", "0"]
    assert store.statuses() == ["FINISHED"] * 2
    lines = capsys.readouterr().err
    assert "run 2 of 2" in lines and "stored" not in lines
    for numbers, line in (((1,), "1 of 1 run"), ((1, 0, 1), "2 of 2 runs")):
        assert len(run_plans(echo_plans(plan, *numbers))) == len(numbers)
        assert capsys.readouterr().err.strip() == f"{line} already stored"
    assert DONE == [(number, fold) for number in range(2) for fold in "4321"]
    assert results[2]["run_id"] == results[0]["run_id"]
    scores = [1 / 3, 2 / 3, 1, 4 / 3]
    for result in results:
        predictions, folds = result.tables["predictions"], result.tables["folds"]
        assert predictions["capture"].tolist() == [int(i) for i in plan.corpus.index]
        assert result.is_complete and not result.errors and "fold/score" not in result
        assert result.metrics == {"captures": len(plan.corpus), "folds": 4, "folds_failed": 0}
        assert folds["fold"].tolist() == [*"1234"] and folds["score"].tolist() == scores
        assert {*folds["status"]} == {"FINISHED"} and {*folds["error"]} == {""}
    for run in store.runs_of_kind("echo"):  # scores of folds are steps of a metric
        assert [run.data.steps[i]["fold/score"] for i in range(4)] == scores
        assert not (run.folder / "folds").exists()


def test_the_time_left_is_that_of_finished_folds(store, plan):
    """Of the run itself, else of one that differs in its protocol; failed folds do not count."""
    run_plans(echo_plans(plan, 0))
    table = pd.DataFrame(
        {"status": ["FINISHED", "FINISHED", "FAILED"], "seconds": [2.0, 4.0, 90.0]}
    )
    write_table(table, store.runs_of_kind("echo")[0].folder / "folds.parquet")
    protocol = replace(plan.cell.protocol, name="kfold")
    similar = plan.with_cell(replace(plan.cell, run_kind=Echo(0), protocol=protocol))
    unfinished = [(similar, 4), (echo_plans(plan, 2)[0], 4)]
    seconds, unknown = estimate_seconds(store, unfinished)
    assert seconds == pytest.approx(4 * 3 / min(plan.workers, 4)) and unknown is None


@pytest.mark.parametrize(
    ("error", "raised"), [(KeyboardInterrupt, Interrupted), (ClusterError, ClusterError)]
)
def test_a_run_that_is_cut_off_goes_on_and_ends_the_same(error, raised, store, plan, monkeypatch):
    monkeypatch.setattr(Backwards, "stop", 5)
    monkeypatch.setattr(Backwards, "error", error)
    with pytest.raises(raised):
        run_plans(echo_plans(plan, 0, 1))
    assert len(DONE) == 5 and store.statuses() == ["FINISHED", "KILLED"]
    monkeypatch.setattr(Backwards, "stop", -1)
    resumed, folds = run_plans(echo_plans(plan, 0, 1)), {**MEASURED}
    assert len(DONE) == 8 and len({*DONE}) == 8 and store.statuses() == ["FINISHED"] * 2
    monkeypatch.setattr(loop, "connect", lambda writes: MemoryStore())
    at_once = run_plans(echo_plans(plan, 0, 1))
    ignored = {"predictions": 0, "seconds": 0}
    for number, (one, other) in enumerate(zip(resumed, at_once, strict=True)):
        assert one.tables["predictions"].equals(other.tables["predictions"])
        assert one.metrics == other.metrics
        before, after = (
            [vars(fold) | ignored for fold in measured[number]] for measured in (folds, MEASURED)
        )
        assert before == after


def test_a_failed_fold_is_recorded_and_it_alone_is_tried_again(store, plan, monkeypatch, capsys):
    errors = {"2": SystemExit("enough \udcff"), "3": ValueError("not finite\n  at frame 7")}
    monkeypatch.setattr(Echo, "fails", errors)
    (result,) = run_plans(echo_plans(plan, 0))
    assert [fold.name for fold in MEASURED[0]] == ["1", "4"] and not result.is_complete
    assert set(result.errors) == {"2", "3"} and result.folds == "2/4"
    assert "ValueError: not finite" in Path(result.errors["3"].where).read_text()
    assert store.statuses() == ["FAILED"]
    folds = result.tables["folds"]
    assert folds["status"].tolist() == ["FINISHED", "FAILED", "FAILED", "FINISHED"]
    reasons = folds["error"].tolist()
    short = [reason.partition(" (fakes.py, line ")[0] for reason in reasons]
    assert short == ["", "SystemExit: enough \\udcff", "ValueError: not finite", ""] != reasons
    lines = capsys.readouterr().err
    assert f"fold 2 failed: {reasons[1]}\n" in lines and f"fold 3 failed: {reasons[2]}\n" in lines
    Echo.fails.clear()
    DONE.clear()
    (result,) = run_plans(echo_plans(plan, 0))
    assert DONE == [(0, "3"), (0, "2")] and not result.errors and store.statuses() == ["FINISHED"]
    monkeypatch.setattr(Echo, "fails", {fold: ValueError() for fold in "1234"})
    (result,) = run_plans(echo_plans(plan, 1))
    assert not result.has_scores and result.metrics == {"folds": 0, "folds_failed": 4}
    assert result.tables["folds"]["seconds"].isna().all()
    assert estimate_seconds(store, [(echo_plans(plan, 2)[0], 4)]) == [None]
    assert store.statuses()[1] == "FAILED"


def test_a_run_of_another_process_comes_after_all_others(store, plan, monkeypatch):
    """It ends the command only where nothing else is left to run; all locks are free again."""
    plans = echo_plans(plan, 0, 1, 2)
    locks = data_folder() / "locks"
    locks.mkdir(parents=True)
    with FileLock(locks / f"{plans[0].key}.lock") as lock:
        with pytest.raises(InputError, match="another process"):
            run_plans(plans)
        assert {number for number, _ in DONE} == {1, 2} and len(store.statuses()) == 2
        DONE.clear()
        run_folds = Backwards.run_folds

        def free_after_the_first_fold(self, plan, missing):
            lock.release()
            yield from run_folds(self, plan, missing)

        monkeypatch.setattr(Backwards, "run_folds", free_after_the_first_fold)
        plans = [plans[0], *echo_plans(plan, 3)]
        results = run_plans(plans)
    assert [result["echo.number"] for result in results] == ["0", "3"]
    assert list(dict.fromkeys(number for number, _ in DONE)) == [3, 0]


def test_a_run_names_its_machines(store, plan, monkeypatch):
    machines = iter([Machine("fast", "avx2"), Machine("slow", "sse")] * 2)
    monkeypatch.setattr(workers, "this_machine", lambda: next(machines))
    for _ in range(2):  # as it ends, and as it is stored
        (run,) = run_plans(echo_plans(plan, 0))
        assert run["cpu"] == "fast; slow" and run["simd"] == "avx2; sse"


def test_peak_memory_is_that_of_the_fold_alone():
    reset_peak_memory()
    before = peak_memory()
    array = np.ones(60_000_000)  # 480 MB
    assert peak_memory() > before + array.nbytes / 2
    del array
    reset_peak_memory()
    assert peak_memory() < before + 240_000_000


@pytest.mark.parametrize("jobs", [1, 2, 3, 64])
def test_cores_are_shared_out(jobs):
    cores = len(os.sched_getaffinity(0))
    assert share_cores(None, 100) == (cores, 1) and share_cores(None, 1) == (1, cores)
    processes, threads = share_cores(jobs, 10)
    assert processes * threads <= cores
