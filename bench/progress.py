"""How far a long fit is, told by whichever process fits to the command that waits for it."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

OFTEN_S = 0.3

_listener: list[tuple[Path, str]] = []  # of this process: the file to write, and the name of what is told; the last
_at = [float("-inf")]  # when it was written


@contextmanager
def telling(folder: Path | None, name: str = "") -> Iterator[None]:
    """What is told in between goes into a file of a folder under a name, and is gone at last; nowhere without one."""
    if folder is None:
        yield
        return
    path = folder / hashlib.sha256(name.encode()).hexdigest()  # a name may be a path, or anything else
    _listener.append((path, name))
    _at[0] = float("-inf")
    try:
        yield
    finally:
        _listener.pop()
        with suppress(OSError):
            path.unlink(missing_ok=True)


class Said(NamedTuple):
    """What a fit says of itself.

    Attributes:
        words: how far it is.
        left: seconds that it expects to need still, None if it cannot know.
        at: when it said so, of `time.time`.
    """

    words: str
    left: float | None
    at: float


def tell(words: str, left: float | None = None) -> None:
    """Say in a few words how far a fit is, and in seconds how long it takes still; too often costs nothing."""
    now = time.monotonic()
    if _listener and now - _at[0] >= OFTEN_S:
        _at[0] = now
        path, name = _listener[-1]
        beside = path.with_name(f".{path.name}")
        with suppress(OSError):  # whoever waits may have gone
            beside.write_text(json.dumps([name, Said(words, left, time.time())]), encoding="utf-8")
            os.replace(beside, path)


def told(folder: Path) -> dict[str, Said]:
    """What those that are fitting said last, by name."""
    found = {}
    for path in folder.glob("[!.]*"):
        with suppress(OSError):
            name, said = json.loads(path.read_text(encoding="utf-8"))
            found[name] = Said(*said)
    return dict(sorted(found.items()))


def span(seconds: float) -> str:
    """Seconds as people say them: 8 s, 3 min 20 s, 2 h 5 min."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
