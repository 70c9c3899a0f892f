"""The one module that queries MLflow: runs found, written and read. Only the main process uses it.

Tags by which runs are found again: ``touchbench.kind`` (of a parent run ``cell``, ``stream``, ``stress`` or ``fit``,
of a fold ``fold`` or the parent's with ``_fold``), ``touchbench.cell`` (the key of the run), ``touchbench.fold``.
``touchbench.format`` says how a run is stored.
"""

from __future__ import annotations

import json
import logging
import math
import os
import re
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from functools import cached_property, wraps
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, NamedTuple, ParamSpec, TypeVar
from urllib.parse import unquote, urlparse
from uuid import uuid4

from filelock import FileLock, Timeout

from bench.errors import InputError, StoreError
from bench.progress import warn
from bench.scratch import home, owner, sweep

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run

EXPERIMENT = "touchbench"
TABLE = "experiments"  # in MLflow's file
FORMAT = "2"  # version of stored runs; others are left out
PATIENCE = 60.0  # seconds that another program may lock MLflow's file
LOCKED_S = 5.0  # that a read of the file waits before MLflow is asked, which waits longer
RETRIES = "5"  # of a request to a server: they wait 0, 4, 8, 16 and 32 seconds
KEY = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_ .:-]{0,248}[A-Za-z0-9_])?")  # that MLflow takes as it is
LONGEST = 6000  # letters of a value that MLflow takes
Given = ParamSpec("Given")
Result = TypeVar("Result")
Read = TypeVar("Read", "Run", "Stored")


class Info(NamedTuple):
    """What is used of MLflow's ``RunInfo``."""

    run_id: str
    status: str
    start_time: int
    artifact_uri: str
    run_name: str


class Data(NamedTuple):
    """What is used of MLflow's ``RunData``."""

    metrics: dict[str, float]
    params: dict[str, str]
    tags: dict[str, str]


class Stored(NamedTuple):
    """A run as MLflow's ``Run`` has it, read without MLflow."""

    info: Info
    data: Data


def patient(work: Callable[Given, Result]) -> Callable[Given, Result]:
    """Wait while another program locks MLflow's file; a lasting failure raises `StoreError`."""

    @wraps(work)
    def done(*args: Given.args, **kwargs: Given.kwargs) -> Result:
        until = time.monotonic() + PATIENCE
        while True:
            try:
                with reached():
                    return work(*args, **kwargs)
            except StoreError as e:
                if "database is locked" not in str(e) or time.monotonic() > until:
                    raise
                time.sleep(0.5)

    return done


@contextmanager
def reached() -> Iterator[None]:
    """Report a failure of MLflow, its file, its server or the disk in one line.

    Raises:
        StoreError: instead of theirs.
    """
    try:
        yield
    except Exception as e:
        from mlflow.exceptions import MlflowException  # heavy, and a command that reads a file needs none of it
        from requests.exceptions import RequestException
        from sqlalchemy.exc import SQLAlchemyError

        if not isinstance(e, (MlflowException, RequestException, SQLAlchemyError, OSError)):
            raise
        raise StoreError(
            f"the MLflow store {_shown(store_uri())} failed: {_first_line(e)}; stored results are kept; repeat the "
            "command when the store works again"
        ) from e


def _first_line(error: BaseException) -> str:
    lines = [line for line in str(error).splitlines() if line.strip() and "Query-invoked autoflush" not in line]
    return (lines or [type(error).__name__])[0].strip()[-150:]  # what MLflow cites ends with the cause


def _shown(uri: str) -> str:
    """An address without its password, as messages end in logs."""
    return re.sub("(//[^/:@]*):[^/]*@", r"\1:***@", uri)


def store_uri() -> str:
    """Address of the store: ``MLFLOW_TRACKING_URI``, or MLflow's SQLite file in the working folder."""
    return os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{Path.cwd() / 'mlflow.db'}"


