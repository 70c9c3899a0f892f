"""Progress of a long fit: messages from its process to the waiting command, and the time left."""

from __future__ import annotations

import hashlib
import heapq
import json
import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

OFTEN_S = 0.3  # between two messages of one fit
SETTLE_S = 20.0  # in which a shown time left takes over most of a new estimate
console = Console(stderr=True)


def warn(line: str) -> None:
    """A line that a user should see."""
    console.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


class Message(NamedTuple):
    """The last words of a fold, or of another fit, that is under way.

    Attributes:
        run: key of the run that the fold is of; empty for a fit that is no fold.
        fold: name of the fold.
        words: progress so far; empty before the first message.
        left: expected seconds left, None if unknown.
        began: time of its beginning, of `time.time`.
        at: time of the message.
    """

    run: str
    fold: str
    words: str
    left: float | None
    began: float
    at: float


_under_way: list[tuple[Path, Message]] = []  # of this process: folder to write into, and last message; innermost last
_written = [float("-inf")]  # when, of `time.monotonic`


@contextmanager
def telling(folder: Path | None, fold: str = "", run: str = "") -> Iterator[None]:
    """Keep the last progress message in a folder, removed at the end; without a folder, nowhere."""
    if folder is None:
        yield
        return
    now = time.time()
    message = Message(run, fold, "", None, now, now)
    note(folder, message)
    _under_way.append((folder, message))
    _written[0] = float("-inf")
    try:
        yield
    finally:
        _under_way.pop()
        forget(folder, run, fold)


def tell(words: str, left: float | None = None) -> None:
    """Report progress in a few words, and the seconds left; frequent calls cost nothing."""
    now = time.monotonic()
    if _under_way and now - _written[0] >= OFTEN_S:
        _written[0] = now
        folder, message = _under_way[-1]
        note(folder, message._replace(words=words, left=left, at=time.time()))


def note(folder: Path, message: Message) -> None:
    """Write a message into a folder; it takes the place of the last one of the same fold."""
    path = _path(folder, message.run, message.fold)
    beside = path.with_name(f".{path.name}")
    with suppress(OSError):  # whoever waits may have gone
        beside.write_text(json.dumps(message), encoding="utf-8")
        os.replace(beside, path)


def forget(folder: Path, run: str, fold: str) -> None:
    """Remove the message of a fold that has ended."""
    with suppress(OSError):
        _path(folder, run, fold).unlink(missing_ok=True)


def messages(folder: Path) -> list[Message]:
    """The last message of each fold that is under way, in the order of runs and folds."""
    spoken = []
    for path in folder.glob("[!.]*"):
        with suppress(OSError):
            spoken.append(Message(*json.loads(path.read_text(encoding="utf-8"))))
    return sorted(spoken, key=lambda message: message[:2])


def _path(folder: Path, run: str, fold: str) -> Path:
    """A name may be a path, or anything else."""
    return folder / hashlib.sha256(json.dumps([run, fold]).encode()).hexdigest()


def seconds_left(
    spent: Sequence[float], running: Sequence[tuple[float, float | None]], waiting: int, workers: int
) -> float | None:
    """Seconds until all folds are done, None before the first one is done.

    A fold takes the mean time of finished folds, or the time that it reports itself. A running fold that exceeds the
    mean counts in it with the seconds so far, and is taken to need a tenth of the mean still: so the estimate grows
    while the fold runs and does not jump at its end. Folds that wait go to the first free worker.

    Args:
        spent: seconds of folds that are done.
        running: seconds so far of each fold under way, and seconds left, None if unknown.
        waiting: number of folds that nobody has begun.
        workers: number of workers, each doing one fold at a time.
    """
    if not spent:
        return None
    usual = sum(spent) / len(spent)
    durations = [*spent, *(elapsed for elapsed, left in running if left is None and elapsed > usual)]
    usual = sum(durations) / len(durations)
    busy = [max(usual - elapsed, usual / 10) if left is None else max(left, 0.0) for elapsed, left in running]
    free = [0.0] * max(workers - len(busy), 0) + busy
    heapq.heapify(free)
    for _ in range(waiting):
        heapq.heappush(free, heapq.heappop(free) + usual)
    return max(free, default=0.0)


def smoothed(shown: float | None, estimate: float, seconds: float) -> float:
    """The time left to show: the one shown before counts down, and approaches the estimate within `SETTLE_S`.

    Args:
        shown: seconds left that were shown; None at first.
        estimate: seconds left by now.
        seconds: time since it was shown.
    """
    if shown is None:
        return estimate
    return estimate + (max(shown - seconds, 0.0) - estimate) * math.exp(-seconds / SETTLE_S)


def about(seconds: float) -> str:
    """An estimate in words, no finer than it is known: less than 10 s, about 3 min, about 1 h 20 min."""
    if seconds < 10:
        return "less than 10 s"
    step = 10 if seconds < 55 else 60 if seconds < 570 else 300 if seconds < 3450 else 600
    words = span(step * round(seconds / step))
    return f"about {words.removesuffix(' 0 s').removesuffix(' 0 min')}"


def span(seconds: float) -> str:
    """Seconds in words: 8 s, 3 min 20 s, 2 h 5 min."""
    minutes, rest = divmod(max(0, round(seconds)), 60)
    if not minutes:
        return f"{rest} s"
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
