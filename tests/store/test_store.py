"""The store if locked, of another version or gone; kills and full disks: tests/nightly."""

import errno
import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import mlflow
import pytest
import sqlalchemy
from alembic import command
from alembic.config import Config
from mlflow import MlflowClient, MlflowException
from mlflow.store import db_migrations

import bench
from bench.cli import main
from bench.errors import StoreError
from bench.store import client as store
from bench.store import database
from tests.conftest import SMALL

RUN = ["run", *SMALL, "model=bayes", "features=jung28"]


def dump():
    with sqlite3.connect("mlflow.db") as db:
        return list(db.iterdump())


def test_what_a_killed_creation_left_is_removed_and_an_empty_file_is_no_store(tmp_path):
    left = tmp_path / ".touchbench-1-abc"
    left.mkdir()
    (left / "mlflow.db").write_text("half")
    (tmp_path / "mlflow.db").touch()
    assert store.connect().runs_of_kind("cell") == [] and not left.exists()


@pytest.mark.real_store
def test_a_store_of_another_version_is_refused_in_one_line(tmp_path, capsys, empty_store):
    (tmp_path / "mlflow.db").write_bytes(empty_store.read_bytes())
    for harm, schema in (
        ("update alembic_version set version_num = 'ffff'", "ffff"),
        ("delete from alembic_version", None),
    ):
        with sqlite3.connect("mlflow.db") as db:
            db.execute(harm)
        before = dump()
        assert main(RUN) == 2 and dump() == before
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("bench: MLflow store sqlite") and f"its schema is {schema}" in line


def test_what_is_no_store_is_refused_and_left_alone(tmp_path, monkeypatch, capsys):
    (tmp_path / "mlflow.db").write_text("this is a letter, not a database")
    assert main(RUN) == 2 and "mlflow.db" in capsys.readouterr().err
    assert (tmp_path / "mlflow.db").read_text() == "this is a letter, not a database"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/nowhere/mlflow.db")
    assert main(RUN) == 2 and "cannot be written" in capsys.readouterr().err
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "mlflow.db"))
    assert main(RUN) == 2
    assert "TOUCHBENCH_HOME" in (error := capsys.readouterr().err) and error.count("\n") == 1


@pytest.mark.parametrize("name", ["run #1?", pytest.param("a%20b", marks=pytest.mark.real_store)])
def test_a_store_lies_in_its_folder_whatever_its_name_is_and_wherever_it_is_moved(
    name, tmp_path, monkeypatch
):
    (first := tmp_path / name).mkdir()
    monkeypatch.chdir(first)
    (tmp_path / "note.txt").write_text("kept")
    here = store.connect()
    run = here.create_run("first", {"touchbench.kind": "cell"})
    here.log_artifact(run.info.artifact_uri, tmp_path / "note.txt")
    shutil.copytree(first, copy := tmp_path / "copy")
    before = sorted(first.rglob("*"))
    monkeypatch.chdir(copy)
    there = store.connect()
    (again,) = there.runs_of_kind("cell")
    assert (
        there.artifact_path(again.info.run_id, again.info.artifact_uri, "note.txt")
        .resolve()
        .is_relative_to(copy)
    )
    assert [
        file.path for file in MlflowClient(store.store_uri()).list_artifacts(run.info.run_id)
    ] == ["note.txt"]
    there.log_artifact(
        there.create_run("second", {"touchbench.kind": "cell"}).info.artifact_uri,
        tmp_path / "note.txt",
    )
    assert (
        len([*copy.glob("mlruns/*/*/artifacts/note.txt")]) == 2
        and sorted(first.rglob("*")) == before
    )
    assert {path.name for path in tmp_path.iterdir()} <= {name, "copy", "note.txt", "home"}


def test_a_deleted_experiment_is_named_with_the_way_back(capsys):
    here = store.connect()
    here.client.delete_experiment(here.experiment_id)
    for words in (RUN, ["choose"]):
        assert main(words) == 2
        assert "mlflow experiments restore -x 1" in capsys.readouterr().err


@pytest.mark.real_store
def test_a_store_of_an_older_mlflow_is_upgraded_beside_a_copy(capsys, empty_store):
    shutil.copy(empty_store, "mlflow.db")
    config, newest = Config(), schema("mlflow.db")
    config.set_main_option("script_location", str(Path(db_migrations.__file__).parent))
    config.set_main_option("sqlalchemy.url", "sqlite:///mlflow.db")
    command.downgrade(config, "-1")
    older = schema("mlflow.db")
    store.connect()
    assert f"mlflow.db.{older}" in capsys.readouterr().err
    assert schema("mlflow.db") == newest and schema(f"mlflow.db.{older}") == older != newest


