"""MLflow's SQLite file: its address, its creation and upgrade, access to it; locks of runs."""

from __future__ import annotations

import os
import re
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote

from filelock import FileLock, Timeout

from bench.errors import InputError
from bench.ground.digests import DamagedFile, append_digest, split_digest
from bench.ground.progress import warn
from bench.ground.scratch import (
    data_folder,
    hold_path,
    name_place,
    why_data_folder_failed,
    write_then_rename,
)

if TYPE_CHECKING:
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

SQLITE = ("sqlite:///", "sqlite+pysqlite:///")  # before the path of a file
SQLITE_ERROR = re.compile(
    "database is locked|database table is locked|database disk image is malformed"
    "|malformed database schema[^\n]*|file is not a database|disk I/O error"
)
# Scheme of artifacts that lie beside MLflow's SQLite file, wherever that is moved
BESIDE = "touchbench"


def store_uri() -> str:
    """Address of the store: ``MLFLOW_TRACKING_URI``, or ``mlflow.db`` in the working folder."""
    return os.environ.get("MLFLOW_TRACKING_URI") or sqlite_address(Path.cwd() / "mlflow.db")


def sqlite_address(path: Path) -> str:
    """Address of a SQLite file; if its path has special characters, with the driver.

    Without the driver, MLflow would create folders with the quoted name.
    """
    plain = str(path.absolute())
    is_special = quote(plain) != plain
    return f"{SQLITE[is_special]}{quote(plain)}"


def sqlite_file(uri: str) -> Path | None:
    """The SQLite file of an address, as SQLAlchemy reads it; None for another database."""
    driver = next((driver for driver in SQLITE if uri.startswith(driver)), None)
    return Path(unquote(uri.removeprefix(driver).partition("?")[0])) if driver else None


@contextmanager
def open_database(path: Path) -> Iterator[SqlAlchemyStore]:
    """Open MLflow's SQLite file, which is created if missing; artifacts will lie beside it."""
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

    database = SqlAlchemyStore(sqlite_address(path), f"{BESIDE}:/mlruns")
    try:
        yield database
    finally:
        database.engine.dispose()


def create_database(path: Path) -> None:
    """Create MLflow's SQLite file with its tables, under another name until it is complete.

    MLflow needs seconds to create its tables, so an empty file is kept in the data folder.
    """
    empty = data_folder() / f"mlflow-{version('mlflow')}.db"
    with hold_path(path.parent) as folder:
        folder.mkdir()
        new = folder / path.name
        try:
            content = split_digest(empty.read_bytes())
        except (OSError, DamagedFile):
            with open_database(new):
                pass
            with suppress(OSError), write_then_rename(empty) as copy:  # unless it cannot be written
                copy.write_bytes(append_digest(new.read_bytes()))
        else:
            with name_place(path):
                new.write_bytes(content)
        new.replace(path)


def why_sqlite_failed(error: BaseException, path: Path) -> str:
    """What is wrong with a SQLite file, and what to do; "" for any other error."""
    reason = SQLITE_ERROR.search(str(error))
    if not reason:
        return ""
    if "locked" in reason[0]:
        return f"another program holds {path}; repeat the command"
    return f"{path} is damaged ({reason[0]}); restore a copy, or move it away"


@contextmanager
def query_database(path: Path) -> Iterator[sqlite3.Connection]:
    """Read a SQLite file without MLflow, which would repeat for minutes what fails.

    Raises:
        InputError: it is damaged, or another program holds it.
    """
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True)) as file:
            yield file
    except sqlite3.Error as e:
        raise InputError(why_sqlite_failed(e, path) or f"{path} cannot be read: {e}") from e


def find_schema(path: Path) -> str:
    """The schema of a SQLite file of MLflow; "" for one without its tables."""
    with query_database(path) as file:
        has_schema = "SELECT 1 FROM sqlite_master WHERE name = 'alembic_version'"
        if not file.execute(has_schema).fetchone():
            return ""
        return (file.execute("SELECT version_num FROM alembic_version").fetchone() or [""])[0]


