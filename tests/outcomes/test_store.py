"""The store when it is locked, of another version or gone; kills and full disks are in tests/nightly."""

import errno
import operator
import sqlite3
from pathlib import Path

import pytest

import bench
from bench.cli import main
from bench.errors import StoreError
from bench.outcomes import store
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


def test_a_store_that_can_only_be_read_is_read_and_left_alone(in_net, tmp_path, monkeypatch, capsys):
    """As a folder without rights, which does not stop a superuser: nothing can be made beside the file."""
    on = ["data=people", "where=all", "target=gesture", "protocol=loso"]

    def read():
        texts = []
        for words in (["choose", *on], ["choose", "groups=yes", *on], ["report", f"out={tmp_path}/report"]):
            texts.append((main(words), capsys.readouterr()))
        table = bench.runs(data="people", protocol="loso", where="all")
        return (
            texts,
            table,
            bench.compare(*table["system"].unique()[:2], data="people", protocol="loso", where="all").difference,
        )

    def refused(**_):
        raise OSError(errno.EROFS, "Read-only file system")

    texts, table, p = read()
    Path("mlflow.db.lock").unlink()
    files = lambda: {p: p.stat().st_mtime_ns for p in [*Path().glob("*.db*"), *Path("mlruns").rglob("*")]}  # noqa: E731
    before = files()
    monkeypatch.setattr(store.tempfile, "TemporaryFile", refused)
    again = read()
    assert again[0] == texts and again[1].equals(table) and again[2] == p
    assert files() == before
    with pytest.raises(StoreError, match="readonly"):
        store.connect().create("x", {})
    assert main(SMALL) == 2 and "mlflow.db cannot be written (Read-only" in capsys.readouterr().err
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/none.db")
    assert main(["choose"]) == 2 and "none.db cannot be read (Read-only" in capsys.readouterr().err


def dump():
    with sqlite3.connect("mlflow.db") as db:
        return list(db.iterdump())


def test_a_locked_file_is_waited_for_and_what_stays_locked_is_one_line(monkeypatch):
    pauses = []
    monkeypatch.setattr(store.time, "sleep", pauses.append)
    answers = [OSError("database is locked"), OSError("database is locked"), "done"]

    @store.patient
    def work():
        answer = answers.pop(0)
        if isinstance(answer, OSError):
            raise answer
        return answer

    assert work() == "done" and len(pauses) == 2
    answers[:] = [OSError("disk full\nmore"), "done"]
    with pytest.raises(StoreError, match="disk full; stored results are kept"):
        work()
    monkeypatch.setattr(store, "PATIENCE", 0.0)
    answers[:] = [OSError("database is locked"), "done"]
    with pytest.raises(StoreError, match="database is locked"):
        work()
    assert len(pauses) == 2


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


def test_runs_come_in_pages_newest_first_and_only_of_this_format(monkeypatch):
    connected = store.connect()
    ids = [connected.create(str(i), {"touchbench.kind": "cell", "touchbench.cell": str(i)}) for i in range(5)]
    connected.client.set_tag(ids[0], "touchbench.format", "0")
    search = type(connected.client).search_runs
    monkeypatch.setattr(
        type(connected.client), "search_runs", lambda *a, **how: search(*a, **(how | {"max_results": 2}))
    )
    connected.file = None
    assert {run.info.run_id for run in connected.of_kind("cell")} == {*ids[1:]}
    assert connected.find("4", "cell").info.run_id == ids[4] and connected.find("0", "cell") is None


def contents(runs):
    """All that runs hold, in order, as text, in which what is no number equals itself."""
    fields = operator.attrgetter("run_id", "status", "start_time", "artifact_uri", "run_name")
    values = operator.attrgetter("metrics", "params", "tags")
    return [repr((fields(run.info), [sorted(v.items()) for v in values(run.data)])) for run in runs]


