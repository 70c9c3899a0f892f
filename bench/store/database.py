"""MLflow's SQLite file: where it is, made whole, upgraded, and whether it can be written; locks of runs."""

from __future__ import annotations

import os
import shutil
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
from bench.ground.progress import warn
from bench.ground.scratch import data_folder, owner_prefix, write_then_rename

if TYPE_CHECKING:
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

SQLITE = ("sqlite:///", "sqlite+pysqlite:///")  # before a file
BESIDE = "touchbench"  # scheme of the addresses of artifacts that lie beside MLflow's SQLite file, wherever it is moved


def store_uri() -> str:
    """Address of the store: ``MLFLOW_TRACKING_URI``, or MLflow's SQLite file in the working folder."""
    return os.environ.get("MLFLOW_TRACKING_URI") or sqlite_address(Path.cwd() / "mlflow.db")


def sqlite_address(path: Path) -> str:
    """The address of SQLite's file; of a quoted one behind sqlite:, MLflow would make the folders."""
    place = quote(str(path.absolute()))
    return f"{SQLITE[place != str(path.absolute())]}{place}"


def sqlite_file(uri: str) -> Path | None:
    """SQLite's file of an address, as SQLAlchemy reads it."""
    driver = next((driver for driver in SQLITE if uri.startswith(driver)), None)
    return Path(unquote(uri.removeprefix(driver).partition("?")[0])) if driver else None


@contextmanager
def open_database(path: Path) -> Iterator[SqlAlchemyStore]:
    """MLflow's SQLite file, made if it is not there; artifacts of its experiments lie beside it."""
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

    tables = SqlAlchemyStore(sqlite_address(path), f"{BESIDE}:/mlruns")
    try:
        yield tables
    finally:
        tables.engine.dispose()


def create_database(path: Path) -> None:
    """Make MLflow's SQLite file with its tables, beside its name and renamed: a kill leaves none or a good one.

    MLflow takes seconds to make its tables, so that empty ones are kept in the data folder.
    """
    empty = data_folder() / f"mlflow-{version('mlflow')}.db"
    with tempfile.TemporaryDirectory(
        prefix=f".{path.name}.{owner_prefix()}", dir=path.parent
    ) as folder:
        beside = Path(folder) / path.name
        if empty.is_file():
            shutil.copyfile(empty, beside)
        else:
            with open_database(beside):
                pass
            with (
                suppress(OSError),
                write_then_rename(empty) as kept,
            ):  # a folder that cannot be written
                shutil.copyfile(beside, kept)
        beside.replace(path)


def upgrade_database(path: Path) -> None:
    """Upgrade a SQLite file of an older MLflow, which could not read it any more; a copy is kept beside it."""
    from mlflow.store import db_migrations

    with closing(sqlite3.connect(path)) as file:
        if not file.execute(
            "SELECT 1 FROM sqlite_master WHERE name = 'alembic_version'"
        ).fetchone():
            return
        (schema,) = file.execute("SELECT version_num FROM alembic_version").fetchone() or [""]
        steps = (
            step.read_text() for step in Path(db_migrations.__file__).parent.glob("versions/*.py")
        )
        if not any(f'down_revision = "{schema}"' in step for step in steps):
            return
        copy = path.with_name(f"{path.name}.{schema}")
        with closing(sqlite3.connect(copy)) as beside:
            file.backup(beside)
    warn(f"{path} is of an older MLflow and is upgraded now; that version can read the copy {copy}")
    words = [sys.executable, "-m", "mlflow", "db", "upgrade", f"sqlite:///{path.name}"]
    done = subprocess.run(words, cwd=path.parent, capture_output=True, text=True)
    if done.returncode:
        raise InputError(
            f"{path} cannot be upgraded ({done.stderr.strip()[-150:]}); {copy} is as it was"
        )


def check_writable(path: Path, must: bool) -> bool:
    """Return True if SQLite can write a file and beside it; SQLite would try for minutes before it gave up."""
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
def lock_run(key: str) -> Iterator[None]:
    """Hold a run against a second process that would run the same folds."""
    try:
        with FileLock(lock_folder() / f"{key}.lock", timeout=0):
            yield
    except Timeout as e:
        raise InputError(
            "another process is evaluating this system; wait for it and repeat the command"
        ) from e


def lock_folder() -> Path:
    """Folder of the locks."""
    folder = data_folder() / "locks"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(
            f"{folder} cannot be written ({e}); set TOUCHBENCH_HOME to a folder that can"
        ) from e
    return folder
