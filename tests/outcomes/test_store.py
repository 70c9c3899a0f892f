"""The store when it is killed, full, locked, of another version or gone."""

import resource
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from bench.cli import main
from bench.errors import InputError, StoreError
from bench.outcomes import store
from bench.scratch import owner
from tests.conftest import BENCH, predictions, runs
from tests.test_scratch import dead_process

SMALL = ["run", "data.subjects=3", "data.variants=normal", "model=bayes", "features=jung28"]


def started(folder, *command, **how):
    return subprocess.run([*BENCH, *command], cwd=folder, capture_output=True, text=True, timeout=600, **how)


@pytest.mark.real_store
@pytest.mark.live
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


def test_what_a_killed_creation_left_is_removed(tmp_path):
    left = tmp_path / f".mlflow.db.{owner().rsplit('-', 2)[0]}-{dead_process()}-abc"
    left.mkdir()
    (left / "mlflow.db").write_text("half")
    store.connect()
    assert not left.exists()


def test_an_empty_file_is_no_broken_store(tmp_path):
    (tmp_path / "mlflow.db").touch()
    assert store.connect().of_kind("cell") == []


@pytest.mark.real_store
@pytest.mark.parametrize(
    "harm",
    [
        "update alembic_version set version_num = 'ffffffffffff'",
        "delete from alembic_version",
    ],
)
def test_a_store_of_another_version_or_a_broken_one_is_refused_in_one_line(harm, tmp_path, capsys, empty_store):
    (tmp_path / "mlflow.db").write_bytes(empty_store.read_bytes())
    with sqlite3.connect("mlflow.db") as db:
        db.execute(harm)
    before = dump()
    assert main(SMALL) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("bench: MLflow store sqlite") and len(said) < 400, said
    assert dump() == before


def dump():
    with sqlite3.connect("mlflow.db") as db:
        return list(db.iterdump())


def test_work_goes_on_once_another_program_lets_the_file_go(tmp_path):
    connected = store.connect()
    other = sqlite3.connect("mlflow.db", check_same_thread=False)
    other.execute("begin exclusive")
    threading.Timer(8.0, other.rollback).start()  # longer than SQLite itself waits
    run_id = connected.create("x", {"touchbench.kind": "cell"})
    assert connected.run(run_id).data.tags["touchbench.kind"] == "cell"
    other.close()


def test_a_file_that_stays_locked_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "PATIENCE", 0.0)
    connected = store.connect()
    other = sqlite3.connect("mlflow.db")
    other.execute("begin exclusive")
    with pytest.raises(StoreError, match="database is locked.*repeat the command"):
        connected.create("x", {})
    other.close()


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_100_000, 1_100_000))


@pytest.mark.pool
@pytest.mark.live
def test_a_full_disk_in_the_middle_of_a_run_loses_nothing(tmp_path):
    """A limit on the size of a file, which is just above that of an empty store, stands for the disk."""
    reference, full = tmp_path / "reference", tmp_path / "full"
    command = ["run", "data.subjects=24", *SMALL[2:]]
    for folder in (reference, full):
        folder.mkdir()
    assert started(reference, *command).returncode == 0
    said = started(full, *command, preexec_fn=limited)
    assert said.returncode == 1, said.stderr
    assert "repeat the command" in said.stderr and "Traceback" not in said.stderr
    assert started(full, *command).returncode == 0
    assert table(reference).equals(table(full))


@pytest.mark.pool
@pytest.mark.live
def test_a_small_disk_that_fills_up_loses_nothing(tmp_path):
    disk, reference = tmp_path / "disk", tmp_path / "reference"
    for folder in (disk, reference):
        folder.mkdir()
    command = ["run", "data.subjects=24", *SMALL[2:]]
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1400k", "tmpfs", disk], capture_output=True)
    if mounted.returncode:
        pytest.skip("this system lets nobody mount a small disk here")
    try:
        said = started(disk, *command)
        assert said.returncode == 1, said.stderr
        assert "Traceback" not in said.stderr and len(said.stderr.strip().splitlines()[-1]) < 400
        subprocess.run(["mount", "-o", "remount,size=100m", disk], check=True)
        assert started(disk, *command).returncode == 0
        assert started(reference, *command).returncode == 0
        assert table(reference).equals(table(disk))
    finally:
        subprocess.run(["umount", disk], check=True)


def table(folder):
    import os

    here = Path.cwd()
    os.chdir(folder)
    try:
        connected, (run,) = runs("cell")
        return predictions(connected, run)
    finally:
        os.chdir(here)


def test_an_artifact_that_is_not_there_is_none_and_a_server_that_is_gone_is_an_error(monkeypatch):
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    connected = store.connect()
    run_id = connected.create("x", {})
    assert connected.path(run_id, "mlflow-artifacts:/x", "nothing.csv") is None

    def gone(*_):
        raise MlflowException("API request to http://127.0.0.1:1/ failed with exception HTTPConnectionPool: refused")

    monkeypatch.setattr(MlflowClient, "download_artifacts", gone)
    with pytest.raises(StoreError, match="API request"):
        connected.path(run_id, "mlflow-artifacts:/x", "nothing.csv")


def test_an_address_where_nobody_answers_is_refused(monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:1")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with pytest.raises(InputError, match="127.0.0.1:1 cannot be used"):
        store.connect()


@pytest.mark.parametrize(
    ("uri", "told"),
    [
        ("postgresql+nodriver://me:secret@127.0.0.1:9/x", "nodriver://me:***@127.0.0.1:9/x cannot be used"),
        ("http://me:secret@127.0.0.1:9", "http://me:***@127.0.0.1:9 cannot be used"),
    ],
)
def test_an_address_that_cannot_be_opened_is_one_line_without_its_password(uri, told, monkeypatch, capsys):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    monkeypatch.setitem(sys.modules, "psycopg", None)  # a driver that is not installed
    assert main(["report"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line and "secret" not in line


@pytest.mark.parametrize(
    "error",
    [ModuleNotFoundError("No module named 'psycopg'"), UnicodeEncodeError("utf-8", "\udcff", 0, 1, "no text")],
    ids=["a driver that is not installed", "a name that is no text"],
)
def test_what_else_keeps_a_store_from_opening_is_one_line(error, monkeypatch, capsys):
    def create(_):
        raise error

    monkeypatch.setattr(store, "create", create)
    assert main(["report"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot be used: " in line and line.endswith(str(error)[-20:])