@pytest.mark.parametrize("unreadable", ["no file", "cut off", "locked"])
def test_a_file_is_read_as_mlflow_reads_it_and_by_mlflow_where_that_fails(unreadable, tmp_path, monkeypatch):
    connected = store.connect()
    for i in range(6):
        run_id = connected.create(str(i), {"touchbench.kind": ("stream", "cell", "else")[i % 3], "x": "a\nb"})
        connected.log(run_id, {"accuracy": i / 7, "cost": float("nan")}, {"C": 8.0}, [{"loss": 2.0}, {"loss": 1.0}])
        connected.end(run_id, "FINISHED") if i > 2 else None
    connected.create("of another version", {"touchbench.kind": "cell"})
    connected.client.set_tag(connected.runs("")[0].info.run_id, "touchbench.format", "0")
    connected.delete(connected.create("gone", {"touchbench.kind": "cell"}))
    elsewhere = connected.client.create_experiment("another")
    connected.client.create_run(elsewhere, tags={"touchbench.kind": "cell", "touchbench.format": store.FORMAT})
    kinds = ("cell", "no run", "stream")
    asked = []
    by_mlflow = type(connected).runs
    monkeypatch.setattr(type(connected), "runs", lambda self, *a: asked.append(a) or by_mlflow(self, *a))
    read = contents(connected.of_kind(*kinds))
    assert not asked and len(read) == 4 and "nan" in read[0]
    file, connected.file = connected.file, None
    expected = contents(connected.of_kind(*kinds))
    assert len(asked) == 3 and read == expected
    connected.file = tmp_path / "other.db"
    if unreadable == "cut off":
        connected.file.write_bytes(file.read_bytes()[:8192])
    if unreadable == "locked":
        connected.file.write_bytes(file.read_bytes())
        monkeypatch.setattr(store, "LOCKED_S", 0.01)
        holder = sqlite3.connect(connected.file, isolation_level=None)
        holder.execute("begin exclusive")
    assert contents(connected.of_kind(*kinds)) == expected and len(asked) == 6


def test_numbers_by_the_thousand_and_by_epoch_and_files_are_kept(tmp_path):
    connected = store.connect()
    run_id = connected.create("x", {})
    history = [{"loss": 1 / (i + 1)} for i in range(1200)]
    connected.log(run_id, {"accuracy": 0.5}, {"C": 8.0}, history, {"a": "b"})
    stored = connected.client.get_metric_history(run_id, "loss")
    assert sorted((m.step, m.value) for m in stored if m.step) == [(i + 1, 1 / (i + 1)) for i in range(1200)]
    data = connected.run(run_id).data
    assert (data.metrics["accuracy"], data.params, data.tags["a"]) == (0.5, {"C": "8.0"}, "b")
    (tmp_path / "a.csv").write_text("1")
    connected.keep(run_id, tmp_path / "a.csv", "fold")
    artifacts = connected.run(run_id).info.artifact_uri
    assert connected.path(run_id, artifacts, "fold/a.csv").read_text() == "1"
    assert connected.path(run_id, artifacts, "b.csv") is None


def all_of(connected, run):
    """What MLflow has of a run that does not tell two equal ones apart."""
    names = [*run.data.metrics, "none"]
    history = [connected.client.get_metric_history(run.info.run_id, name) for name in names]
    points = sorted(repr((m.key, m.value, m.step)) for metrics in history for m in metrics)
    info = (run.info.run_name, run.info.status, run.info.lifecycle_stage, run.info.end_time >= run.info.start_time)
    files = (Path(run.info.artifact_uri) / "fold" / "a.csv").read_text()
    return info, repr(sorted(run.data.metrics.items())), run.data.params, run.data.tags, points, files


@pytest.mark.parametrize("locked", [False, True])
def test_a_fold_is_stored_as_mlflow_stores_it_and_by_mlflow_where_that_fails(locked, tmp_path, monkeypatch):
    connected, create = store.connect(), store.Store.create
    (folder := tmp_path / "folder").mkdir()
    (folder / "a.csv").write_text("1")
    numbers = {"accuracy": 1 / 3, "gone": float("nan"), "most": float("inf")}
    epochs = [{"loss": 2.0}, {"loss": 1.0, "accuracy": 0.5}]
    given = ({"touchbench.kind": "fold", "b": "c"}, "FINISHED", folder, "fold", numbers, {"C": 8.0}, epochs)
    asked = []
    holder = sqlite3.connect(connected.file, isolation_level=None)
    assert connected.location
    if locked:
        monkeypatch.setattr(store, "LOCKED_S", 0.01)
        holder.execute("begin exclusive")
    monkeypatch.setattr(store.Store, "create", lambda *a: asked.append(holder.rollback()) or create(*a))
    first = connected.add("7", *given)
    assert len(asked) == locked
    connected.file = None
    second = connected.add("7", *given)
    runs = {run.info.artifact_uri: run for run in connected.runs("")}
    assert len(asked) == 1 + locked and {*runs} == {first, second}
    assert all_of(connected, runs[first]) == all_of(connected, runs[second])


def test_what_mlflow_refuses_of_a_fold_is_refused(tmp_path):
    with pytest.raises(store.StoreError, match="supplied: Names may only"):
        store.connect().add("7", {}, "FINISHED", tmp_path / "none", "fold", params={"#": 1})
