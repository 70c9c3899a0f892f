"""The store of runs: MLflow, whose client only this module uses, in the main process.

A run of a command is one run of MLflow. Tags by which it is found again: ``touchbench.kind`` (such
as ``cell`` or ``fit``) and ``touchbench.cell``, the key of the run. ``touchbench.format`` is the
version of the layout of stored runs.
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

from bench.errors import InputError, StoreError
from bench.ground.progress import warn
from bench.ground.registry import PART_GROUPS
from bench.ground.scratch import remove_leftovers, why_data_folder_failed
from bench.store.database import (
    BESIDE,
    check_writable,
    create_database,
    has_experiment,
    lock_file,
    lock_folder,
    open_database,
    sqlite_file,
    store_uri,
    upgrade_database,
    why_sqlite_failed,
)
from bench.store.tables import HOW_TO_RESTORE, read_table, table_file
from bench.values.result import Result, RunTables

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run, RunInfo
    from mlflow.store.artifact.artifact_repo import ArtifactRepository

EXPERIMENT = "touchbench"
FORMAT = "5"  # version of stored runs; others are left out
RUNS_PER_REQUEST = 5000
FOLD_PREFIX = "fold/"  # of metrics whose steps are folds
RETRIES = "5"  # of a request to a server, after 0, 4, 8, 16 and 32 seconds


@contextmanager
def report_store_errors() -> Iterator[None]:
    """Turn a failure of MLflow, its file, its server or the disk into a `StoreError`."""
    try:
        yield
    except Exception as e:
        from mlflow.exceptions import MlflowException
        from requests.exceptions import RequestException
        from sqlalchemy.exc import SQLAlchemyError

        if not isinstance(e, (MlflowException, RequestException, SQLAlchemyError, OSError)):
            raise
        if isinstance(e, OSError) and why_data_folder_failed(e):
            raise
        path = sqlite_file(store_uri())
        if path and (reason := why_sqlite_failed(e, path)):
            raise StoreError(f"{reason}; stored results are kept") from e
        raise StoreError(
            f"the MLflow store {_printed_address()} failed: {_first_line(e)}; "
            "stored results are kept; repeat the command when the store works again"
        ) from e


def _first_line(error: BaseException) -> str:
    text = str(error)
    if isinstance(error, OSError) and error.filename2:  # of a copy, the one that is written
        text = f"{error.strerror}: {error.filename2}"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    lines = [line for line in lines if "Query-invoked autoflush" not in line]
    line = _mask_password((lines or [type(error).__name__])[0])
    # MLflow cites other errors at the end.
    return line if len(line) <= 250 else f"{line[:100]} ... {line[-150:]}"


def _mask_password(text: str) -> str:
    """Hide the password of an address, as messages are kept in logs."""
    return re.sub("(//[^/:@]*):[^/]*@", r"\1:***@", text)


def _printed_address() -> str:
    path = sqlite_file(store_uri())
    return _mask_password(store_uri()) if path is None else f"sqlite:///{path.absolute()}"


def _why_unusable(error: Exception) -> str:
    """Say why a store cannot be opened."""
    if schemas := re.search(r"found version (\w+), but expected (\w+)", str(error)):
        return (
            f"its schema is {schemas[1]}, this MLflow expects {schemas[2]}: another version wrote "
            "it; install that, or set MLFLOW_TRACKING_URI to another store"
        )
    return _first_line(error.__cause__ or error)


class Store:
    """The runs of touchbench's experiment in MLflow.

    ``artifacts`` is the address of a run's artifacts (``run.info.artifact_uri``). All methods raise
    `StoreError` if MLflow fails.
    """

    def __init__(self, client: MlflowClient, experiment_id: str) -> None:
        self.client, self.experiment_id = client, experiment_id

    @report_store_errors()
    def search_runs(self, condition: str = "") -> list[Run]:
        """Every run that passes MLflow's filter, newest first, except those of another format."""
        runs: list[Run] = []
        token, was_enabled = None, gc.isenabled()
        gc.disable()  # a search for cycles among MLflow's many objects takes most of the time
        try:
            while page := self.client.search_runs(
                [self.experiment_id], condition, max_results=RUNS_PER_REQUEST, page_token=token
            ):
                runs += page
                if not (token := page.token):
                    break
        finally:
            if was_enabled:
                gc.enable()
        readable = [run for run in runs if run.data.tags.get("touchbench.format") == FORMAT]
        if len(readable) < len(runs):
            warn(
                "runs that another version of touchbench has stored are left out; run their "
                "commands again"
            )
        return readable

    def runs_of_kind(self, *kinds: str, data: str = "") -> list[Run]:
        """Runs of some kinds, newest first; those on one corpus are found faster than all."""
        condition = f"tags.`data` = '{data}'" if data and "'" not in data else ""
        runs = self.search_runs(condition)
        return [run for run in runs if run.data.tags["touchbench.kind"] in kinds]

    def find_run(self, key: str, kind: str) -> Run | None:
        """The run of a key and a kind; None if there is none."""
        condition = f"tags.`touchbench.cell` = '{key}' and tags.`touchbench.kind` = '{kind}'"
        return next(iter(self.search_runs(condition)), None)

    @report_store_errors()
    def newest_runs(self, kind: str, limit: int, **params: str) -> list[Run]:
        """The newest runs of a kind with some parameters, at most ``limit``."""
        conditions = [
            f"tags.`touchbench.format` = '{FORMAT}'",
            f"tags.`touchbench.kind` = '{kind}'",
        ]
        conditions += [
            f"params.`{k}` = '{value}'" for k, value in params.items() if "'" not in value
        ]
        condition = " and ".join(conditions)
        return [*self.client.search_runs([self.experiment_id], condition, max_results=limit)]

    def load_result(self, run: Run) -> Result:
        """Turn a run into a result, which reads its tables when they are needed."""
        attributes = run_attributes(run.info, run.data.params, run.data.tags)
        metrics = {k: v for k, v in run.data.metrics.items() if not k.startswith(FOLD_PREFIX)}
        system = attributes.get("system", "this system")
        tables = self.tables_of_run(run.info.run_id, run.info.artifact_uri, system)
        return Result(attributes, metrics, tables)

    def tables_of_run(
        self, run_id: str, artifacts: str, system: str, names: Sequence[str] | None = None
    ) -> RunTables:
        """The tables of a run: those of ``names``, or all; each is read when it is needed."""
        description = f"{system} (run {run_id})"

        def read(name: str, columns: Sequence[str] = ()) -> Any:
            path = self.artifact_path(run_id, artifacts, table_file(name))
            return None if path is None else read_table(path, name, description, columns)

        def list_names() -> Sequence[str]:
            if names is not None:
                return names
            files = map(PurePosixPath, self.artifact_names(run_id, artifacts))
            return [file.stem for file in files if file.name == table_file(file.stem)]

        missing = f"{description} is missing in the store; {HOW_TO_RESTORE}"
        return RunTables({}, read, missing, list_names)

    @report_store_errors()
    def artifact_path(self, run_id: str, artifacts: str, name: str) -> Path | None:
        """The local file of an artifact, downloaded from another machine; None if there is none."""
        if (folder := _local_folder(artifacts)) is not None:
            return folder / name if (folder / name).is_file() else None
        from mlflow.exceptions import MlflowException
        from requests.exceptions import ConnectionError as Unreachable

        try:
            return Path(self.client.download_artifacts(run_id, name))
        except (OSError, MlflowException) as e:
            if isinstance(e, Unreachable) or "API request to" in str(e):  # the server failed
                raise
            return None

    @report_store_errors()
    def artifact_names(self, run_id: str, artifacts: str, subfolder: str = "") -> list[str]:
        """Sorted names of a run's artifacts, or of those in a subfolder."""
        if (folder := _local_folder(artifacts)) is not None:
            if not (folder / subfolder).is_dir():
                return []
            return sorted(path.name for path in (folder / subfolder).iterdir())
        items = self.client.list_artifacts(run_id, subfolder or None)
        return sorted(PurePosixPath(item.path).name for item in items)

    def describe_artifact(self, artifacts: str, name: str) -> str:
        """Say where an artifact is: its path on this machine, or its run."""
        if (folder := _local_folder(artifacts)) is not None:
            return str(folder / name)
        return f"{name} of run {artifacts.split('/')[-2]} in bench ui"

    @report_store_errors()
    def create_run(
        self, name: str, tags: Mapping[str, str], params: Mapping[str, object] | None = None
    ) -> Run:
        """Create a run, which goes on until `set_status`."""
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
        """Store metrics, parameters and tags of a run; a metric has its value at the last step."""
        from mlflow.entities import Metric, Param, RunTag

        now = int(time.time() * 1000)
        self.client.log_batch(
            run_id,
            [Metric(key, float(value), now, step) for key, value in (metrics or {}).items()],
            [Param(key, str(value)) for key, value in (params or {}).items()],
            [RunTag(key, value) for key, value in (tags or {}).items()],
        )

    @report_store_errors()
    def next_step(self, run_id: str, metric: str) -> int:
        """The step after all of a metric: of equal steps, MLflow would take the latest time."""
        history = self.client.get_metric_history(run_id, metric)
        return 1 + max((entry.step for entry in history), default=-1)

    @report_store_errors()
    def log_artifact(self, artifacts: str, path: Path, subfolder: str = "") -> None:
        """Store a file, or the files of a folder, with the artifacts of a run."""
        repository = self._artifact_repository(artifacts)
        log = repository.log_artifacts if path.is_dir() else repository.log_artifact
        log(str(path), subfolder or None)

    @report_store_errors()
    def delete_artifact(self, artifacts: str, name: str) -> None:
        """Delete an artifact, or a folder of them, if its repository can."""
        with suppress(NotImplementedError):
            self._artifact_repository(artifacts).delete_artifacts(name)

    def _artifact_repository(self, artifacts: str) -> ArtifactRepository:
        """The repository of an address; MLflow's client keeps the old one when a folder moves."""
        from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

        return get_artifact_repository(artifacts, self.client.tracking_uri)

    @report_store_errors()
    def set_status(self, run_id: str, status: str) -> None:
        """Set the status of a run: RUNNING, or an ended one's FINISHED, FAILED or KILLED."""
        if status == "RUNNING":
            self.client.update_run(run_id, status=status)
        else:
            self.client.set_terminated(run_id, status)

    @report_store_errors()
    def delete_run(self, run_id: str) -> None:
        """Delete a run, as MLflow does: it can be restored."""
        self.client.delete_run(run_id)


