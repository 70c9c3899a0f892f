"""The loop with a store in memory, and once a run tracked whole in MLflow."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from filelock import FileLock

from bench.cli import main
from bench.commands.printing import choices_table, failures
from bench.errors import ClusterError, InputError, StoreError
from bench.machine import Machine
from bench.plan.cells import cells
from bench.plan.plan import planned, share_cores
from bench.scratch import home
from bench.work import loop
from bench.work.fold import forget_peak, peak_memory
from bench.work.loop import Interrupted, execute, prepared
from bench.work.workers import Done
from tests.conftest import InProcess, predictions, runs
from tests.work.fakes import DONE, MEASURED, Echo, Memory
from tests.work.wayward import Wayward

SMALL = ["data.subjects=4", "data.variants=normal", "jobs=2"]
TINY = {"data.subjects": 4, "data.variants": "normal", "data.repetitions": 1}


class Workers(InProcess):
    """Folds in this process; they are cut off before fold number ``stop`` is done."""

    stop, how, machines, most = -1, KeyboardInterrupt, (), 0

    def room(self, plan):
        return len(self.submitted) < 3

    def finished(self):
        if len(DONE) == self.stop:
            raise self.how
        Workers.most = max(Workers.most, len({task.key for task in self.submitted}))
        done = super().finished()
        return Done(done.task, done.result, self.machines[int(done.result.name) % 2]) if self.machines else done


class Several(Workers):
    """Folds of several plans at once, the last one submitted is done first."""

    overlap = True

    def room(self, plan):
        return len(self.submitted) < 6

    def finished(self):
        self.submitted.insert(0, self.submitted.pop())
        return super().finished()


@pytest.fixture
def store(monkeypatch):
    DONE.clear()
    memory = Memory()
    monkeypatch.setattr(loop, "connect", lambda writes: memory)
    monkeypatch.setattr(loop, "Processes", Workers)
    for name in ("stop", "machines", "most"):
        monkeypatch.setattr(Workers, name, getattr(Workers, name))
    monkeypatch.setattr(Echo, "fails", {})
    return memory


@pytest.fixture(scope="module")
def plan():
    (plan,) = planned(cells({"model": "bayes", "features": "jung28", **TINY}), 1)
    return plan


def todo(plan, *numbers):
    return [plan.of(replace(plan.cell, study=Echo(number))) for number in numbers]


def tables(outcomes):
    return [outcome.tables["predictions"] for outcome in outcomes]


@pytest.mark.parametrize("workers", [Workers, Several])
def test_outcomes_come_in_the_order_of_the_plans_and_folds_in_that_of_the_protocol(workers, store, plan, monkeypatch):
    monkeypatch.setattr(loop, "Processes", workers)
    outcomes = execute(todo(plan, 0, 1, 2))
    assert [o["echo.number"] for o in outcomes] == ["0", "1", "2"] and store.statuses() == ["FINISHED"] * 3
    assert [r.name for number in range(3) for r in MEASURED[number]] == ["1", "2", "3", "4"] * 3
    assert sorted(DONE) == [(n, f) for n in range(3) for f in "1234"] and len(store.runs) == 3 + 12
    assert (Workers.most > 1) == workers.overlap
    for outcome, table in zip(outcomes, tables(outcomes), strict=True):
        assert table["capture"].tolist() == [int(i) for i in plan.corpus.index]
        assert table["fold"].unique().tolist() == ["1", "2", "3", "4"] and outcome.complete and not outcome.errors
        assert outcome.metrics == {"captures": len(plan.corpus), "folds": 4, "folds_failed": 0}


def test_the_same_run_twice_in_one_command_is_computed_once(store, plan, monkeypatch, capsys):
    monkeypatch.setattr(loop, "Processes", Several)
    outcomes = execute(todo(plan, 0, 0, 1))
    assert sorted(DONE) == [(n, f) for n in (0, 1) for f in "1234"] and len(store.parents("echo")) == 2
    assert outcomes[0]["run_id"] == outcomes[1]["run_id"] != outcomes[2]["run_id"]
    assert re.search(r"all 4 folds .*stored", capsys.readouterr().err)


def test_a_result_reads_its_tables_from_the_store(store, plan):
    for _ in range(2):  # computed, and found again
        (outcome,) = execute(todo(plan, 0))
        shorter = pd.read_parquet(path := store.runs[outcome["run_id"]].folder / "predictions.parquet").iloc[1:]
        shorter.to_parquet(path, index=False)
        assert [*outcome.tables] == ["predictions"] and len(outcome.tables["predictions"]) == len(shorter)


def test_predictions_are_stored_once_and_folds_of_a_finished_run_have_them(store, plan):
    tables = []
    for _ in range(2):  # computed, and found again
        (outcome,) = execute(todo(plan, 0))
        tables.append([fold.predictions for fold in MEASURED[0]])
        files = {path.name for fold in store.folds(outcome["run_id"]) for path in (fold.folder / "fold").iterdir()}
        assert files == {"timing.json"}
    assert len(DONE) == 4 and all(a.equals(b) for a, b in zip(*tables, strict=True))


@pytest.mark.parametrize("workers", [Workers, Several])
@pytest.mark.parametrize(("how", "error"), [(KeyboardInterrupt, Interrupted), (ClusterError, ClusterError)])
def test_what_is_cut_off_goes_on_and_ends_the_same(workers, how, error, store, plan, monkeypatch):
    monkeypatch.setattr(loop, "Processes", workers)
    monkeypatch.setattr(Workers, "stop", 5)
    monkeypatch.setattr(Workers, "how", how)
    with pytest.raises(error):
        execute(todo(plan, 0, 1))
    assert len(DONE) == 5 and "KILLED" in store.statuses() and "RUNNING" not in store.statuses()
    monkeypatch.setattr(Workers, "stop", -1)
    resumed = execute(todo(plan, 0, 1))
    assert len(DONE) == 8 and len({*DONE}) == 8 and store.statuses() == ["FINISHED"] * 2
    folds = {**MEASURED}
    monkeypatch.setattr(loop, "connect", lambda writes: Memory())
    for number, (a, b) in enumerate(zip(resumed, execute(todo(plan, 0, 1)), strict=True)):
        assert a.tables["predictions"].equals(b.tables["predictions"]) and a.metrics == b.metrics
        assert [vars(r) | {"predictions": 0, "seconds": 0, "scored": 0} for r in folds[number]] == [
            vars(r) | {"predictions": 0, "seconds": 0, "scored": 0} for r in MEASURED[number]
        ]


def test_a_failed_fold_is_recorded_the_others_go_on_and_it_alone_is_tried_again(store, plan, monkeypatch, capsys):
    monkeypatch.setattr(Echo, "fails", {"2": SystemExit("enough"), "3": ValueError("not finite\n  at frame 7")})
    (outcome,) = execute(todo(plan, 0))
    assert [r.name for r in MEASURED[0]] == ["1", "4"] and not outcome.complete and set(outcome.errors) == {"2", "3"}
    assert "ValueError: not finite" in Path(outcome.errors["3"].where).read_text()
    (run,) = store.parents("echo")
    assert run.info.status == "FAILED" and (run.data.metrics["folds"], run.data.metrics["folds_failed"]) == (2, 2)
    assert {f.data.tags["touchbench.fold"]: f.info.status for f in store.folds(run.info.run_id)} == {
        "1": "FINISHED",
        "2": "FAILED",
        "3": "FAILED",
        "4": "FINISHED",
    }
    err = capsys.readouterr().err
    assert "fold 2 failed: SystemExit: enough" in err and "fold 3 failed: ValueError: not finite\n" in err
    assert failures([outcome]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    error, where = outcome.errors["2"]
    assert error == "SystemExit: enough" and line.endswith(f"; SystemExit: enough; traceback of the first: {where}")
    Echo.fails.clear()
    DONE.clear()
    (outcome,) = execute(todo(plan, 0))
    assert DONE == [(0, "2"), (0, "3")] and not outcome.errors and store.statuses() == ["FINISHED"]
    monkeypatch.setattr(Echo, "fails", {f: ValueError() for f in "1234"})
    (outcome,) = execute(todo(plan, 1))
    assert not outcome.scored and outcome.metrics == {"folds": 0, "folds_failed": 4} and store.statuses()[1] == "FAILED"


def test_a_run_of_another_process_ends_the_command_after_those_before_it(store, plan, monkeypatch):
    monkeypatch.setattr(loop, "Processes", Several)
    keys = {0: "one", 1: "two", 2: "three"}
    monkeypatch.setattr(loop, "key_of", lambda plan: keys[plan.cell.study.number])
    (home() / "locks").mkdir(parents=True)
    with FileLock(home() / "locks" / "two.lock"), pytest.raises(InputError, match="another process"):
        execute(todo(plan, 0, 1, 2))
    assert {number for number, _ in DONE} == {0} and store.statuses() == ["FINISHED"]
    assert len(execute(todo(plan, 0, 1, 2))) == 3  # all locks are free again


def test_locks_are_free_after_an_error_of_the_store(store, plan, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(StoreError):
        patch.setattr(store, "keep", lambda *_: (_ for _ in ()).throw(StoreError("full")))
        execute(todo(plan, 0))
    assert len(execute(todo(plan, 0))) == 1


def test_a_run_names_its_machines(store, plan, monkeypatch):
    monkeypatch.setattr(Workers, "machines", (Machine("fast", "avx2"), Machine("slow", "sse")))
    execute(todo(plan, 0))
    (run,) = store.parents("echo")
    first = run.data.params["cpu"]
    assert first == "slow" and run.data.tags["cpu"] == "fast; slow" and run.data.tags["simd"] == "avx2; sse"
    named = {f.data.tags["touchbench.fold"]: f.data.params.get("cpu", first) for f in store.folds(run.info.run_id)}
    assert named == {"1": "slow", "2": "fast", "3": "slow", "4": "fast"}
    execute(todo(plan, 0))
    assert run.data.tags["cpu"] == "fast; slow"


class Counting(Wayward):
    """Counts how often it is made."""

    made = []

    def __init__(self):
        super().__init__()
        self.made.append(type(self).__name__)


class Splits:
    made = []

    def __init__(self):
        self.made.append(1)

    def split(self, X, y, groups):
        for name in sorted(set(groups)):
            yield np.flatnonzero(groups != name), np.flatnonzero(groups == name)


def test_a_system_and_a_protocol_are_built_once_before_the_first_fold(store, monkeypatch, tmp_path):
    """Each fold then trains a system of its own."""
    from bench.plan import cells as module

    real = module.load
    own = {"counting": Counting, "splits": Splits}
    monkeypatch.setattr(module, "load", lambda room, name: own.get(name) or real(room, name))
    Counting.made.clear()
    Splits.made.clear()
    made = prepared(cells({"model": "counting", "protocol": "splits", **TINY}), 1)
    assert len(Counting.made) == 1
    execute(made)
    assert len(Counting.made) == 1 + 4 and len(Splits.made) == 1


@pytest.mark.measured
def test_a_run_is_tracked_whole(capsys):
    assert main(["run", "model=svm,cnn85", "model.epochs=2", *SMALL]) == 0
    out = capsys.readouterr().out
    assert "svm · jung54" in out and "cnn85[epochs=2]" in out and "synthetic" in out
    store, (svm, cnn) = runs("cell")
    assert svm.info.status == "FINISHED" and svm.data.tags["synthetic"] == "true"
    assert svm.data.params["model.C"] == "512.0" and svm.data.params["features"] == "jung54"
    assert {"corpus_digest", "threads", "cpu", "version.scikit-learn", "protocol"} <= set(svm.data.params)
    metrics = "accuracy subject_accuracy_mean subject_accuracy_sd macro_f1 macro_recall macro_precision fit_seconds "
    metrics += "predict_ms_p50 predict_ms_p95 decision_ms parameters flash_bytes ram_bytes peak_rss_bytes"
    assert {*metrics.split()} <= set(svm.data.metrics) & set(cnn.data.metrics)
    assert {"window_accuracy", "vote_accuracy"} <= set(cnn.data.metrics)
    assert store.run(cnn.info.run_id).inputs.dataset_inputs[0].dataset.name == "synth"
    table = predictions(store, svm)
    assert len(table) == 4 * 14 and list(table["fold"].unique()) == ["1", "2", "3", "4"]
    assert (table["fold"] == table["subject"]).all() and {"variant", "true", "p_grab", "frames"} <= set(table)
    right = table.filter(like="p_").idxmax(axis=1).str[2:] == table["true"]
    assert svm.data.metrics["accuracy"] == pytest.approx(right.mean())
    child = store.folds(cnn.info.run_id)[0]
    assert [m.step for m in store.client.get_metric_history(child.info.run_id, "loss")] == [1, 2]
    files = "predictions.parquet confusion.csv per_subject.parquet per_class.csv "
    files += "confusion.parquet per_class.parquet"
    assert {a.path for a in store.client.list_artifacts(svm.info.run_id)} == {*files.split()}
    assert main(["run", "model=svm", *SMALL]) == 0  # the same again computes nothing
    assert "already stored" in capsys.readouterr().err and len(runs("cell")[1]) == 2
    assert runs("cell")[1][0].data.metrics == svm.data.metrics


def test_a_whole_number_that_only_some_folds_choose_is_stored_and_shown_whole(store, plan, monkeypatch):
    fold, chosen = Echo.fold, {"1": {"trees": 20000, "C": 0.5}, "2": {"level": True, "C": 40000.0}}
    monkeypatch.setattr(Echo, "fold", lambda *all: replace(fold(*all), chosen=chosen.get(all[3].name, {"C": 1})))
    (result,) = execute(todo(plan, 0))
    texts = choices_table(result).texts
    assert [row["trees"] for row in texts] == ["20000", "", "", ""] and texts[1]["level"] == "True"
    assert [row["C"] for row in texts] == ["0.5", "4e+04", "1", "1"] and result.tables["chosen"]["C"].dtype == float
    lines = (store.runs[result["run_id"]].folder / "chosen.csv").read_text().splitlines()
    assert lines[:3] == ["fold,trees,C,level", "1,20000,0.5,", "2,,40000.0,True"]


def test_peak_memory_is_that_of_the_fold_alone():
    forget_peak()
    before = peak_memory()
    array = np.ones(60_000_000)  # 480 MB
    assert peak_memory() > before + array.nbytes / 2
    del array
    forget_peak()
    assert peak_memory() < before + 240_000_000


def test_cores_are_shared_out():
    cores = len(os.sched_getaffinity(0))
    assert share_cores(None, 100) == (cores, 1) and share_cores(None, 1) == (1, cores)
    assert share_cores(1, 100) == (1, cores)
    for jobs in (1, 2, 3, 64):
        workers, threads = share_cores(jobs, 10)
        assert workers * threads <= cores
