"""Whole runs: what is tracked, what a second command does, and what happens when something goes wrong."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from filelock import FileLock
from joblib.externals.loky import get_reusable_executor

from bench import progress, registry
from bench.cli import main
from bench.corpora.library import open_corpus
from bench.outcomes.store import connect
from bench.plan import cells
from bench.plan.plan import Plan, folds_of, share_cores
from bench.scratch import home
from bench.work import loop
from bench.work.fold import decisions, forget_peak, peak_memory
from bench.work.workers import Processes
from tests.conftest import BENCH, InProcess, predictions, random_corpus, runs
from tests.work.wayward import Wayward

SMALL = ["data.subjects=4", "data.variants=normal", "jobs=2"]


@pytest.fixture
def wayward(tmp_path, monkeypatch):
    """A system of an installed package, known by its entry point only, to this process and to new workers."""
    info = tmp_path / "site" / "wayward-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: wayward\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[touchbench.models]\nwayward = tests.work.wayward:Wayward\n")
    monkeypatch.syspath_prepend(info.parent)
    registry.names.cache_clear()
    get_reusable_executor().shutdown(kill_workers=True)
    yield
    registry.names.cache_clear()
    get_reusable_executor().shutdown(kill_workers=True)


def finished_folds():
    return {f.info.run_id for f in runs("fold")[1] if f.info.status == "FINISHED"}


def test_short_captures_are_warned_of_whatever_has_windows(monkeypatch):
    """A system of the user's with a parameter ``frames`` has no length in seconds."""

    class Windowed(Wayward):
        def __init__(self, frames=50):
            super().__init__()
            self.frames = frames

    found = registry.load
    monkeypatch.setattr(cells, "load", lambda room, name: Windowed if name == "windowed" else found(room, name))
    corpus = open_corpus("synth", {"subjects": 2, "variants": ("normal",)})

    def warned(model, parameters):
        part = cells.Part("models", model, parameters)
        cell = cells.Cell("synth", {}, "", "gesture", cells.Part("protocols", "loso", {}), None, part)
        (line,) = loop.warnings(Plan(cell, corpus, tuple(folds_of(cell, corpus)), 1, 1)) or [""]
        return int(line.split()[2]) if line else 0

    assert warned("windowed", {"frames": 50}) == (corpus.lengths < 50).sum() > 0
    assert warned("windowed", {"frames": 1}) == 0
    usual = {"frames": 85, "seconds": 0.0}
    assert warned("cnn85", usual) == (corpus.lengths < 85).sum()
    assert warned("cnn85", usual | {"seconds": 0.5}) == (corpus.lengths < 68).sum()  # of 135 Hz, rounded to even


def test_peak_memory_is_that_of_the_fold_alone():
    forget_peak()
    before = peak_memory()
    held = np.ones(60_000_000)  # 480 MB
    assert peak_memory() > before + held.nbytes / 2
    del held
    forget_peak()
    assert peak_memory() < before + 240_000_000