@contextmanager
def use_tracking_uri() -> Iterator[None]:
    """Let MLflow's own functions use the store, and undo what they set in the environment."""
    _quieten_mlflow()
    import mlflow

    before = os.environ.get("MLFLOW_TRACKING_URI")
    mlflow.set_tracking_uri(store_uri())
    try:
        yield
    finally:
        mlflow.set_tracking_uri(None)  # type: ignore[arg-type]
        if before is not None:
            os.environ["MLFLOW_TRACKING_URI"] = before


def _quieten_mlflow() -> None:
    """Turn telemetry and bars of progress off, unless the user wants them."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")


def run_attributes(
    info: RunInfo, params: Mapping[str, str], tags: Mapping[str, str]
) -> dict[str, Any]:
    """The attributes of a `Result`: parameters, tags, and some of MLflow's own."""
    parts = {f"{part}_name": params.get(part, "") for part in PART_GROUPS}
    own = {"run_id": info.run_id, "status": info.status, "started": info.start_time}
    return {**params, **tags, **parts, **own, "artifacts": info.artifact_uri}


def artifacts_beside(
    artifact_uri: str, tracking_uri: str | None = None, registry_uri: str | None = None
) -> object:
    """Make MLflow's repository of addresses with the scheme `BESIDE`.

    It is an entry point of MLflow, so that the pages of its server find these artifacts too.
    """
    from mlflow.store.artifact.local_artifact_repo import LocalArtifactRepository

    served = os.environ.get("_MLFLOW_SERVER_FILE_STORE")  # in MLflow's server
    folder = _path_beside_database(artifact_uri, tracking_uri or served or store_uri())
    return LocalArtifactRepository(folder.absolute().as_uri(), tracking_uri, registry_uri)


