"""MLflow's store through MLflow's own client, which no other module uses. Only the main process uses it.

A cell of a command is one run of MLflow. Tags by which it is found again: ``touchbench.kind`` (such as ``cell`` or
``fit``) and ``touchbench.cell``, the key of the run. ``touchbench.format`` says how a run is stored.
"""

from __future__ import annotations

import gc
import logging
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote, urlparse

from filelock import FileLock

from bench.errors import InputError, StoreError
from bench.ground.progress import warn
from bench.ground.scratch import remove_leftovers
from bench.ground.registry import PART_GROUPS
from bench.store.database import (
    BESIDE,
    check_writable,
    create_database,
    lock_folder,
    open_database,
    sqlite_file,
    store_uri,
    upgrade_database,
)
from bench.store.tables import HOW_TO_RESTORE, read_table, table_file
from bench.values.result import Result, RunTables

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run, RunInfo
    from mlflow.store.artifact.artifact_repo import ArtifactRepository

EXPERIMENT = "touchbench"
FORMAT = "4"  # version of stored runs; others are left out
RUNS_PER_REQUEST = 5000  # runs of one request
FOLD_PREFIX = "fold/"  # numbers of a run whose steps are its folds
RETRIES = "5"  # of a request to a server: they wait 0, 4, 8, 16 and 32 seconds


@contextmanager
def report_store_errors() -> Iterator[None]:
    """Report a failure of MLflow, its file, its server or the disk in one line; MLflow waits for a locked file."""
    try:
        yield
    except Exception as e:
        from mlflow.exceptions import MlflowException
        from requests.exceptions import RequestException
        from sqlalchemy.exc import SQLAlchemyError

        if not isinstance(e, (MlflowException, RequestException, SQLAlchemyError, OSError)):
            raise
        raise StoreError(
            f"the MLflow store {_printed_address()} failed: {_first_line(e)}; stored results are kept; repeat the command when "
            "the store works again"
        ) from e


def _first_line(error: BaseException) -> str:
    lines = [
        line
        for line in str(error).splitlines()
        if line.strip() and "Query-invoked autoflush" not in line
    ]
    line = _mask_password((lines or [type(error).__name__])[0].strip())
    return (
        line if len(line) <= 250 else f"{line[:100]} ... {line[-150:]}"
    )  # what MLflow cites ends with the cause


def _mask_password(text: str) -> str:
    """A text without the password of an address, as messages end in logs."""
    return re.sub("(//[^/:@]*):[^/]*@", r"\1:***@", text)


def _printed_address() -> str:
    """Address of the store for people."""
    path = sqlite_file(store_uri())
    return _mask_password(store_uri()) if path is None else f"sqlite:///{path.absolute()}"


def _why_unusable(error: Exception) -> str:
    """Why a store cannot be opened."""
    if schemas := re.search(r"found version (\w+), but expected (\w+)", str(error)):
        return (
            f"its schema is {schemas[1]}, this MLflow expects {schemas[2]}: another version wrote it; install that, "
            "or set MLFLOW_TRACKING_URI to another store"
        )
    return _first_line(error.__cause__ or error)