class Store:
    """Runs in MLflow, of touchbench's experiment.

    Args:
        experiment_id: id of the MLflow experiment.
        file: MLflow's SQLite file; None if the runs are kept in another way.
        client: client of the store; by default it is made when it is used, as importing MLflow takes a second.

    Raises:
        InputError: from whatever needs the client: the store cannot be used.
    """

    def __init__(self, experiment_id: str, file: Path | None, client: MlflowClient | None = None) -> None:
        self.experiment_id = experiment_id
        self.file = file
        self._client = client
        self._warned = False  # of runs of another format
        self._artifacts: dict[
            str, str
        ] = {}  # by id of a run that was made here and goes on, the address of its artifacts

    @property
    def client(self) -> MlflowClient:
        """Client of the store."""
        if self._client is None:
            self._client = _opened(self.file, writes=False)[0]
        return self._client

    @patient
    def runs(self, condition: str) -> list[Run]:
        """Every run that passes MLflow's filter, newest first; runs of other versions are left out."""
        stored: list[Run] = []
        page = None
        while page is None or page.token:
            token = page.token if page else None
            page = self.client.search_runs([self.experiment_id], condition, max_results=1000, page_token=token)
            stored += page
        return self._readable(stored)

    def _readable(self, stored: list[Read]) -> list[Read]:
        kept = [run for run in stored if run.data.tags.get("touchbench.format") == FORMAT]
        if len(kept) < len(stored) and not self._warned:
            self._warned = True
            warn("runs that another version of touchbench has stored are left out; run their commands again")
        return kept

    def of_kind(self, *kinds: str) -> Sequence[Run | Stored]:
        """Parent runs of one kind after the other, newest first, as `runs` has them.

        A SQLite file is read here: MLflow takes nine times as long. Where this fails, and of a server, MLflow is asked.
        """
        if self.file is not None:
            try:
                return self._readable(_runs_in(self.file, self.experiment_id, kinds))
            except sqlite3.Error:  # such as a locked file, for which MLflow waits, or other columns than today's
                pass
        return [run for kind in kinds for run in self.runs(f"tags.`touchbench.kind` = '{kind}'")]

    def find(self, key: str, kind: str) -> Run | None:
        """The parent run of a key and a kind, None where there is none."""
        return next(iter(self.runs(f"tags.`touchbench.cell` = '{key}' and tags.`touchbench.kind` = '{kind}'")), None)

    @patient
    def run(self, run_id: str) -> Run:
        """A run by its id."""
        return self.client.get_run(run_id)

    def folds(self, run_id: str) -> list[Run]:
        """The child runs of a run, newest first."""
        return self.runs(f"tags.`mlflow.parentRunId` = '{run_id}'")

    @patient
    def path(self, run_id: str, artifacts: str, name: str) -> Path | None:
        """A run's artifact as a local file: where it lies if the store is on this machine, else fetched.

        Args:
            run_id: id of the run.
            artifacts: their address.
            name: name of the artifact.

        Returns:
            None where the run has none of that name.
        """
        if (folder := _local(artifacts)) is not None:
            return folder / name if (folder / name).is_file() else None
        from mlflow.exceptions import MlflowException
        from requests.exceptions import ConnectionError as Unreachable

        try:
            return Path(self.client.download_artifacts(run_id, name))
        except (OSError, MlflowException) as e:
            if isinstance(e, Unreachable) or "API request to" in str(e):  # which says nothing of the artifact
                raise
            return None

    @patient
    def names(self, run_id: str, artifacts: str) -> list[str]:
        """Names of a run's artifacts, without those in folders, sorted.

        Args:
            run_id: id of the run.
            artifacts: their address.
        """
        if (folder := _local(artifacts)) is not None:
            return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
        return sorted(item.path for item in self.client.list_artifacts(run_id))

    @patient
    def fetched(self, run_id: str, name: str) -> Path:
        """An artifact, or a folder of them, that must be there, as local files."""
        return Path(self.client.download_artifacts(run_id, name))

    def artifacts(self, run_id: str) -> str:
        """Address of the artifacts of a run."""
        return self._artifacts.get(run_id) or self.run(run_id).info.artifact_uri

    def where(self, address: str, name: str) -> str:
        """Location of an artifact: its path if it is on this machine, else in words.

        Args:
            address: address of the artifacts of its run.
            name: name of the artifact.
        """
        folder = _local(address)
        return f"{name} of run {address.split('/')[-2]} in bench ui" if folder is None else str(folder / name)

    @patient
    def create(self, name: str, tags: dict[str, str]) -> str:
        """A new run; its id."""
        tags = tags | {"mlflow.runName": name, "touchbench.format": FORMAT}
        info = self.client.create_run(self.experiment_id, run_name=name, tags=tags).info
        self._artifacts[info.run_id] = info.artifact_uri
        return info.run_id

    def add(
        self,
        name: str,
        tags: dict[str, str],
        status: str,
        folder: Path,
        where: str,
        metrics: dict[str, float] | None = None,
        params: dict[str, object] | None = None,
        history: list[dict[str, float]] | None = None,
    ) -> str:
        """A run as a whole, with the files of a folder; the address of its artifacts.

        In MLflow's SQLite file it is one transaction after its files, so that a kill leaves no half of it; MLflow takes
        six, and four times as long. MLflow does it where there is no such file, or where the file or a name is unusual.
        """
        tags = tags | {"mlflow.runName": name, "touchbench.format": FORMAT}
        texts = {key: str(value) for key, value in (params or {}).items()}
        points = [*_points(metrics, history)]
        keys = [*tags, *texts, *(key for key, _, _ in points)]
        plain = all(map(KEY.fullmatch, keys)) and max(map(len, [*texts.values(), *tags.values()]), default=0) <= LONGEST
        if self.file is not None and plain:
            run_id = uuid4().hex
            address = f"{self.location}/{run_id}/artifacts"
            self._artifacts[run_id] = address
            try:
                self.keep(run_id, folder, where)
                _add_to(self.file, self.experiment_id, (run_id, name, status, address), tags, texts, points)
                return address
            except sqlite3.Error:  # such as a locked file, for which MLflow waits, or other columns than today's
                rmtree(_local(address) or "", ignore_errors=True)
            finally:
                del self._artifacts[run_id]
        run_id = self.create(name, tags)
        address = self._artifacts[run_id]
        if points or texts:
            self.log(run_id, metrics, params, history)
        self.keep(run_id, folder, where)
        self.end(run_id, status)
        return address

    @cached_property
    @patient
    def location(self) -> str:
        """Address below which the artifacts of all runs are."""
        return str(self.client.get_experiment(self.experiment_id).artifact_location)

    @patient
    def log(
        self,
        run_id: str,
        metrics: dict[str, float] | None = None,
        params: dict[str, object] | None = None,
        history: list[dict[str, float]] | None = None,
        tags: dict[str, str] | None = None,
    ) -> None:
        """Numbers, parameters, numbers by epoch and tags of a run."""
        from mlflow.entities import Metric, Param, RunTag

        now = int(time.time() * 1000)
        points = [Metric(key, value, now, step) for key, value, step in _points(metrics, history)]
        self.client.log_batch(
            run_id,
            points[:1000],
            [Param(k, str(v)) for k, v in (params or {}).items()],
            [RunTag(k, v) for k, v in (tags or {}).items()],
        )
        for i in range(1000, len(points), 1000):
            self.client.log_batch(run_id, points[i : i + 1000])

    @patient
    def log_captures(
        self, run_id: str, name: str, digest: str, source: str, captures: int, frames: int, context: str
    ) -> None:
        """The captures that a run saw (``context``: training, evaluation), as MLflow's dataset."""
        from mlflow.entities import Dataset, DatasetInput, InputTag
        from mlflow.exceptions import MlflowException

        profile = json.dumps({"num_rows": captures, "num_elements": frames})
        dataset = Dataset(name, digest[:36], "local", json.dumps({"uri": source}), profile=profile)
        inputs = [DatasetInput(dataset, [InputTag("mlflow.data.context", context)])]
        for pause in (0.2, 0.5, 1.0, 2.0, None):
            try:
                self.client.log_inputs(run_id, inputs)
                return
            except MlflowException:  # another run has made the same dataset at this moment; the next try finds it
                if pause is None:
                    raise
                time.sleep(pause)

    @patient
    def keep(self, run_id: str, path: Path, where: str = "") -> None:
        """Store a file, or the files of a folder, with a run."""
        from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

        # MLflow's client would ask its database each time where they belong
        artifacts = get_artifact_repository(self.artifacts(run_id))
        (artifacts.log_artifacts if path.is_dir() else artifacts.log_artifact)(str(path), where or None)

    @patient
    def drop(self, address: str, name: str) -> None:
        """Delete an artifact, where the place that keeps it can.

        Args:
            address: address of the artifacts of its run.
            name: name of the artifact.
        """
        from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

        with suppress(NotImplementedError):
            get_artifact_repository(address).delete_artifacts(name)

    @patient
    def keep_view(self, name: str, view: Mapping[str, object]) -> str:
        """Store a view of MLflow's page; return the query of its address.

        Args:
            name: name of the view.
            view: stored settings of MLflow's button *Share*: columns, widths, filter, order.
        """
        self.client.set_experiment_tag(self.experiment_id, f"mlflow.sharedViewState.{name}", json.dumps(view))
        return f"viewStateShareKey={name}"

    @patient
    def begin(self, run_id: str) -> None:
        """Mark a run that goes on."""
        self.client.update_run(run_id, status="RUNNING")

    @patient
    def end(self, run_id: str, status: str) -> None:
        """End a run: FINISHED, FAILED or KILLED."""
        self._artifacts.pop(run_id, None)
        self.client.set_terminated(run_id, status)

    @patient
    def delete(self, run_id: str) -> None:
        """Take a run out of all lists."""
        self.client.delete_run(run_id)