def test_a_run_is_tracked_whole(capsys):
    assert main(["run", "model=svm,cnn85", "model.epochs=2", *SMALL]) == 0
    out = capsys.readouterr().out
    assert "svm · jung54" in out and "cnn85[epochs=2]" in out and "synthetic" in out
    client, parents = runs("cell")
    assert len(parents) == 2
    svm, cnn = parents
    assert svm.info.status == "FINISHED" and svm.data.tags["synthetic"] == "true"
    assert svm.data.params["model.C"] == "512.0" and svm.data.params["features"] == "jung54"
    assert {"corpus_digest", "threads", "cpu", "version.scikit-learn", "protocol"} <= set(svm.data.params)
    names = {
        "accuracy",
        "subject_accuracy_mean",
        "subject_accuracy_sd",
        "macro_f1",
        "macro_recall",
        "macro_precision",
        "fit_seconds",
        "predict_ms_p50",
        "predict_ms_p95",
        "decision_ms",
        "parameters",
        "flash_bytes",
        "ram_bytes",
        "peak_rss_bytes",
    }
    assert names <= set(svm.data.metrics) and names | {"window_accuracy", "vote_accuracy"} <= set(cnn.data.metrics)
    assert cnn.inputs.dataset_inputs[0].dataset.name == "synth"
    table = predictions(client, svm)
    assert len(table) == 4 * 14 and list(table["fold"].unique()) == ["1", "2", "3", "4"]
    assert (table["fold"] == table["subject"]).all() and {"variant", "true", "p_grab", "frames"} <= set(table)
    right = table.filter(like="p_").idxmax(axis=1).str[2:] == table["true"]
    assert svm.data.metrics["accuracy"] == pytest.approx(right.mean())
    _, folds = runs("fold")
    assert len(folds) == 8
    child = next(f for f in folds if f.data.tags["mlflow.parentRunId"] == cnn.info.run_id)
    assert [m.step for m in client.client.get_metric_history(child.info.run_id, "loss")] == [1, 2]
    kept = {a.path for a in client.client.list_artifacts(svm.info.run_id)}
    assert kept == {
        "predictions.parquet",
        "confusion.csv",
        "confusion.png",
        "confusion.svg",
        "per_subject.csv",
        "per_class.csv",
    }

    assert main(["run", "model=svm", *SMALL]) == 0  # the same again computes nothing
    assert "stored before" in capsys.readouterr().err and len(runs("cell")[1]) == 2

    assert main(["report"]) == 0
    text = Path("report/comparison.md").read_text()
    assert text.count("| synth (synthetic)") >= 4 and "say nothing about people" in text
    table = pd.read_csv("report/comparison.csv")
    assert set(table["unit"]) == {"capture", "window"}
    assert set(table["combined"].fillna("")) == {"", "mean probability", "majority vote"}
    assert table["published"].isna().all() and Path("report/index.html").stat().st_size > 100_000
    drawn = {p.suffix for p in Path("report/figures").iterdir()}
    assert drawn == {".png", ".svg"} and list(Path("report/figures").glob("*-speed.png"))


def test_an_interrupted_run_goes_on_and_ends_the_same_bit_for_bit(tmp_path, monkeypatch):
    command = ["run", "model=rf", "model.trees=20", *SMALL]
    seen, computed = [], []
    with monkeypatch.context() as patch:

        class Interrupted(InProcess):
            def finished(self):
                if len(seen) == 2:
                    raise KeyboardInterrupt
                done = super().finished()
                seen.append(done.result.name)
                return done

        patch.setattr(loop, "Processes", Interrupted)
        assert main(command) == 130
    store, (parent,) = runs("cell")
    assert parent.info.status == "KILLED" and len(runs("fold")[1]) == 2

    class Watched(InProcess):
        def submit(self, task):
            computed.append(task.fold.name)
            super().submit(task)

    monkeypatch.setattr(loop, "Processes", Watched)
    assert main(command) == 0
    assert sorted(computed + seen) == ["1", "2", "3", "4"]
    store, (parent,) = runs("cell")
    assert parent.info.status == "FINISHED" and parent.data.metrics["folds"] == 4
    resumed = predictions(store, parent)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    assert main(command) == 0
    store, (parent,) = runs("cell")
    assert resumed.equals(predictions(store, parent))


@pytest.mark.live
@pytest.mark.real_store
@pytest.mark.pool
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_control_c_keeps_the_finished_folds(tmp_path):
    command = [*BENCH, "run", "model=rf", "model.trees=500", "data.subjects=12", "jobs=1"]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    connect()
    deadline = time.time() + 300  # a busy machine takes minutes
    while time.time() < deadline and len(finished_folds()) < 2:
        time.sleep(0.3)
    before = finished_folds()
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 130 and "goes on from there" in error and "Traceback" not in error
    assert len(before) >= 2 and before <= finished_folds() and len(finished_folds()) < 12


