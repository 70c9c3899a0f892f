"""Files of the data folder: written at once or not at all, read within bounds, cleared away after a kill.

As `bench.corpora.folder`, this changes no number; only what finds and keeps things may import it.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from pathlib import Path

from bench.scratch import owner, sweep


class Damaged(Exception):
    """What is wrong with a folder, in a few words."""


def small_file(path: Path, expected: tuple[int, str] | None = None, most: int = 1 << 24) -> bytes:
    """The bytes of a file: at most so many, or those of a known size and SHA-256.

    Raises:
        Damaged: there is no such file.
    """
    size = stamp(path)[0]
    if size != expected[0] if expected else size > most:
        raise Damaged(f"{path.name} has {size} bytes")
    try:
        content = path.read_bytes()
    except OSError as e:
        raise Damaged(f"{path.name} cannot be read") from e
    if expected and hashlib.sha256(content).hexdigest() != expected[1]:
        raise Damaged(f"{path.name} differs from what was stored")
    return content


def stamp(path: Path) -> tuple[int, ...]:
    """What changes when a file does: size, times (that of its entry cannot be set back) and inode."""
    try:
        found = path.stat()
    except OSError as e:
        raise Damaged(f"{path.name} is not there") from e
    if not stat.S_ISREG(found.st_mode):  # a pipe would wait for ever
        raise Damaged(f"{path.name} is no file")
    return found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino


def sha256_of(path: Path) -> tuple[int, str]:
    """Size and hash of a file."""
    size = stamp(path)[0]
    try:
        with path.open("rb") as file:
            return size, hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as e:
        raise Damaged(f"{path.name} cannot be read") from e


def compare(path: Path, size: int, sha256: str) -> None:
    """Read a file of any size to see whether it is one of this size and hash; another size tells without reading.

    Raises:
        Damaged: it is not.
    """
    found = stamp(path)[0]
    if found != size:
        raise Damaged(f"{path.name} has {found} bytes")
    if sha256_of(path)[1] != sha256:
        raise Damaged(f"{path.name} differs from what was stored")


def write_text(path: Path, text: str) -> None:
    """Write a small file at once or not at all."""
    handle, beside = tempfile.mkstemp(prefix=f".{owner()}", dir=path.parent)
    try:
        with os.fdopen(handle, "w") as file:
            file.write(text)
        os.replace(beside, path)
    except OSError:
        Path(beside).unlink(missing_ok=True)
        raise


def clear(folder: Path) -> None:
    """Remove what killed processes of this machine have left here: hidden entries named by `bench.scratch.owner`."""
    sweep(folder, ".")


def short(folder: Path) -> str:
    """The path of a folder, as much of it as fits into a line."""
    return str(folder) if len(str(folder)) <= 150 else f"...{str(folder)[-147:]}"