class Store:
    """Runs in MLflow, of touchbench's experiment."""

    def __init__(self, client: MlflowClient, experiment_id: str) -> None:
        self.client, self.experiment_id = client, experiment_id

    @report_store_errors()
    def search_runs(self, condition: str = "") -> list[Run]:
        """Every run that passes MLflow's filter, newest first; runs of another format are left out."""
        stored: list[Run] = []
        token, collects = None, gc.isenabled()
        gc.disable()  # MLflow makes a hundred objects for each run, and looking for cycles takes most of the time
        try:
            while page := self.client.search_runs(
                [self.experiment_id], condition, max_results=RUNS_PER_REQUEST, page_token=token
            ):
                stored += page
                if not (token := page.token):
                    break
        finally:
            if collects:
                gc.enable()
        kept = [run for run in stored if run.data.tags.get("touchbench.format") == FORMAT]
        if len(kept) < len(stored):
            warn(
                "runs that another version of touchbench has stored are left out; run their commands again"
            )
        return kept

    def runs_of_kind(self, *kinds: str, data: str = "") -> list[Run]:
        """The runs of some kinds, newest first: all, or those on one corpus, which take less time."""
        condition = f"tags.`data` = '{data}'" if data and "'" not in data else ""
        return [
            run for run in self.search_runs(condition) if run.data.tags["touchbench.kind"] in kinds
        ]

    def find_run(self, key: str, kind: str) -> Run | None:
        """The run of a key and a kind, None where there is none."""
        return next(
            iter(
                self.search_runs(
                    f"tags.`touchbench.cell` = '{key}' and tags.`touchbench.kind` = '{kind}'"
                )
            ),
            None,
        )

    @report_store_errors()
    def newest_runs(self, kind: str, most: int, **params: str) -> list[Run]:
        """At most so many of the newest runs of a kind that have some parameters."""
        asked = [f"tags.`touchbench.format` = '{FORMAT}' and tags.`touchbench.kind` = '{kind}'"]
        asked += [
            f"params.`{name}` = '{value}'" for name, value in params.items() if "'" not in value
        ]
        return [
            *self.client.search_runs([self.experiment_id], " and ".join(asked), max_results=most)
        ]

    def load_result(self, run: Run) -> Result:
        """A run as a result; its tables are read when they are asked for."""
        about = run_attributes(run.info, run.data.params, run.data.tags)
        numbers = {
            name: value
            for name, value in run.data.metrics.items()
            if not name.startswith(FOLD_PREFIX)
        }
        system = about.get("system", "this system")
        return Result(
            about, numbers, self.tables_of_run(run.info.run_id, run.info.artifact_uri, system)
        )

    def tables_of_run(
        self, run_id: str, artifacts: str, system: str, names: Sequence[str] | None = None
    ) -> RunTables:
        """The tables of a run, of these names or of all that there are; each is read when it is asked for."""
        this = f"{system} (run {run_id})"

        def read(name: str, columns: Sequence[str] = ()) -> Any:
            path = self.artifact_path(run_id, artifacts, table_file(name))
            return None if path is None else read_table(path, name, this, columns)

        def listed() -> Sequence[str]:
            if names is not None:
                return names
            files = map(PurePosixPath, self.artifact_names(run_id, artifacts))
            return [file.stem for file in files if file.name == table_file(file.stem)]

        return RunTables({}, read, f"{this} is missing in the store; {HOW_TO_RESTORE}", listed)

    @report_store_errors()
    def artifact_path(self, run_id: str, artifacts: str, name: str) -> Path | None:
        """A run's artifact as a local file, None if there is none: where it lies, or fetched from another machine."""
        if (folder := _local_folder(artifacts)) is not None:
            return folder / name if (folder / name).is_file() else None
        from mlflow.exceptions import MlflowException
        from requests.exceptions import ConnectionError as Unreachable

        try:
            return Path(self.client.download_artifacts(run_id, name))
        except (OSError, MlflowException) as e:
            if isinstance(e, Unreachable) or "API request to" in str(
                e
            ):  # which says nothing of the artifact
                raise
            return None

    @report_store_errors()
    def artifact_names(self, run_id: str, artifacts: str, where: str = "") -> list[str]:
        """Names of a run's artifacts, or of those in one of its folders, sorted."""
        if (folder := _local_folder(artifacts)) is not None:
            return (
                sorted(path.name for path in (folder / where).iterdir())
                if (folder / where).is_dir()
                else []
            )
        return sorted(
            PurePosixPath(item.path).name
            for item in self.client.list_artifacts(run_id, where or None)
        )

    def describe_artifact(self, address: str, name: str) -> str:
        """Location of an artifact for people: its path if it is on this machine, else in words."""
        folder = _local_folder(address)
        return (
            f"{name} of run {address.split('/')[-2]} in bench ui"
            if folder is None
            else str(folder / name)
        )

    @report_store_errors()
    def create_run(
        self, name: str, tags: Mapping[str, str], params: Mapping[str, object] | None = None
    ) -> Run:
        """A new run."""
        tags = {**tags, "mlflow.runName": name, "touchbench.format": FORMAT}
        run = self.client.create_run(self.experiment_id, run_name=name, tags=tags)
        if params:
            self.log_values(run.info.run_id, params=params)
        return run

    @report_store_errors()
    def log_values(
        self,
        run_id: str,
        metrics: Mapping[str, float] | None = None,
        params: Mapping[str, object] | None = None,
        tags: Mapping[str, str] | None = None,
        step: int = 0,
    ) -> None:
        """Numbers, parameters and tags of a run."""
        from mlflow.entities import Metric, Param, RunTag

        now = int(time.time() * 1000)
        self.client.log_batch(
            run_id,
            [Metric(key, float(value), now, step) for key, value in (metrics or {}).items()],
            [Param(key, str(value)) for key, value in (params or {}).items()],
            [RunTag(key, value) for key, value in (tags or {}).items()],
        )

    @report_store_errors()
    def log_artifact(self, address: str, path: Path, where: str = "") -> None:
        """Store a file, or the files of a folder, with the artifacts of a run."""
        place = self._artifact_repository(address)
        (place.log_artifacts if path.is_dir() else place.log_artifact)(str(path), where or None)

    @report_store_errors()
    def delete_artifact(self, address: str, name: str) -> None:
        """Delete an artifact, or a folder of them, where the place that keeps it can."""
        with suppress(NotImplementedError):
            self._artifact_repository(address).delete_artifacts(name)

    def _artifact_repository(self, address: str) -> ArtifactRepository:
        """Where artifacts of an address are kept; MLflow's client remembers where they were before a folder moved."""
        from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

        return get_artifact_repository(address, self.client.tracking_uri)

    @report_store_errors()
    def set_status(self, run_id: str, status: str) -> None:
        """Mark a run that goes on (RUNNING), or has ended: FINISHED, FAILED or KILLED."""
        if status == "RUNNING":
            self.client.update_run(run_id, status=status)
        else:
            self.client.set_terminated(run_id, status)

    @report_store_errors()
    def delete_run(self, run_id: str) -> None:
        """Take a run out of all lists."""
        self.client.delete_run(run_id)


