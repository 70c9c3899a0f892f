"""How far a long fit is, told by whichever process fits to the command that waits for it."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

OFTEN_S = 0.3

_told: dict[str, Path | float] = {}  # of this process: the file to write, and when it was written


@contextmanager
def telling(path: Path | None) -> Iterator[None]:
    """What is told in between goes into a file, which is gone at last; nowhere without one."""
    if path is not None:
        _told.update(path=path, at=float("-inf"))
    try:
        yield
    finally:
        _told.clear()
        if path is not None:
            with suppress(OSError):
                path.unlink(missing_ok=True)


def tell(words: str) -> None:
    """Say in a few words how far a fit is; too often costs nothing."""
    now = time.monotonic()
    path, at = _told.get("path"), _told.get("at")
    if isinstance(path, Path) and isinstance(at, float) and now - at >= OFTEN_S:
        _told["at"] = now
        beside = path.with_name(f".{path.name}")
        with suppress(OSError):  # whoever waits may have gone
            beside.write_text(words, encoding="utf-8")
            os.replace(beside, path)


def told(folder: Path) -> dict[str, str]:
    """What those that are fitting said last, by the names of their files."""
    found = {}
    for path in sorted(folder.glob("[!.]*")):
        with suppress(OSError):
            found[path.name] = path.read_text(encoding="utf-8")
    return found
