"""The store when its creation is killed, while another program has its file, and when the disk is full."""

import contextlib
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench.outcomes import store
from tests.conftest import BENCH, predictions, runs

pytestmark = pytest.mark.nightly
SMALL = ["model=bayes", "features=jung28", "data.variants=normal"]


def started(folder, *command, **how):
    return subprocess.run([*BENCH, *command], cwd=folder, capture_output=True, text=True, timeout=600, **how)


@pytest.mark.real_store
def test_a_kill_at_any_moment_of_its_creation_leaves_none_or_a_good_one(tmp_path):
    code = "from bench.outcomes.store import create; from pathlib import Path; import mlflow.store.db.utils; "
    code += "print('now', flush=True); create(Path('mlflow.db'))"
    begun = time.monotonic()
    subprocess.run([sys.executable, "-c", code.replace("mlflow.db'", "whole.db'")], check=True, capture_output=True)
    lasts = time.monotonic() - begun
    for share in (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9):
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as p:
            p.stdout.readline()
            time.sleep(share * lasts / 2)
            p.send_signal(signal.SIGKILL)
        assert store.connect().of_kind("cell") == []
        assert [q.name for q in Path().glob(".mlflow.db.*")] == []
        Path("mlflow.db").unlink()


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_100_000, 1_100_000))


@pytest.mark.pool
def test_a_full_disk_in_the_middle_of_a_run_loses_nothing(tmp_path):
    """A limit on the size of a file, which is just above that of an empty store, stands for the disk."""
    reference, full = tmp_path / "reference", tmp_path / "full"
    command = ["run", "data.subjects=24", *SMALL]
    for folder in (reference, full):
        folder.mkdir()
    assert started(reference, *command).returncode == 0
    said = started(full, *command, preexec_fn=limited)
    assert said.returncode == 1, said.stderr
    assert "repeat the command" in said.stderr and "Traceback" not in said.stderr
    assert started(full, *command).returncode == 0
    assert table(reference).equals(table(full))


def table(folder):
    with contextlib.chdir(folder):
        connected, (run,) = runs("cell")
        return predictions(connected, run)