def _runs_in(file: Path, experiment_id: str, kinds: Sequence[str]) -> list[Stored]:
    """Parent runs of some kinds in MLflow's SQLite file, in the order of `Store.of_kind`, as of one moment."""
    marks = ", ".join("?" * len(kinds))
    of_kinds = f"from tags where key = 'touchbench.kind' and value in ({marks})"
    about = "r.run_uuid, status, start_time, artifact_uri, name"
    with closing(_read_only(file)) as db:
        db.execute("begin")
        rows = db.execute(
            f"select value, {about} from runs r join (select run_uuid, value {of_kinds}) k on r.run_uuid = k.run_uuid "
            "where experiment_id = ? and lifecycle_stage = 'active' order by start_time desc, r.run_uuid",
            (*kinds, int(experiment_id)),
        ).fetchall()
        data = {row[1]: Data({}, {}, {}) for row in rows}
        for values, query in (
            ("metrics", "case when is_nan then null else value end from latest_metrics"),
            ("params", "value from params"),
            ("tags", "value from tags"),
        ):
            for run_id, key, value in db.execute(
                f"select run_uuid, key, {query} where run_uuid in (select run_uuid {of_kinds})", kinds
            ):
                if run_id in data:
                    getattr(data[run_id], values)[key] = math.nan if value is None and values == "metrics" else value
    rows.sort(key=lambda row: kinds.index(row[0]))
    return [Stored(Info(*row[1:]), data[row[1]]) for row in rows]