@pytest.mark.pool
@pytest.mark.parametrize(
    ("how", "told"),
    [
        ("fail", "cannot learn without 3"),
        ("nan", "not finite"),
        ("die", "died"),
        ("exit", "SystemExit: enough"),
    ],
)
def test_a_fold_that_fails_is_recorded_and_the_others_go_on(how, told, wayward, capsys, monkeypatch):
    command = ["run", "model=wayward", f"model.{how}=3", *SMALL]
    first, over = Processes.finished, []

    def finished(self):
        done = first(self)
        over.append(done.task.fold.name)
        assert not {said.fold for said in progress.messages(self.folder)} & {*over}  # none of them is under way any longer
        return done

    monkeypatch.setattr(Processes, "finished", finished)
    assert main(command) == 1
    assert sorted(over) == ["1", "2", "3", "4"]
    captured = capsys.readouterr()
    last = captured.err.splitlines()[-1]
    assert "1 failed" in last and "fold 3" in last and told in Path(last.split(" is in ")[1]).read_text()
    assert "3/4" in captured.out
    client, (parent,) = runs("cell")
    assert parent.info.status == "FAILED" and parent.data.metrics["folds_failed"] == 1
    assert parent.data.metrics["accuracy"] == pytest.approx(1 / 14)
    folds = {f.data.tags["touchbench.fold"]: f for f in runs("fold")[1]}
    assert {n: f.info.status for n, f in folds.items()} == {
        "1": "FINISHED",
        "2": "FINISHED",
        "3": "FAILED",
        "4": "FINISHED",
    }
    trace = Path(client.fetched(folds["3"].info.run_id, "fold/traceback.txt")).read_text()
    assert told in trace
    assert main(command) == 1  # a failed fold is tried again, the others are not
    assert len(runs("fold")[1]) == 4 and len(runs("cell")[1]) == 1


def test_the_same_cell_twice_at_once_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(loop, "key_of", lambda *_: "one")
    (home() / "locks").mkdir(parents=True)
    with FileLock(home() / "locks" / "one.lock"):
        assert main(["run", *SMALL]) == 2
    assert "another process is running this very cell" in capsys.readouterr().err


@pytest.mark.live
@pytest.mark.real_store
def test_stores_created_by_several_processes_at_once_are_whole(tmp_path):
    code = "from bench.outcomes.store import connect; print(connect().experiment_id)"
    started = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    said = [p.communicate(timeout=300)[0].split()[-1] for p in started]
    assert len(set(said)) == 1 and all(p.returncode == 0 for p in started)


def test_a_dataset_that_another_run_makes_at_the_same_moment_is_no_failure(monkeypatch):
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    tried, real = [], MlflowClient.log_inputs

    def crossed(self, *args, **kwargs):
        tried.append(1)
        if len(tried) < 3:
            raise MlflowException("UNIQUE constraint failed: datasets.experiment_id, datasets.name, datasets.digest")
        real(self, *args, **kwargs)

    monkeypatch.setattr(MlflowClient, "log_inputs", crossed)
    assert main(["run", "model=svm", *SMALL]) == 0
    _, (run_,) = runs("cell")
    assert len(run_.inputs.dataset_inputs) == 1 and len(tried) == 3


def test_a_system_that_cannot_be_trained_is_refused_before_anything_runs(capsys):
    assert main(["run", "data.subjects=2", "data.variants=normal", "model=zhou2016_gm_lstm"]) == 2
    assert "lets one training subject choose the epoch; train on two or more" in capsys.readouterr().err
    assert not Path("mlflow.db").exists()


