"""The store when it is locked, of another version or gone; kills and full disks are in tests/nightly."""

import errno
import shutil
import sqlite3
from pathlib import Path

import pytest
import sqlalchemy
from alembic import command
from alembic.config import Config
from mlflow import MlflowClient
from mlflow.store import db_migrations

import bench
from bench import database, store
from bench.cli import main
from bench.errors import StoreError
from bench.scratch import owner

SMALL = ["run", "data.subjects=3", "data.variants=normal", "model=bayes", "features=jung28"]


def test_what_a_killed_creation_left_is_removed(tmp_path, dead):
    left = tmp_path / f".mlflow.db.{owner().rsplit('-', 2)[0]}-{dead}-abc"
    left.mkdir()
    (left / "mlflow.db").write_text("half")
    store.connect()
    assert not left.exists()


def test_an_empty_file_is_no_broken_store(tmp_path):
    (tmp_path / "mlflow.db").touch()
    assert store.connect().of_kind("cell") == []


@pytest.mark.real_store
@pytest.mark.parametrize(
    ("harm", "fact"),
    [
        ("update alembic_version set version_num = 'ffffffffffff'", "its schema is ffffffffffff, this MLflow expects"),
        ("delete from alembic_version", "its schema is None"),
    ],
)
def test_a_store_of_another_version_or_a_broken_one_is_refused_in_one_line(harm, fact, tmp_path, capsys, empty_store):
    (tmp_path / "mlflow.db").write_bytes(empty_store.read_bytes())
    with sqlite3.connect("mlflow.db") as db:
        db.execute(harm)
    before = dump()
    assert main(SMALL) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("bench: MLflow store sqlite") and len(said) < 400 and fact in said, said
    assert dump() == before


@pytest.mark.parametrize("name", ["run #1", "what?", pytest.param("a%20b", marks=pytest.mark.real_store)])
def test_a_store_lies_in_its_folder_whatever_its_name_is_and_wherever_it_is_moved(name, tmp_path, monkeypatch):
    (first := tmp_path / name).mkdir()
    monkeypatch.chdir(first)
    (tmp_path / "note.txt").write_text("kept")
    here = store.connect()
    run = here.create("first", {"touchbench.kind": "cell"})
    here.keep(run.info.run_id, tmp_path / "note.txt")
    shutil.copytree(first, copy := tmp_path / "copy")
    before = sorted(first.rglob("*"))
    monkeypatch.chdir(copy)
    there = store.connect()
    (again,) = there.of_kind("cell")
    assert there.path(again.info.run_id, again.info.artifact_uri, "note.txt").resolve().is_relative_to(copy)
    there.keep(there.create("second", {"touchbench.kind": "cell"}).info.run_id, tmp_path / "note.txt")
    assert len([*copy.glob("mlruns/*/*/artifacts/note.txt")]) == 2
    assert [file.path for file in MlflowClient(store.store_uri()).list_artifacts(run.info.run_id)] == ["note.txt"]
    assert sorted(first.rglob("*")) == before
    assert {path.name for path in tmp_path.iterdir()} <= {name, "copy", "note.txt", "home"}


def test_a_deleted_experiment_is_named_with_the_way_back(capsys):
    here = store.connect()
    here.client.delete_experiment(here.experiment_id)
    for words in (SMALL, ["choose"]):
        assert main(words) == 2
        assert "mlflow experiments restore -x 1" in capsys.readouterr().err


@pytest.mark.real_store
def test_a_store_of_an_older_mlflow_is_upgraded_beside_a_copy(capsys, empty_store):
    shutil.copy(empty_store, "mlflow.db")
    config = Config()
    config.set_main_option("script_location", str(Path(db_migrations.__file__).parent))
    config.set_main_option("sqlalchemy.url", "sqlite:///mlflow.db")
    older, newest = revision("mlflow.db", lambda: command.downgrade(config, "-1"))
    store.connect()
    assert f"mlflow.db.{older}" in capsys.readouterr().err
    assert revision("mlflow.db")[0] == newest and revision(f"mlflow.db.{older}")[0] == older


def revision(path, change=lambda: None):
    """The schema of a file after a change, and before it."""
    found = []
    for work in (lambda: None, change):
        work()
        with sqlite3.connect(path) as db:
            found += db.execute("select version_num from alembic_version").fetchone()
    return found[1], found[0]


def test_a_store_that_can_only_be_read_is_read_and_left_alone(in_net, tmp_path, monkeypatch, capsys):
    """As a folder without rights, which does not stop a superuser: nothing can be made beside the file."""

    def read():
        words = ["choose", "data=people", "where=all", "target=gesture", "protocol=loso"]
        return main(words), capsys.readouterr(), bench.runs(data="people", protocol="loso", where="all")

    def refused(**_):
        raise OSError(errno.EROFS, "Read-only file system")

    code, said, table = read()
    Path("mlflow.db.lock").unlink()
    files = lambda: {p: p.stat().st_mtime_ns for p in [*Path().glob("*.db*"), *Path("mlruns").rglob("*")]}  # noqa: E731
    before = files()
    monkeypatch.setattr(database.tempfile, "TemporaryFile", refused)
    again = read()
    assert again[:2] == (code, said) and again[2].equals(table) and files() == before
    with pytest.raises(StoreError, match="readonly"):
        store.connect().create("x", {})
    assert main(SMALL) == 2 and "mlflow.db cannot be written (Read-only" in capsys.readouterr().err
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/none.db")
    assert main(["choose"]) == 2 and "none.db cannot be read (Read-only" in capsys.readouterr().err


