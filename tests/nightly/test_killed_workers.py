"""Processes of this machine that are killed: a worker, the command with its workers, and Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from joblib.externals.loky import get_reusable_executor

from bench.cli import main
from bench.store.client import connect
from tests.conftest import BENCH, predictions, runs

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.live,
    pytest.mark.pool,
    pytest.mark.skipif(sys.platform == "win32", reason="signals"),
]
PATIENCE = 300  # seconds on a busy machine
SMALL = ["data.subjects=4", "data.variants=normal", "jobs=2"]


def until(true, seconds=PATIENCE):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.1)


def test_a_fold_that_kills_its_worker_is_recorded_and_the_others_go_on(plug, capsys):
    """The system is of an installed package; new workers know it by its entry point only."""
    plug("[touchbench.models]\nwayward = tests.running.wayward:Wayward\n", "", "empty")
    get_reusable_executor().shutdown(kill_workers=True)
    assert main(["run", "model=wayward", "model.die=3", *SMALL]) == 1
    get_reusable_executor().shutdown(kill_workers=True)
    captured = capsys.readouterr()
    last = captured.err.splitlines()[-1]
    assert "3/4" in captured.out
    assert (
        "fold 3" in last and "died" in Path(last.split("traceback of the first: ")[1]).read_text()
    )
    store, (parent,) = runs("cell")
    assert parent.info.status == "FAILED" and parent.data.metrics["accuracy"] == pytest.approx(
        1 / 14
    )
    folds = predictions(store, parent, "folds").set_index("fold")["status"]
    assert dict(folds) == dict.fromkeys("124", "FINISHED") | {"3": "FAILED"}


@pytest.mark.real_store
def test_control_c_keeps_the_finished_folds():
    command = [*BENCH, "run", "model=rf", "model.trees=500", "data.subjects=12", "jobs=1"]
    pipes = {"stderr": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, start_new_session=True, **pipes)
    connect()
    stored = lambda: {*Path("mlruns").glob("*/*/artifacts/folds/*.zip")}  # noqa: E731
    until(lambda: len(stored()) >= 2)
    before = stored()
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=PATIENCE)
    assert (
        process.returncode == 130
        and "Traceback" not in error
        and error.splitlines()[-1].startswith("bench: ")
    )
    assert before <= stored() and len(stored()) < 12 and runs("cell")[1][0].info.status == "KILLED"


@pytest.mark.real_store
def test_stores_created_by_several_processes_at_once_are_whole():
    code = "from bench.store.client import connect; print(connect().experiment_id)"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    started = [subprocess.Popen([sys.executable, "-c", code], **pipes) for _ in range(3)]
    ids = {process.communicate(timeout=PATIENCE)[0].split()[-1] for process in started}
    assert len(ids) == 1 and all(process.returncode == 0 for process in started)