def schema(path):
    with sqlite3.connect(path) as db:
        return db.execute("select version_num from alembic_version").fetchone()[0]


def test_a_store_that_can_only_be_read_is_read_and_left_alone(
    in_net, tmp_path, monkeypatch, capsys
):
    """Nothing can be made beside the file, as in a folder without rights, also by a superuser."""

    def read():
        return main(
            ["choose", "data=people", "where=all", "target=gesture", "protocol=loso"]
        ), capsys.readouterr()

    def refused(**_):
        raise OSError(errno.EROFS, "Read-only file system")

    before = read()
    Path("mlflow.db.lock").unlink()

    def files():
        paths = [*Path().glob("*.db*"), *Path("mlruns").rglob("*")]
        return {path: path.stat().st_mtime_ns for path in paths}

    found = files()
    monkeypatch.setattr(database.tempfile, "TemporaryFile", refused)
    assert read() == before and len(bench.runs(data="people")) and files() == found
    with pytest.raises(StoreError, match="readonly"):
        store.connect().create_run("x", {})
    assert main(RUN) == 2 and "mlflow.db cannot be written (Read-only" in capsys.readouterr().err
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/none.db")
    assert main(["choose"]) == 2 and "none.db cannot be read (Read-only" in capsys.readouterr().err


def test_an_artifact_that_is_not_there_is_none_and_a_server_that_is_gone_is_an_error(monkeypatch):
    connected = store.connect()
    run_id = connected.create_run("x", {}).info.run_id
    assert connected.artifact_path(run_id, "mlflow-artifacts:/x", "nothing.csv") is None

    def gone(*_):
        raise MlflowException(
            "API request to http://127.0.0.1:1/ failed with exception HTTPConnectionPool: refused"
        )

    monkeypatch.setattr(MlflowClient, "download_artifacts", gone)
    with pytest.raises(StoreError, match="API request"):
        connected.artifact_path(run_id, "mlflow-artifacts:/x", "nothing.csv")