def dump():
    with sqlite3.connect("mlflow.db") as db:
        return list(db.iterdump())


def test_an_artifact_that_is_not_there_is_none_and_a_server_that_is_gone_is_an_error(monkeypatch):
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    connected = store.connect()
    run_id = connected.create("x", {}).info.run_id
    assert connected.path(run_id, "mlflow-artifacts:/x", "nothing.csv") is None

    def gone(*_):
        raise MlflowException("API request to http://127.0.0.1:1/ failed with exception HTTPConnectionPool: refused")

    monkeypatch.setattr(MlflowClient, "download_artifacts", gone)
    with pytest.raises(StoreError, match="API request"):
        connected.path(run_id, "mlflow-artifacts:/x", "nothing.csv")


@pytest.mark.parametrize(
    ("uri", "fact"),
    [
        ("postgresql+nodriver://me:secret@127.0.0.1:9/x", "nodriver://me:***@127.0.0.1:9/x cannot be used"),
        ("http://me:secret@127.0.0.1:9", "http://me:***@127.0.0.1:9 cannot be used"),
    ],
)
def test_an_address_that_cannot_be_opened_is_one_line_without_its_password(uri, fact, monkeypatch, capsys):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    assert main(["choose"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert fact in line and "secret" not in line


def test_what_stays_locked_is_one_line(capsys, monkeypatch):
    """MLflow waits for 20 seconds; here it is told to wait for none."""
    connected = store.connect()
    run_id = connected.create("x", {}).info.run_id
    holder = sqlite3.connect("mlflow.db", isolation_level=None)
    holder.execute("begin exclusive")
    with monkeypatch.context() as patch:
        patch.setattr("sqlalchemy.sql.text", lambda text, real=sqlalchemy.sql.text: real(text.replace("20000", "1")))
        with pytest.raises(StoreError, match="database is locked.*stored results are kept"):
            connected.log(run_id, {"accuracy": 0.5})
    holder.rollback()
    connected.log(run_id, {"accuracy": 0.5})


def test_runs_come_in_pages_newest_first_and_only_of_this_format_and_kind(monkeypatch):
    connected = store.connect()
    made = [connected.create(str(i), {"touchbench.kind": "cell", "touchbench.cell": str(i)}) for i in range(5)]
    ids = [run.info.run_id for run in made]
    connected.client.set_tag(ids[0], "touchbench.format", "0")
    connected.create("another", {"touchbench.kind": "fit"})
    connected.delete(connected.create("gone", {"touchbench.kind": "cell"}).info.run_id)
    elsewhere = connected.client.create_experiment("another")
    connected.client.create_run(elsewhere, tags={"touchbench.kind": "cell", "touchbench.format": store.FORMAT})
    monkeypatch.setattr(store, "PAGE", 2)
    newest_first = sorted(ids[1:], key=lambda i: (-connected.client.get_run(i).info.start_time, i))
    assert [run.info.run_id for run in connected.of_kind("cell")] == newest_first
    assert connected.find("4", "cell").info.run_id == ids[4] and connected.find("0", "cell") is None


def test_numbers_parameters_tags_and_files_are_kept(tmp_path):
    connected = store.connect()
    run = connected.create("x", {"touchbench.kind": "cell"}, {"C": 8.0})
    run_id, artifacts = run.info.run_id, run.info.artifact_uri
    connected.log(run_id, {"accuracy": 0.5, "gone": float("nan")}, tags={"a": "b"})
    for step in range(3):
        connected.log(run_id, {"fold/accuracy": 1 / (step + 1)}, step=step)
    steps = connected.client.get_metric_history(run_id, "fold/accuracy")
    assert [(m.step, m.value) for m in steps] == [(0, 1), (1, 1 / 2), (2, 1 / 3)]
    result = connected.result(connected.client.get_run(run_id))
    assert (result["accuracy"], result["C"], result["a"]) == (0.5, "8.0", "b") and result["gone"] != result["gone"]
    assert "fold/accuracy" not in result
    (tmp_path / "a.csv").write_text("1")
    connected.keep(run_id, tmp_path / "a.csv", "folds")
    assert connected.path(run_id, artifacts, "folds/a.csv").read_text() == "1"
    assert connected.names(run_id, artifacts, "folds") == ["a.csv"] and connected.names(run_id, artifacts) == ["folds"]
    assert connected.path(run_id, artifacts, "b.csv") is None
    connected.drop(artifacts, "folds")
    assert connected.names(run_id, artifacts) == []


def test_what_mlflow_refuses_is_one_line():
    with pytest.raises(store.StoreError, match="supplied: Names may only"):
        store.connect().create("7", {}, {"#": 1})