def _path_beside_database(address: str, uri: str) -> Path:
    return (sqlite_file(uri) or Path("mlflow.db")).parent / urlparse(address).path.lstrip("/")


def _local_folder(artifacts: str) -> Path | None:
    """The folder of an address of artifacts; None if it is not on this machine."""
    uri = urlparse(artifacts)
    if uri.scheme == BESIDE:
        return _path_beside_database(artifacts, store_uri())
    if uri.scheme == "file":
        return Path(unquote(uri.path))
    return Path(artifacts) if len(uri.scheme) <= 1 else None  # a drive letter is no scheme


def connect(writes: bool = False) -> Store:
    """Open the store, which is created if it is missing.

    A store that cannot be written is opened for reading, unless ``writes``.

    Raises:
        InputError: it cannot be used.
    """
    path = sqlite_file(store_uri())
    _quieten_mlflow()
    retries = os.environ.get("MLFLOW_HTTP_REQUEST_MAX_RETRIES")
    os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] = retries or "2"  # a wrong address fails soon
    uri, is_read_only = store_uri(), path is not None and not check_writable(path, writes)
    if is_read_only:
        # SQLite then writes nothing beside the file; of sqlite:///file:, MLflow would make folders.
        uri = f"sqlite+pysqlite:///{quote(path.absolute().as_uri())}?mode=ro&uri=true"
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException
    from mlflow.store.artifact.artifact_repository_registry import _artifact_repository_registry
    from sqlalchemy.exc import SQLAlchemyError

    # Several processes that create the tables at the same moment break the file for good.
    lock = path.with_name(path.name + ".lock") if path else lock_folder() / "tracking.lock"
    is_ready = path is not None and not writes and has_experiment(path, EXPERIMENT)
    with nullcontext() if is_read_only or is_ready else lock_file(lock):
        # `report_store_errors` reports failures.
        logging.getLogger("mlflow.store.db").setLevel(logging.CRITICAL)
        try:
            if path is not None and not (is_read_only or is_ready):
                remove_leftovers(path.parent)
                if not path.exists() or not path.stat().st_size:
                    create_database(path)
                upgrade_database(path)
            # The installed entry point may be that of an earlier version.
            _artifact_repository_registry.register(BESIDE, artifacts_beside)
            client = MlflowClient(uri)
            return Store(client, _find_or_create_experiment(client, None if is_read_only else path))
        # also a missing driver, and a name that is no UTF-8
        except (MlflowException, SQLAlchemyError, StoreError, ImportError, UnicodeError) as e:
            if path is not None and (reason := why_sqlite_failed(e, path)):
                raise InputError(reason) from e
            raise InputError(
                f"MLflow store {_printed_address()} cannot be used: {_why_unusable(e)}"
            ) from e
        finally:
            os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] = retries or RETRIES


@report_store_errors()
def _find_or_create_experiment(client: MlflowClient, path: Path | None) -> str:
    """Id of touchbench's experiment; artifacts of a new one lie beside its SQLite file."""
    experiment = client.get_experiment_by_name(EXPERIMENT)
    if experiment and experiment.lifecycle_stage == "deleted":
        raise InputError(
            f"the experiment {EXPERIMENT} of {_printed_address()} was deleted in MLflow; restore "
            f"it with: mlflow experiments restore -x {experiment.experiment_id}; "
            "or set MLFLOW_TRACKING_URI to another store"
        )
    if experiment:
        return experiment.experiment_id
    if path is None:
        return client.create_experiment(EXPERIMENT)
    with open_database(path) as database:
        return database.create_experiment(EXPERIMENT)
