"""The user's data folder, and temporary folders there that the next command clears away if this one is killed."""

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
    """The user's data folder: imported corpora and cached features (``TOUCHBENCH_HOME`` overrides)."""
    if override := os.environ.get("TOUCHBENCH_HOME"):
        return Path(override)
    from platformdirs import user_data_path

    return user_data_path("touchbench")


@contextmanager
def use_scratch_folder() -> Iterator[None]:
    """Put all that Python's ``tempfile`` makes into a folder of this process; it and those of dead processes go.

    Where the data folder cannot be written, temporary files lie where they always do.
    """
    folder, before, mine = data_folder() / "tmp", tempfile.tempdir, None
    with suppress(OSError):  # nothing was asked of the folder yet; what needs it says so itself
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
        for stored in (
            data_folder(),
            data_folder() / "features",
            data_folder() / "corpora",
            *(data_folder() / "corpora").glob("*"),
        ):
            remove_leftovers(stored, ".")  # written beside their names
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

    What is there and no plain file, such as ``/dev/stdout``, is written to as it is.
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
    """A folder that is new or empty."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"out={out}: this place is not empty; name a new or empty folder")
    return out


@contextmanager
def fill_then_rename(out: Path) -> Iterator[Path]:
    """Yield a folder to fill, which then takes its name: a kill leaves none or a whole one."""
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
    """Name prefix of this process's files in a folder shared with other machines."""
    return f"{socket.gethostname()}-{os.getpid()}-"


def remove_leftovers(folder: Path, before: str = "") -> None:
    """Remove what dead processes of this machine left: entries named as `owner_prefix` does, behind some text."""
    _remove_dead(folder, rf"{re.escape(before + socket.gethostname())}-(\d{{1,9}})-[^-]*")


def _remove_dead(folder: Path, name: str) -> None:
    """Remove the entries whose names fit a pattern with the number of a dead process as its group."""
    for path in folder.glob("*"):
        if (process := re.fullmatch(name, path.name)) and not _is_alive(int(process[1])):
            with suppress(OSError):  # it is gone already, or somebody else's
                remove_path(path)


def remove_path(path: Path) -> None:
    """Remove a file, a link, or a folder with all that is in it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink()


def _is_alive(process: int) -> bool:
    import psutil  # not before there is something to remove: `bench --help` is to be fast

    return psutil.pid_exists(process)
