"""The user's data folder, and files that a killed command cannot leave half-written.

Temporary files have the number of their process in their names; later commands remove those of dead
processes.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.errors import InputError


def data_folder() -> Path:
    """The folder of imported corpora and cached features: ``TOUCHBENCH_HOME``, or the user's."""
    if override := os.environ.get("TOUCHBENCH_HOME"):
        return Path(override).expanduser()
    from platformdirs import user_data_path

    return user_data_path("touchbench")


@contextmanager
def use_scratch_folder() -> Iterator[None]:
    """Make ``tempfile`` use a folder of this process, which is removed at the end.

    Also removes what dead processes left. If the data folder cannot be written, temporary files lie
    in their usual place.
    """
    folder, before, mine = data_folder() / "tmp", tempfile.tempdir, None
    with suppress(OSError):  # a command that needs the folder reports it
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
        corpora = data_folder() / "corpora"
        for parent in (data_folder(), data_folder() / "features", corpora, *corpora.glob("*")):
            remove_leftovers(parent, ".")  # of `write_then_rename`
        # Linux keeps the semaphores of workers whose whole group was killed.
        _remove_dead(Path("/dev/shm"), r"sem\.loky-(\d{1,9})-.*")
        mine = tempfile.tempdir = tempfile.mkdtemp(prefix=owner_prefix(), dir=folder)
    try:
        yield
    finally:
        tempfile.tempdir = before
        if mine:
            shutil.rmtree(mine, ignore_errors=True)


@contextmanager
def write_then_rename(path: Path) -> Iterator[Path]:
    """Yield a path to write, which then replaces ``path``; the old file stays if that fails.

    An existing path that is no plain file, such as ``/dev/stdout``, is yielded itself.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    path = path.resolve()
    remove_leftovers(path.parent, ".")
    beside = path.with_name(f".{owner_prefix()}part{path.suffix}")
    try:
        yield beside
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


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
        remove_leftovers(out.parent, f".{out.name}.")
        beside = out.with_name(f".{out.name}.{owner_prefix()}new")
        yield beside
        beside.rename(out)
    except OSError as e:
        raise InputError(
            f"out={out}: cannot be written ({e.strerror or e}); choose another folder"
        ) from e


def owner_prefix() -> str:
    """First part of the names of this process's files, in folders that machines may share."""
    return f"{socket.gethostname()}-{os.getpid()}-"


def remove_leftovers(folder: Path, prefix: str = "") -> None:
    """Remove files that dead processes of this machine left: ``prefix``, then `owner_prefix`."""
    _remove_dead(folder, rf"{re.escape(prefix + socket.gethostname())}-(\d{{1,9}})-[^-]*")


def _remove_dead(folder: Path, pattern: str) -> None:
    """Remove entries whose name matches; the group of the pattern is the number of a process."""
    for path in folder.glob("*"):
        if (process := re.fullmatch(pattern, path.name)) and not _is_alive(int(process[1])):
            with suppress(OSError):  # removed already, or of another user
                remove_path(path)


def remove_path(path: Path) -> None:
    """Remove a file, a link, or a folder with its content."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink()


def _is_alive(process: int) -> bool:
    import psutil  # only if there is something to remove, as `bench --help` must be fast

    return psutil.pid_exists(process)
