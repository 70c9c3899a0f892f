"""Folds on one machine's scheduler and workers of Dask, as people start them."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
import yaml

from bench.cli import main
from tests.commands.test_server import free_port
from tests.conftest import predictions, runs

pytest.importorskip(
    "touchbench_dask", reason="touchbench-dask is not installed: pip install ./addons/dask"
)
pytestmark = [pytest.mark.live, pytest.mark.skipif(os.name == "nt", reason="signals")]
ROOT = Path(__file__).parents[3]
SMALL = ["data.subjects=4", "data.variants=normal", "data.repetitions=2"]
MODEL = '''
import os, time
from pathlib import Path
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin

class Slow(ClassifierMixin, BaseEstimator):
    """Leaves a mark with its process in each fold, then takes its time."""
    def __init__(self, marks=""):
        self.marks = marks
    def fit(self, X, y):
        (fold,) = {"1", "2", "3", "4"} - set(X.subjects)
        Path(self.marks, f"{fold}_{os.getpid()}_{time.time()}").touch()
        time.sleep(4)
        self.classes_ = np.unique(y)
        return self
    def predict_proba(self, X):
        return np.tile(np.eye(len(self.classes_))[0], (len(X), 1))
    def predict(self, X):
        return np.full(len(X), self.classes_[0])
'''


@contextmanager
def dask(what, *arguments):
    """``dask scheduler`` or ``dask worker``, in a group of its own that is killed at last."""
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "TOUCHBENCH_HOME": str(Path("remote_home").absolute()),
    }
    command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments, "--no-dashboard"]
    with Path(f"{what}_{time.time()}.txt").open("w") as log:
        process = subprocess.Popen(
            command, stdout=log, stderr=log, start_new_session=True, env=environment
        )
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def place():
    port = str(free_port())
    address = f"tcp://127.0.0.1:{port}"
    scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", port)
    with scheduler, dask("worker", address, "--nworkers", "2", "--nthreads", "1"):
        yield address


def test_folds_are_done_there_and_are_the_same_bit_for_bit(place, tmp_path, monkeypatch, capsys):
    command = ["run", "model=svm,bayes", "features=jung28", *SMALL]
    assert main([*command, f"cluster={place}"]) == 0
    store, there = runs("cell")
    found = {run.data.tags["touchbench.cell"]: predictions(store, run) for run in there}
    capsys.readouterr()
    assert main([*command, f"cluster={place}"]) == 0 and "already stored" in capsys.readouterr().err
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    monkeypatch.setattr(
        "bench.plan.plan.share_cores", lambda jobs, folds: (1, 1)
    )  # as many threads as there
    assert main(command) == 0
    store, here = runs("cell")
    assert len(found) == 2
    assert all(
        predictions(store, run).equals(found[run.data.tags["touchbench.cell"]]) for run in here
    )


def test_a_worker_that_is_killed_loses_no_fold(place, tmp_path, capsys):
    (tmp_path / "slow.py").write_text(MODEL)
    marks = tmp_path / "marks"
    marks.mkdir()
    code = "import os, signal, sys, time; from pathlib import Path\n"
    code += "while not (found := [*Path(sys.argv[1]).iterdir()]): time.sleep(0.1)\n"
    code += "time.sleep(0.5); os.kill(int(found[0].name.split('_')[1]), signal.SIGKILL)"
    killer = subprocess.Popen([sys.executable, "-c", code, str(marks)])
    words = [
        "run",
        f"model={tmp_path}/slow.py:Slow",
        f"model.marks={marks}",
        *SMALL,
        f"cluster={place}",
    ]
    assert main(words) == 0 and killer.wait() == 0
    assert "4/4" in capsys.readouterr().out
    folds = [path.name.split("_")[0] for path in marks.iterdir()]
    assert {*folds} == {*"1234"} and len(folds) > 4
    killed = {int(path.name.split("_")[1]) for path in marks.iterdir()}
    assert not all(map(psutil.pid_exists, killed))


def test_where_no_scheduler_answers_is_one_line(capsys):
    assert main(["run", *SMALL, f"cluster=tcp://127.0.0.1:{free_port()}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no scheduler answers" in line


def test_the_commands_of_the_compose_file_have_options_that_exist_and_addresses_of_one_another():
    """That they work together is tested above and in tests/commands/test_server.py."""
    from distributed.cli import dask_scheduler, dask_worker
    from mlflow.cli import cli

    known = {
        "server": cli.commands["server"],
        "scheduler": dask_scheduler.main,
        "worker": dask_worker.main,
    }
    services = yaml.safe_load((ROOT / "docs" / "compose" / "compose.yaml").read_text())["services"]
    params = {}
    for name in ("mlflow", "scheduler", "first", "second"):
        _, command, *words = services[name]["command"]
        params[name] = known[command].make_context(command, words).params
    scheduler = f"tcp://scheduler:{params['scheduler']['port']}"
    assert params["first"]["scheduler"] == params["second"]["scheduler"] == scheduler
    place = f"mlflow:{params['mlflow']['port']}"
    assert services["bench"]["environment"]["MLFLOW_TRACKING_URI"] == f"http://{place}"
    assert (
        place in params["mlflow"]["allowed_hosts"]
        and "@database:5432/mlflow" in params["mlflow"]["backend_store_uri"]
    )
