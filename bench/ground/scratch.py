"""The user's data folder, and files that a killed command cannot leave half-written.

A temporary file or folder has a lock beside it while it is used; later commands remove those whose
lock is free.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError, one_line

if TYPE_CHECKING:
    from filelock import BaseFileLock

MARK = "touchbench-"  # in the names of temporary files, before the number of their process
NO_SPACE = 1 << 16  # bytes; a disk with less is full
LOCK = ".lock"  # end of the name of their locks


def data_folder() -> Path:
    """The folder of imported corpora and cached features: ``TOUCHBENCH_HOME``, or the user's."""
    if override := os.environ.get("TOUCHBENCH_HOME"):
        return Path(override).expanduser()
    from platformdirs import user_data_path

    return user_data_path("touchbench")


def why_data_folder_failed(error: OSError) -> str:
    """Say what is wrong with the data folder; "" for an error that names another place."""
    place, reason, folder = error.filename2 or error.filename, error.strerror, data_folder()
    if isinstance(error, shutil.Error) and isinstance(error.args[0], list):  # of a whole folder
        _, place, reason = error.args[0][0]
        reason = reason.partition(":")[0]
    if not place or not Path(place).absolute().is_relative_to(folder.absolute()):
        return ""
    return (
        f"the data folder {folder} cannot be used ({one_line(reason)}: {place}); mend it, or set "
        "TOUCHBENCH_HOME to another folder, and repeat the command"
    )


@contextmanager
def use_scratch_folder() -> Iterator[None]:
    """Make ``tempfile`` use a folder of this process, which is removed at the end.

    Also removes what dead processes left. If the data folder cannot be written, temporary files lie
    in their usual place.
    """
    folder, before = data_folder() / "tmp", tempfile.tempdir
    with ExitStack() as stack:
        with suppress(OSError):  # a command that needs the folder reports it
            folder.mkdir(parents=True, exist_ok=True)
            _remove_semaphores(remove_leftovers(folder, "*"), folder)
            corpora = data_folder() / "corpora"
            kept = (data_folder() / name for name in ("", "features", "detectors"))
            for parent in (*kept, corpora, *corpora.glob("*")):
                remove_leftovers(parent)
            mine = stack.enter_context(hold_path(folder, ""))
            mine.mkdir()
            tempfile.tempdir = str(mine)
        try:
            yield
        except OSError as e:
            is_full = e.errno == errno.ENOSPC and folder.exists()
            if is_full and not e.filename and shutil.disk_usage(folder).free < NO_SPACE:
                e.filename = str(folder)  # the error of a full disk names no file
            raise
        finally:
            tempfile.tempdir = before


@contextmanager
def hold_path(folder: Path, prefix: str = ".", suffix: str = "") -> Iterator[Path]:
    """Yield a new path for a file or folder, which is removed at the end, with a lock beside it.

    The lock is held meanwhile. It tells any process that can see the path, from whatever container
    or machine, whether the path is in use; numbers of processes and names of hosts do not.
    """
    path = folder / f"{prefix}{MARK}{os.getpid()}-{uuid.uuid4().hex[:12]}{suffix}"
    with _lock_beside(path):
        try:
            yield path
        finally:
            _remove_with_lock(path)


def remove_leftovers(folder: Path, names: str = f".{MARK}*") -> list[str]:
    """Remove what dead processes left in a folder: `hold_path` made it, and its lock is free.

    Returns:
        Names of what was removed.
    """
    removed = []
    for name in sorted({path.name.removesuffix(LOCK) for path in folder.glob(names)}):
        with suppress(OSError), _lock_beside(folder / name, timeout=0):
            _remove_with_lock(folder / name)
            removed.append(name)
    return removed


def _lock_beside(path: Path, timeout: float = -1) -> BaseFileLock:
    from filelock import FileLock  # only commands need it, as `bench --help` must be fast

    return FileLock(f"{path}{LOCK}", timeout)


def _remove_with_lock(path: Path) -> None:
    """Remove a path that a lock of this process protects, and then the lock's file."""
    with suppress(OSError):  # removed already, or of another user
        if os.path.lexists(path):
            remove_path(path)
        os.unlink(f"{path}{LOCK}")


def _remove_semaphores(removed: Iterable[str], folder: Path) -> None:
    """Remove the semaphores of processes whose scratch folders were removed.

    Linux keeps those of workers whose whole group was killed. They go by the number of the process,
    which another one may have, here or in a container.
    """
    for name in removed:
        process = re.fullmatch(rf"{MARK}(\d+)-.*", name)
        if not process or _is_alive(int(process[1])) or [*folder.glob(f"{MARK}{process[1]}-*")]:
            continue
        for path in Path("/dev/shm").glob(f"sem.loky-{process[1]}-*"):
            with suppress(OSError):
                path.unlink()


@contextmanager
def name_place(path: Path) -> Iterator[None]:
    """Name a path in errors that name none, as that of a full disk."""
    try:
        yield
    except OSError as e:
        e.filename = e.filename or str(path)
        raise


@contextmanager
def write_then_rename(path: Path) -> Iterator[Path]:
    """Yield a path to write, which then replaces ``path``; the old file stays if that fails.

    An existing path that is no plain file, such as ``/dev/stdout``, is yielded itself.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    path = path.resolve()
    remove_leftovers(path.parent)
    with hold_path(path.parent, suffix=path.suffix) as beside:
        with name_place(path):
            yield beside
        os.replace(beside, path)


def check_empty_folder(out: Path) -> Path:
    """Return a folder that is new or empty; an `InputError` for any other."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"out={out}: this place is not empty; name a new or empty folder")
    return out


@contextmanager
def fill_then_rename(out: Path) -> Iterator[Path]:
    """Yield a folder to fill, which then gets the name ``out``; a kill leaves no part of it."""
    out = out.absolute()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(out.parent)
        with hold_path(out.parent) as beside:
            beside.mkdir()
            yield beside
            beside.rename(out)
    except OSError as e:
        raise InputError(
            f"out={out}: cannot be written ({e.strerror or e}); choose another folder"
        ) from e


def remove_path(path: Path) -> None:
    """Remove a file, a link, or a folder with its content."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink()


def _is_alive(process: int) -> bool:
    import psutil  # only if there is something to remove, as `bench --help` must be fast

    return psutil.pid_exists(process)