def _read_only(file: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True, timeout=LOCKED_S)


def _points(
    metrics: Mapping[str, float] | None, history: Sequence[Mapping[str, float]] | None
) -> Iterator[tuple[str, float, int]]:
    """Numbers of a run, and those by epoch, with their step."""
    for step, row in enumerate([metrics or {}, *(history or [])]):
        for key, value in row.items():
            yield key, float(value), step


def _add_to(
    file: Path,
    experiment_id: str,
    run: tuple[str, str, str, str],
    tags: Mapping[str, str],
    params: Mapping[str, str],
    points: Sequence[tuple[str, float, int]],
) -> None:
    """Insert a run with all that belongs to it into MLflow's SQLite file, in one transaction.

    Args:
        file: the file.
        experiment_id: id of the MLflow experiment.
        run: its id, name, status, and the address of its artifacts.
        tags: its tags.
        params: its parameters.
        points: its numbers: key, value, step.

    Raises:
        sqlite3.Error: the file is locked, or has other tables; nothing is in it then.
    """
    run_id, name, status, address = run
    now, most = int(time.time() * 1000), sys.float_info.max
    rows = [
        (key, 0.0 if math.isnan(value) else min(max(value, -most), most), now, run_id, step, math.isnan(value))
        for key, value, step in points
    ]
    latest = {row[0]: row for row in rows}  # steps rise
    columns = "(key, value, timestamp, run_uuid, step, is_nan) values (?, ?, ?, ?, ?, ?)"
    with closing(sqlite3.connect(file, timeout=LOCKED_S)) as db, db:
        db.execute(
            "insert into runs (run_uuid, name, source_type, source_name, entry_point_name, user_id, status, "
            "start_time, end_time, source_version, lifecycle_stage, artifact_uri, experiment_id) "
            "values (?, ?, 'UNKNOWN', '', '', 'unknown', ?, ?, ?, '', 'active', ?, ?)",
            (run_id, name, status, now, now, address, int(experiment_id)),
        )
        for table, values in (("tags", tags), ("params", params)):
            db.executemany(
                f"insert into {table} (key, value, run_uuid) values (?, ?, ?)", [(*v, run_id) for v in values.items()]
            )
        db.executemany(f"insert into metrics {columns}", rows)
        db.executemany(f"insert into latest_metrics {columns}", [*latest.values()])


def _local(address: str) -> Path | None:
    """The folder of an address of artifacts, None if it is not on this machine."""
    uri = urlparse(address)
    if uri.scheme == "file":
        return Path(unquote(uri.path))
    return Path(address) if len(uri.scheme) <= 1 else None  # a drive letter is no scheme


def _file(uri: str) -> Path | None:
    return Path(urlparse(uri).path.removeprefix("/")) if uri.startswith("sqlite:///") else None


def exists() -> bool:
    """Return True if there is a store, or its server may have one; creates none."""
    path = _file(store_uri()) or _local(store_uri())
    return path is None or path.exists()