def run_attributes(
    info: RunInfo, params: Mapping[str, str], tags: Mapping[str, str]
) -> dict[str, Any]:
    """What a result of a run is of, by name."""
    about = {**params, **tags} | {f"{part}_name": params.get(part, "") for part in PART_GROUPS}
    about |= {"run_id": info.run_id, "status": info.status, "started": info.start_time}
    return about | {"artifacts": info.artifact_uri}


def artifacts_beside(
    artifact_uri: str, tracking_uri: str | None = None, registry_uri: str | None = None
) -> object:
    """MLflow's place of artifacts for addresses of the scheme `BESIDE`; its entry point, so MLflow's pages take it."""
    from mlflow.store.artifact.local_artifact_repo import LocalArtifactRepository

    served = os.environ.get("_MLFLOW_SERVER_FILE_STORE")  # in MLflow's server
    folder = _path_beside_database(artifact_uri, tracking_uri or served or store_uri())
    return LocalArtifactRepository(folder.absolute().as_uri(), tracking_uri, registry_uri)


def _path_beside_database(address: str, uri: str) -> Path:
    return (sqlite_file(uri) or Path("mlflow.db")).parent / urlparse(address).path.lstrip("/")


def _local_folder(address: str) -> Path | None:
    """The folder of an address of artifacts, None if it is not on this machine."""
    uri = urlparse(address)
    if uri.scheme == BESIDE:
        return _path_beside_database(address, store_uri())
    if uri.scheme == "file":
        return Path(unquote(uri.path))
    return Path(address) if len(uri.scheme) <= 1 else None  # a drive letter is no scheme


def connect(writes: bool = False) -> Store:
    """The store, created if it is not there; one that cannot be written is opened for reading, unless it must be."""
    uri, path = store_uri(), sqlite_file(store_uri())
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    retries = os.environ.get("MLFLOW_HTTP_REQUEST_MAX_RETRIES")
    os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] = (
        retries or "2"
    )  # a wrong address is no reason to wait long
    if fixed := path is not None and not check_writable(path, writes):
        # SQLite leaves such a file and its folder alone; MLflow makes folders of a plain sqlite:///file:
        uri = f"sqlite+pysqlite:///{quote(path.absolute().as_uri())}?mode=ro&uri=true"
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException
    from mlflow.store.artifact.artifact_repository_registry import _artifact_repository_registry
    from sqlalchemy.exc import SQLAlchemyError

    # Several processes that create the tables at the same moment break the file for good.
    lock = path.with_name(path.name + ".lock") if path else lock_folder() / "tracking.lock"
    with nullcontext() if fixed else FileLock(lock):
        logging.getLogger("mlflow.store.db").setLevel(
            logging.CRITICAL
        )  # what fails is said by `report_store_errors`
        try:
            if path is not None and not fixed:
                remove_leftovers(path.parent, f".{path.name}.")
                if not path.exists() or not path.stat().st_size:
                    create_database(path)
                upgrade_database(path)
            # The entry point is for MLflow's own programs, and may be that of an earlier installation.
            _artifact_repository_registry.register(BESIDE, artifacts_beside)
            client = MlflowClient(uri)
            return Store(client, _find_or_create_experiment(client, None if fixed else path))
        except (
            MlflowException,
            SQLAlchemyError,
            StoreError,
            ImportError,
            UnicodeError,
        ) as e:  # a driver, a name
            raise InputError(
                f"MLflow store {_printed_address()} cannot be used: {_why_unusable(e)}"
            ) from e
        finally:
            os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] = retries or RETRIES


@report_store_errors()
def _find_or_create_experiment(client: MlflowClient, path: Path | None) -> str:
    """Id of touchbench's experiment, made where there is none; its artifacts lie beside a SQLite file."""
    experiment = client.get_experiment_by_name(EXPERIMENT)
    if experiment and experiment.lifecycle_stage == "deleted":
        raise InputError(
            f"the experiment {EXPERIMENT} of {_printed_address()} was deleted in MLflow; restore it with: mlflow experiments "
            f"restore -x {experiment.experiment_id}; or set MLFLOW_TRACKING_URI to another store"
        )
    if experiment:
        return experiment.experiment_id
    if path is None:
        return client.create_experiment(EXPERIMENT)
    with open_database(path) as tables:
        return tables.create_experiment(EXPERIMENT)
