"""How far a long fit is, told by whichever process fits to the command that waits for it, and how long that will be."""

from __future__ import annotations

import hashlib
import heapq
import json
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

OFTEN_S = 0.3
console = Console(stderr=True)


def warn(line: str) -> None:
    """A line that a user should see."""
    console.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


class Said(NamedTuple):
    """What a fit says of itself.

    Attributes:
        of: what it is a fold of, in words; empty for what is no fold.
        name: of the fold.
        words: how far it is; empty before it has said anything.
        left: seconds that it expects to need still, None if it cannot know.
        began: when it began, of `time.time`.
        at: when it said so.
    """

    of: str
    name: str
    words: str
    left: float | None
    began: float
    at: float


_listener: list[tuple[Path, Said]] = []  # of this process: folder to write into, and who tells; the last is heard
_at = [float("-inf")]  # when it was written


@contextmanager
def telling(folder: Path | None, name: str = "", of: str = "") -> Iterator[None]:
    """What is told in between goes into a file of a folder under these names, gone at last; nowhere without one."""
    if folder is None:
        yield
        return
    now = time.time()
    said = Said(of, name, "", None, now, now)
    note(folder, said)
    _listener.append((folder, said))
    _at[0] = float("-inf")
    try:
        yield
    finally:
        _listener.pop()
        forget(folder, of, name)


def tell(words: str, left: float | None = None) -> None:
    """Say in a few words how far a fit is, and in seconds how long it takes still; too often costs nothing."""
    now = time.monotonic()
    if _listener and now - _at[0] >= OFTEN_S:
        _at[0] = now
        folder, said = _listener[-1]
        note(folder, said._replace(words=words, left=left, at=time.time()))


def note(folder: Path, said: Said) -> None:
    """Write into a folder what somebody says."""
    path = _path(folder, said.of, said.name)
    beside = path.with_name(f".{path.name}")
    with suppress(OSError):  # whoever waits may have gone
        beside.write_text(json.dumps(said), encoding="utf-8")
        os.replace(beside, path)


def forget(folder: Path, of: str, name: str) -> None:
    """Take away from a folder what somebody said."""
    with suppress(OSError):
        _path(folder, of, name).unlink(missing_ok=True)


def _path(folder: Path, of: str, name: str) -> Path:
    """A name may be a path, or anything else."""
    return folder / hashlib.sha256(json.dumps([of, name]).encode()).hexdigest()


def told(folder: Path) -> list[Said]:
    """What those that are fitting said last, in the order of their names."""
    found = []
    for path in folder.glob("[!.]*"):
        with suppress(OSError):
            found.append(Said(*json.loads(path.read_text(encoding="utf-8"))))
    return sorted(found, key=lambda said: (said.of, said.name))


def seconds_left(
    spent: Sequence[float], running: Sequence[tuple[float, float | None]], waiting: int, workers: int
) -> float | None:
    """Seconds until all folds are done, None before anything is known.

    A fold takes as long as those that are done took in the mean, or as it says itself; one that has taken longer
    already is taken to need a tenth of that still. Folds that wait go to whoever is free first.

    Args:
        spent: seconds of folds that are done.
        running: of the others that are under way, seconds so far, and seconds left if they say so.
        waiting: number of folds that nobody has begun.
        workers: that do them, each one at a time.
    """
    known = [*spent, *(elapsed + left for elapsed, left in running if left is not None)]
    if not known:
        return None
    usual = sum(known) / len(known)
    busy = [max(usual - elapsed, usual / 10) if left is None else max(left, 0.0) for elapsed, left in running]
    free = [0.0] * max(workers - len(busy), 0) + busy
    heapq.heapify(free)
    for _ in range(waiting):
        heapq.heappush(free, heapq.heappop(free) + usual)
    return max(free, default=0.0)


def span(seconds: float) -> str:
    """Seconds as people say them: 8 s, 3 min 20 s, 2 h 5 min."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