def connect(writes: bool = False) -> Store:
    """The store, which is created if it is not there; one that cannot be written is opened for reading.

    Args:
        writes: True if it must be written.

    Raises:
        InputError: it cannot be reached, or cannot be written and must be.
    """
    path = _file(store_uri())
    if path is not None and not writes:
        _is_writable(path, writes)
        if experiment_id := _experiment_in(path):
            return Store(experiment_id, path)
    client, experiment_id = _opened(path, writes)
    return Store(experiment_id, path, client)


def _opened(path: Path | None, writes: bool) -> tuple[MlflowClient, str]:
    """MLflow's client of the store, and the id of the experiment, which is made if it is not there.

    Args:
        path: MLflow's SQLite file; None if the runs are kept in another way.
        writes: True if it must be written.

    Raises:
        InputError: it cannot be reached, or cannot be written and must be.
    """
    uri = store_uri()
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    retries = os.environ.get("MLFLOW_HTTP_REQUEST_MAX_RETRIES")
    os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] = retries or "2"  # a wrong address is no reason to wait long
    if fixed := path is not None and not _is_writable(path, writes):
        # SQLite leaves such a file and its folder alone; MLflow makes folders of a plain sqlite:///file:
        uri = f"sqlite+pysqlite:///{path.absolute().as_uri()}?mode=ro&uri=true"
    import mlflow
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    # Several processes that create the tables at the same moment break the file for good.
    lock = path.with_name(path.name + ".lock") if path else lock_folder() / "tracking.lock"
    with nullcontext() if fixed else FileLock(lock):
        logging.getLogger("mlflow.store.db").setLevel(logging.CRITICAL)  # what fails is said by `reached`
        try:
            if path is not None and not fixed:
                sweep(path.parent, f".{path.name}.")
                if not path.exists() or not path.stat().st_size:
                    create(path)
            if not fixed:  # it becomes MLFLOW_TRACKING_URI
                mlflow.set_tracking_uri(uri)
            client = mlflow.MlflowClient(uri)
            return client, _experiment(client)
        except (MlflowException, SQLAlchemyError, StoreError, ImportError, UnicodeError) as e:  # a driver, a name
            raise InputError(
                f"MLflow store {_shown(store_uri())} cannot be used: {_first_line(e.__cause__ or e)}"
            ) from e
        finally:
            os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] = retries or RETRIES


def _experiment_in(file: Path) -> str:
    """The id of the experiment in MLflow's SQLite file; empty if it is not there, or the file is unusual."""
    with suppress(sqlite3.Error), closing(_read_only(file)) as db:
        ids = db.execute(f"select experiment_id from {TABLE} where name = ?", [EXPERIMENT]).fetchall()
        return str(ids[0][0]) if ids else ""
    return ""


@patient
def _experiment(client: MlflowClient) -> str:
    experiment = client.get_experiment_by_name(EXPERIMENT)
    return experiment.experiment_id if experiment else client.create_experiment(EXPERIMENT)


def create(path: Path) -> None:
    """Make MLflow's SQLite file with its tables, beside its name and renamed: a kill leaves none or a good one."""
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

    with tempfile.TemporaryDirectory(prefix=f".{path.name}.{owner()}", dir=path.parent) as folder:
        beside = Path(folder) / path.name
        SqlAlchemyStore(f"sqlite:///{beside}", "./mlruns").engine.dispose()
        beside.replace(path)


def _is_writable(path: Path, must: bool) -> bool:
    """Return True if SQLite can write a file and beside it; SQLite would try for minutes before it gave up.

    Raises:
        InputError: it must and cannot, there is no file to read, or the file is no store.
    """
    head, refused = b"", None
    try:
        if path.exists():
            with path.open("rb") as f:
                head = f.read(16)
            with path.open("r+b"):
                pass
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as e:
        refused = e
    if head and head != b"SQLite format 3\0":
        raise InputError(f"{path} is not an MLflow store; move it away or set MLFLOW_TRACKING_URI")
    if refused and (must or not head):
        raise InputError(
            f"the MLflow store {path} cannot be {'written' if must else 'read'} ({refused.strerror}); change the "
            "folder or set MLFLOW_TRACKING_URI"
        ) from refused
    return refused is None


@contextmanager
def only_one(key: str) -> Iterator[None]:
    """Hold a run against a second process that would run the same folds.

    Raises:
        InputError: another process has it.
    """
    try:
        with FileLock(lock_folder() / f"{key}.lock", timeout=0):
            yield
    except Timeout as e:
        raise InputError("another process is evaluating this system; wait for it and repeat the command") from e


def lock_folder() -> Path:
    """Folder of the locks.

    Raises:
        InputError: the data folder cannot be written.
    """
    folder = home() / "locks"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e}); set TOUCHBENCH_HOME to a folder that can") from e
    return folder
