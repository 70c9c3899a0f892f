"""Folds on a cluster: one machine, with a scheduler and workers of dask as people start them."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from bench.cli import main
from bench.on_cluster import cluster
from tests.commands.test_server import free_port
from tests.conftest import BENCH, predictions, runs

pytest.importorskip("distributed", reason="dask.distributed is not installed: pip install 'touchbench[cluster]'")
pytestmark = [pytest.mark.live, pytest.mark.skipif(os.name == "nt", reason="signals")]
ROOT = Path(__file__).parents[2]
SMALL = ["data.subjects=4", "data.variants=normal", "data.repetitions=2"]
PATIENCE = 240  # seconds on a busy machine
MODEL = '''
import os, time
from pathlib import Path
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from bench.progress import tell

class Slow(ClassifierMixin, BaseEstimator):
    """Leaves a mark of the fold and its process; then waits, for ``go`` too, or dies."""
    def __init__(self, marks="", seconds=0.0, die="", wait=""):
        self.marks, self.seconds, self.die, self.wait = marks, seconds, die, wait
    def fit(self, X, y):
        (fold,) = {"1", "2", "3", "4"} - set(X.subjects)
        Path(self.marks, f"{fold}_{os.getpid()}_{os.getppid()}_{time.time()}").touch()
        if fold == self.die:
            os._exit(9)
        tell(f"fold {fold} waits", self.seconds)
        time.sleep(self.seconds)
        while fold in self.wait and not Path(self.marks, "go").exists():
            time.sleep(0.1)
        self.classes_ = np.unique(y)
        return self
    def predict_proba(self, X):
        return np.tile(np.eye(len(self.classes_))[0], (len(X), 1))
    def predict(self, X):
        return np.full(len(X), self.classes_[0])
'''


def stored():
    store, tracked = runs("cell")
    return {run.info.run_name: predictions(store, run) for run in tracked}


@contextmanager
def dask(what, *arguments, **env):
    """``dask scheduler`` or ``dask worker``, in a group of its own that is killed at last."""
    said = Path(f"{what}_{time.time()}.txt").absolute()
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TOUCHBENCH_HOME": str(Path("remote_home").absolute())} | env
    environment.pop("OMP_NUM_THREADS", None)
    with said.open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments, "--no-dashboard"],
            stdout=log,
            stderr=log,
            start_new_session=True,
            env=environment,
        )
    try:
        yield process
    finally:
        end(process.pid)
        process.wait()


def end(group):
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        pass


@contextmanager
def scheduler(port=None):
    port = port or free_port()
    with dask("scheduler", "--host", "127.0.0.1", "--port", str(port)):
        yield f"tcp://127.0.0.1:{port}"


def workers(place, count=2, *more, **env):
    return dask("worker", place, "--nworkers", str(count), "--nthreads", "1", *more, **env)


@pytest.fixture
def two():
    with scheduler() as place, workers(place):
        yield place


@pytest.fixture
def slow(tmp_path):
    """The words that run the model above, and where it leaves its marks."""
    (tmp_path / "slow.py").write_text(MODEL)
    (tmp_path / "marks").mkdir()
    return ["run", "model=slow.py:Slow", f"model.marks={tmp_path / 'marks'}", *SMALL], tmp_path / "marks"


def marks(folder):
    """(fold, process, its parent) in the order in which they began."""
    found = [path.name.split("_") for path in folder.glob("*_*")]
    return [(fold, int(pid), int(parent)) for fold, pid, parent, _ in sorted(found, key=lambda m: float(m[3]))]


def until(true, seconds=PATIENCE):
    begun = time.monotonic()
    while not (found := true()):
        assert time.monotonic() - begun < seconds
        time.sleep(0.05)
    return found


def gone(pid):
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def begun(command, **how):
    return subprocess.Popen(
        [*BENCH, *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        **how,
    )


def test_folds_of_all_cells_are_done_there_and_are_the_same_bit_for_bit(two, tmp_path, monkeypatch, capsys):
    command = ["run", "model=svm,cnn85", "model.epochs=1", "features=jung28", *SMALL]
    assert main([*command, f"cluster={two}"]) == 0
    found, (store, there) = stored(), runs("cell")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    monkeypatch.setattr("bench.plan.plan.share_cores", lambda jobs, folds: (1, 1))  # as many threads as there
    assert main(command) == 0
    store, here = runs("cell")
    assert len(there) == 2 and {r.data.tags["touchbench.cell"] for r in there} == {
        r.data.tags["touchbench.cell"] for r in here
    }
    assert all(table.equals(found[name]) for name, table in stored().items())
    same = ("cpu", "simd", "threads", "corpus_digest", "version.numpy")
    assert all(a.data.params[k] == b.data.params[k] for a, b in zip(there, here, strict=True) for k in same)
    assert not any("cpu" in run.data.tags for run in there)
    capsys.readouterr()
    assert main([*command, f"cluster={two}"]) == 0 and "already stored" in capsys.readouterr().err


def test_a_worker_with_other_code_is_left_out(tmp_path, capsys):
    for package in ("bench", "features", "models", "protocols", "reports"):
        old = tmp_path / "old" / "bench"
        shutil.copytree(ROOT / package, old if package == "bench" else old / package)
    file = old / "models" / "classic" / "svm.py"
    file.write_text(file.read_text() + "\nCHANGED = 1\n")
    with scheduler() as place, workers(place, 1, PYTHONPATH=str(tmp_path / "old")):
        command = ["run", "model=svm", "features=jung28", *SMALL, f"cluster={place}"]
        assert main(command) == 2
        (*_, line) = capsys.readouterr().err.splitlines()
        assert "none of 1 workers" in line and "touchbench's code" in line
        assert not Path("mlflow.db").exists()
        with workers(place, 1):
            assert until(lambda: main(command) == 0)
            error = capsys.readouterr().err
            assert " is left out: it has touchbench's code" in error and "4/4" in error


@pytest.mark.nightly
def test_something_else_that_listens_and_a_cluster_without_workers(monkeypatch, capsys):
    monkeypatch.setattr(cluster, "ANSWER_S", 5.0)
    monkeypatch.setattr(cluster, "FIRST_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        assert main(["run", *SMALL, f"cluster=tcp://127.0.0.1:{mute.getsockname()[1]}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no scheduler answers (TimeoutError after 5 s)" in line
    with scheduler() as place:
        assert until(lambda: main(["run", *SMALL, f"cluster={place}"]) == 2)
        assert f"has no worker; start some, such as: dask worker {place}" in capsys.readouterr().err


@pytest.mark.nightly
def test_a_worker_that_is_killed_loses_no_fold(two, slow, capsys):
    command, folder = slow
    process = begun([*command, "model.seconds=4", f"cluster={two}"])
    fold, pid, worker = until(lambda: marks(folder))[0]
    os.kill(worker, signal.SIGKILL)
    out, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0 and "4/4" in out, error
    began = [m for m in marks(folder) if m[0] == fold]
    assert len(began) == 2 and began[1][2] != worker
    until(lambda: gone(pid))


@pytest.mark.nightly
def test_a_worker_computes_with_the_code_that_is_there_now(tmp_path, monkeypatch):
    """Its process has the old code in memory, and would stay for the next command."""
    code = tmp_path / "code" / "bench"  # as it is installed
    shutil.copytree(ROOT / "bench", code)
    for package in ("features", "models", "protocols", "reports"):
        shutil.copytree(ROOT / package, code / package)
    file = code / "models" / "classic" / "tree.py"
    command = ["run", "model=tree", "features=jung28", *SMALL]

    def labels(store, *where):
        env = {"PYTHONPATH": str(tmp_path / "code"), "MLFLOW_TRACKING_URI": f"sqlite:///{tmp_path}/{store}.db"}
        done = subprocess.run([*BENCH, *command, *where], capture_output=True, text=True, env=os.environ | env)
        assert done.returncode == 0, done.stderr
        monkeypatch.setenv("MLFLOW_TRACKING_URI", env["MLFLOW_TRACKING_URI"])
        store, found = runs("cell")
        return predictions(store, found[-1])

    with scheduler() as place, workers(place, 1, PYTHONPATH=str(tmp_path / "code")):
        before = labels("there", f"cluster={place}")
        file.write_text(file.read_text().replace("ccp_alpha=alpha", "max_depth=1"))
        after = labels("there", f"cluster={place}")
    here = labels("here", "jobs=1")
    assert after.equals(here) and not after.equals(before)


@pytest.mark.nightly
def test_the_scheduler_is_gone_and_the_same_command_goes_on(slow, capsys):
    command, folder = slow
    port = free_port()
    command += ["model.seconds=1.5", f"cluster=tcp://127.0.0.1:{port}"]
    with scheduler(port) as place, workers(place, 1):
        process = begun(command)
        until(lambda: len(marks(folder)) >= 3)
        last = marks(folder)[-1]
    out, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1 and "Traceback" not in error, error
    assert "the scheduler is gone; every finished fold is stored" in error.splitlines()[-1]
    until(lambda: gone(last[1]))
    store, (run,) = runs("cell")
    done = {f.info.run_id for f in store.folds(run.info.run_id) if f.info.status == "FINISHED"}
    assert run.info.status == "KILLED" and len(done) >= 1
    with scheduler(port) as place, workers(place, 1):
        assert until(lambda: main(command) == 0)
    store, (run,) = runs("cell")
    assert run.info.status == "FINISHED"
    assert done < {f.info.run_id for f in store.folds(run.info.run_id)}


@pytest.mark.nightly
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGKILL])
def test_workers_stop_with_their_command_and_the_same_command_goes_on(sign, two, slow):
    command, folder = slow
    command += ["model.wait=34", f"cluster={two}"]
    process = begun(command)
    until(lambda: len(marks(folder)) == 4)
    folds = [pid for fold, pid, _ in marks(folder) if fold in "34"]
    time.sleep(3)  # the others are stored
    os.kill(process.pid, sign)
    until(lambda: all(map(gone, folds)), 20)
    _, error = process.communicate(timeout=60)
    if sign == signal.SIGINT:
        assert process.returncode == 130 and "continues from there" in error and "Traceback" not in error
    (folder / "go").touch()
    assert main(command) == 0
    assert sorted(fold for fold, _, _ in marks(folder)) == ["1", "2", "3", "3", "4", "4"]