@pytest.mark.parametrize(
    ("uri", "fact"),
    [
        (
            "postgresql+nodriver://me:secret@127.0.0.1:9/x",
            "nodriver://me:***@127.0.0.1:9/x cannot be used",
        ),
        ("http://me:secret@127.0.0.1:9", "http://me:***@127.0.0.1:9 cannot be used"),
    ],
)
def test_an_address_that_cannot_be_opened_is_one_line_without_its_password(
    uri, fact, monkeypatch, capsys
):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    assert main(["choose"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert fact in line and "secret" not in line


def test_what_stays_locked_is_one_line(capsys, monkeypatch):
    """MLflow waits for 20 seconds; here it is told to wait for none."""
    connected = store.connect()
    run_id = connected.create_run("x", {}).info.run_id
    holder = sqlite3.connect("mlflow.db", isolation_level=None)
    holder.execute("begin exclusive")
    with monkeypatch.context() as patch:
        patch.setattr(
            "sqlalchemy.sql.text",
            lambda text, real=sqlalchemy.sql.text: real(text.replace("20000", "1")),
        )
        with pytest.raises(
            StoreError, match="another program holds .*repeat the command; stored results are kept"
        ):
            connected.log_values(run_id, {"accuracy": 0.5})
    holder.rollback()
    connected.log_values(run_id, {"accuracy": 0.5})


@pytest.mark.parametrize("command", ["choose", "runs", "report", "run"])
def test_a_damaged_or_held_file_is_one_line(command, tmp_path, capsys):
    store.connect()
    whole = Path("mlflow.db").read_bytes()
    arguments = RUN if command == "run" else [command]
    for size in (len(whole) // 3, len(whole) // 2, 5000, 600):
        Path("mlflow.db").write_bytes(whole[:size])
        assert main(arguments) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "is damaged" in line and "restore a copy, or move it away" in line
        assert Path("mlflow.db").stat().st_size == size


def test_a_held_file_is_named(capsys):
    store.connect()
    with closing(sqlite3.connect("mlflow.db", isolation_level=None)) as holder:
        holder.execute("begin exclusive")
        assert main(["choose"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "another program holds" in line and line.endswith("mlflow.db; repeat the command")


def test_reading_needs_no_lock_and_one_of_another_user_is_named(capsys, monkeypatch):
    store.connect()

    def refuse(self, *_, real=database.FileLock.acquire):
        if self.lock_file.endswith("mlflow.db.lock"):
            raise PermissionError(errno.EACCES, "Permission denied", "mlflow.db.lock")
        return real(self)

    monkeypatch.setattr(database.FileLock, "acquire", refuse)
    assert main(["runs"]) == 2 and "no scored run is stored" in capsys.readouterr().err
    assert main(RUN) == 2
    (line,) = capsys.readouterr().err.splitlines()
    owner = Path("mlflow.db.lock").owner()
    assert "mlflow.db.lock" in line and f"a file of {owner}" in line and "make it writable" in line


@pytest.mark.parametrize("before", [None, "sqlite:///other.db"])
def test_the_store_of_a_fit_is_set_for_the_fit_alone(before, tmp_path, monkeypatch):
    """Otherwise a command in another folder would write into the former one."""
    monkeypatch.setenv("MLFLOW_TRACKING_URI", before or "")
    if before is None:
        monkeypatch.delenv("MLFLOW_TRACKING_URI")
    with store.use_tracking_uri():
        assert os.environ["MLFLOW_TRACKING_URI"] == mlflow.get_tracking_uri() == store.store_uri()
    assert os.environ.get("MLFLOW_TRACKING_URI") == before


def test_a_repeated_number_counts_by_its_step(monkeypatch):
    connected = store.connect()
    run_id = connected.create_run("x", {}).info.run_id
    for value, seconds in ((0.1, 2_000_000_000), (0.2, 1_000_000_000), (0.3, 1_500_000_000)):
        monkeypatch.setattr(store.time, "time", lambda seconds=seconds: seconds)
        connected.log_values(run_id, {"folds": value}, step=connected.next_step(run_id, "folds"))
        assert connected.client.get_run(run_id).data.metrics == {"folds": value}


def test_runs_come_in_pages_newest_first_and_only_of_this_format_and_kind(monkeypatch):
    connected = store.connect()
    made = [
        connected.create_run(str(i), {"touchbench.kind": "cell", "touchbench.cell": str(i)})
        for i in range(5)
    ]
    ids = [run.info.run_id for run in made]
    connected.client.set_tag(ids[0], "touchbench.format", "0")
    connected.create_run("another", {"touchbench.kind": "fit"})
    connected.delete_run(connected.create_run("gone", {"touchbench.kind": "cell"}).info.run_id)
    elsewhere = connected.client.create_experiment("another")
    connected.client.create_run(
        elsewhere, tags={"touchbench.kind": "cell", "touchbench.format": store.FORMAT}
    )
    monkeypatch.setattr(store, "RUNS_PER_REQUEST", 2)
    newest_first = sorted(ids[1:], key=lambda i: (-connected.client.get_run(i).info.start_time, i))
    assert [run.info.run_id for run in connected.runs_of_kind("cell")] == newest_first
    assert (
        connected.find_run("4", "cell").info.run_id == ids[4]
        and connected.find_run("0", "cell") is None
    )


def test_steps_and_files_of_runs_are_kept_and_dropped(tmp_path):
    """How a whole result is read back is in tests/reading/test_runs.py."""
    connected = store.connect()
    run = connected.create_run("x", {"touchbench.kind": "cell"}).info
    for step in range(3):
        connected.log_values(
            run.run_id, {"fold/accuracy": 1 / (step + 1), "gone": float("nan")}, step=step
        )
    steps = connected.client.get_metric_history(run.run_id, "fold/accuracy")
    assert [(m.step, m.value) for m in steps] == [(0, 1), (1, 1 / 2), (2, 1 / 3)]
    result = connected.load_result(connected.client.get_run(run.run_id))
    assert result["gone"] != result["gone"] and "fold/accuracy" not in result
    (tmp_path / "a.csv").write_text("1")
    connected.log_artifact(run.artifact_uri, tmp_path / "a.csv", "folds")
    assert connected.artifact_path(run.run_id, run.artifact_uri, "folds/a.csv").read_text() == "1"
    assert connected.artifact_names(run.run_id, run.artifact_uri, "folds") == ["a.csv"]
    connected.delete_artifact(run.artifact_uri, "folds")
    assert connected.artifact_names(run.run_id, run.artifact_uri) == []
    with pytest.raises(store.StoreError, match="supplied: Names may only"):
        connected.create_run("7", {}, {"#": 1})