def test_a_corpus_is_imported_exported_and_selected(tmp_path, capsys):
    assert main(["data", "export", "synth", "out.csv", "format=cost", "subjects=2", "seed=3"]) == 0
    assert "synthetic captures" in capsys.readouterr().out
    assert main(["data", "import", "cost", "out.csv", "name=mine"]) == 0
    captured = capsys.readouterr()
    assert "mine: 84 synthetic captures, 2 subjects, 14 gestures" in captured.out and "7805 published" in captured.err
    before = (home() / "corpora" / "mine" / "current").read_text()
    Path("broken.csv").write_text(Path("out.csv").read_text()[:-5] + "x\n")
    assert main(["data", "import", "cost", "broken.csv", "name=mine"]) == 2
    assert "line" in capsys.readouterr().err
    assert (home() / "corpora" / "mine" / "current").read_text() == before
    with FileLock(home() / "corpora" / ".mine.lock"):
        assert main(["data", "import", "cost", "out.csv", "name=mine"]) == 2
    assert "another import of name=mine is under way" in capsys.readouterr().err
    assert main(["data"]) == 0
    listed = capsys.readouterr().out
    assert "mine" in listed and before in listed and "licence: none needed" in listed
    assert main(["run", "data=mine", "where=variant == 'rough'", "model=bayes"]) == 0
    client, (parent,) = runs("cell")
    assert parent.data.tags["subset"] == "variant == 'rough'"
    table = predictions(client, parent)
    assert set(table["variant"]) == {"rough"} and len(table) == 28


def test_an_import_replaces_the_old_corpus_and_an_open_one_stays_readable(tmp_path):
    from bench.corpora.library import import_corpus, open_corpus

    for seed in (1, 2):
        main(["data", "export", "synth", f"{seed}.csv", "subjects=1", f"seed={seed}"])
    import_corpus("cost", Path("1.csv"), {"name": "a"})
    first = open_corpus("a", {})
    values = first.frames.copy()
    import_corpus("cost", Path("2.csv"), {"name": "a"})
    assert np.array_equal(first.frames, values) and open_corpus("a", {}).digest != first.digest
    assert len([p for p in (home() / "corpora" / "a").iterdir() if p.is_dir()]) == 1


def test_cores_are_shared_out():
    cores = len(os.sched_getaffinity(0))
    assert share_cores(None, 100) == (cores, 1) and share_cores(None, 1) == (1, cores)
    assert share_cores(1, 100) == (1, cores)
    for jobs in (1, 2, 3, 64):
        workers, threads = share_cores(jobs, 10)
        assert workers * threads <= cores


def test_a_system_without_probabilities_gets_one_for_its_label(corpus):
    class Labels(Wayward):
        predict_proba = property()

    model = Labels().fit(corpus, corpus.gestures)
    table = decisions(model, corpus, "x", np.array([3, 1]))
    assert list(table["capture"]) == [3, 1] and (table["p_pat"] == 1).all() and (table["p_rub"] == 0).all()


def test_a_data_folder_that_cannot_be_written_is_one_line(tmp_path, monkeypatch, capsys):
    assert main(["data", "export", "synth", "a.csv", "subjects=2"]) == 0
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "file"))
    capsys.readouterr()
    for command in (["run", "data.subjects=2"], ["data", "import", "cost", "a.csv"]):
        assert main(command) == 2
        error = capsys.readouterr().err
        assert "cannot be written" in error and "TOUCHBENCH_HOME" in error and error.count("\n") == 1


def test_random_splits_that_test_the_same_subject_are_different_folds():
    from bench.plan.cells import cells

    (cell,) = cells({"protocol": "challenge"})
    names = [f.name for f in folds_of(cell, random_corpus(subjects=2))]
    assert names == [f"fold{i:02d}" for i in range(1, 6)]


def test_folds_are_named_after_their_subject():
    from bench.plan.cells import cells

    (cell,) = cells({})
    assert [f.name for f in folds_of(cell, random_corpus(subjects=3))] == ["1", "2", "3"]
    (cell,) = cells({"protocol": "kfold", "protocol.folds": "3"})
    assert [f.name for f in folds_of(cell, random_corpus(subjects=3))] == ["fold01", "fold02", "fold03"]