def is_outdated(schema: str) -> bool:
    """True if the installed MLflow can upgrade a schema."""
    from mlflow.store import db_migrations

    steps = Path(db_migrations.__file__).parent.glob("versions/*.py")
    return any(f'down_revision = "{schema}"' in step.read_text() for step in steps)


def has_experiment(path: Path, name: str) -> bool:
    """True if a SQLite file is ready to be read: of this MLflow, with an experiment."""
    if not path.exists() or not path.stat().st_size:
        return False
    if not (schema := find_schema(path)) or is_outdated(schema):
        return False
    from mlflow.store.tracking.dbmodels.models import SqlExperiment

    with query_database(path) as file:
        table = SqlExperiment.__tablename__
        found = file.execute(f"SELECT 1 FROM {table} WHERE name = ?", [name])
        return found.fetchone() is not None


def upgrade_database(path: Path) -> None:
    """Upgrade a SQLite file of an older MLflow; a copy stays beside it, for that version."""
    schema = find_schema(path)
    if not schema or not is_outdated(schema):
        return
    copy = path.with_name(f"{path.name}.{schema}")
    with query_database(path) as file, closing(sqlite3.connect(copy)) as beside:
        file.backup(beside)
    warn(f"{path} is of an older MLflow and is upgraded now; that version can read the copy {copy}")
    words = [sys.executable, "-m", "mlflow", "db", "upgrade", f"sqlite:///{path.name}"]
    done = subprocess.run(words, cwd=path.parent, capture_output=True, text=True)
    if done.returncode:
        reason = done.stderr.strip()[-150:]
        raise InputError(f"{path} cannot be upgraded ({reason}); {copy} is as it was")


def check_writable(path: Path, required: bool) -> bool:
    """Return True if SQLite can write a file and beside it; SQLite would try for minutes.

    Raises:
        InputError: it is no MLflow store, cannot be read, or not be written if ``required``.
    """
    head, error = b"", None
    try:
        if path.exists():
            with path.open("rb") as f:
                head = f.read(16)
            with path.open("r+b"):
                pass
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as e:
        error = e
    if head and head != b"SQLite format 3\0":
        raise InputError(f"{path} is not an MLflow store; move it away or set MLFLOW_TRACKING_URI")
    if error and (required or not head):
        raise InputError(
            f"the MLflow store {path} cannot be {'written' if required else 'read'} "
            f"({error.strerror}); change the folder or set MLFLOW_TRACKING_URI"
        ) from error
    return error is None


class RunLocked(InputError):
    """Another process evaluates the system of a run."""


@contextmanager
def lock_file(path: Path, timeout: float = -1) -> Iterator[None]:
    """Hold a lock file, which is created if missing.

    Raises:
        InputError: it cannot be written, such as that of another user.
        Timeout: another process holds it for longer than ``timeout`` seconds.
    """
    lock = FileLock(path, timeout)
    try:
        lock.acquire()
    except OSError as e:
        if isinstance(e, Timeout):  # an OSError, too
            raise
        if not path.exists() and (message := why_data_folder_failed(e)):
            raise InputError(message) from e
        owner = f", a file of {path.owner()}," if path.exists() else ""
        raise InputError(
            f"the lock {path}{owner} cannot be written ({e.strerror or e}); "
            "make it writable, or delete it while no command runs"
        ) from e
    try:
        yield
    finally:
        lock.release()


@contextmanager
def lock_run(key: str) -> Iterator[None]:
    """Refuse to run folds that another process runs at the moment."""
    try:
        with lock_file(lock_folder() / f"{key}.lock", timeout=0):
            yield
    except Timeout as e:
        raise RunLocked(
            "another process is evaluating this system; wait for it and repeat the command"
        ) from e


def lock_folder() -> Path:
    """Folder of the locks, created if missing."""
    folder = data_folder() / "locks"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(
            f"{folder} cannot be written ({e}); set TOUCHBENCH_HOME to a folder that can"
        ) from e
    return folder
