"""What a dask worker does for `bench.work.cluster`: it has folds done by a process of its own, and takes corpora.

The worker itself only waits. So libraries may hold Python's lock for as long as they like, a fold that dies takes no
worker with it, and one that nobody waits for any longer can be ended. What is heavy is imported in that process.
"""

from __future__ import annotations

import multiprocessing
import pickle
import shutil
import tempfile
import threading
import time
import traceback
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench.scratch import home, owner
from bench.work.alike import facts
from bench.work.pool import pool

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bench.corpora.corpus import Corpus
    from bench.corpora.folder import Address
    from bench.outcomes.results import FoldResult
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold
    from bench.progress import Said
    from bench.work.alike import Facts
    from bench.work.experiment import Experiment
    from bench.work.machine import Machine
    from bench.work.pool import Executor

OFTEN_S = 0.2  # between two looks whether a fold is still wanted
READY_S = 600.0  # that a fold may take to begin: libraries, and another that computes the same features
TOPIC = "touchbench"  # of dask's events, under which workers say how far their folds are
OLD_S = 3600.0  # after which nobody sends the rest of a corpus
_one = threading.Lock()  # a worker has one thing done at a time, whatever the number of its threads
_served: set[str] = set()  # commands that this worker's process was begun for, or that began later
_examined: set[str] = set()  # of this process: commands that know what it has
_told: list[Path] = []  # of this process: the folder where its fold says how far it is
_filled: set[str] = set()  # of this process: whose features are kept


class Answer(NamedTuple):
    """What became of something that was asked.

    Attributes:
        status: ``done``, ``raised``, ``died`` (the process), ``late``, ``unwanted``, or ``unknown``: of a process that
            the command has not examined.
        content: the pickled result of what is done, the traceback of what has raised, empty if a late fold never began.
    """

    status: str
    content: bytes = b""


class Unknown(Exception):
    """A fold was asked of a process that its command has not examined."""


def answer(question: bytes, command: str, threads: int, limit: float | None = None) -> Answer:
    """Have a pickled function with its arguments called in this worker's process, unless nobody waits for it.

    Python keeps the code that it has imported, so a process does nothing for a command that is younger than itself:
    another takes its place.

    Args:
        question: of `answered`.
        command: name of the one that asks.
        threads: that the process computes with.
        limit: seconds that a fold may take once it has begun; None for as long as it takes.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()
    multiprocessing.current_process().daemon = False  # that of a nanny is one, which may have no process of its own

    def wanted() -> bool:
        """Nobody waits for a task that was cancelled, or of a command that is gone; dask lets it run on."""
        task = worker.state.tasks.get(key)
        going = worker.status.name in ("closing", "closed", "failed")
        return task is not None and task.state not in ("cancelled", "released", "forgotten") and not going

    while not _one.acquire(timeout=OFTEN_S):
        if not wanted():
            return Answer("unwanted")
    try:
        if _served and command not in _served:
            pool(1, threads).shutdown(wait=True, kill_workers=True)
        _served.add(command)
        with tempfile.TemporaryDirectory() as folder:

            def listen() -> float | None:
                report(Path(folder), heard, lambda said: worker.log_event(TOPIC, [command, worker.address, *said]))
                return min((said.began for said in heard.values()), default=None)

            heard: dict[tuple[str, str], Said] = {}
            try:
                process = pool(1, threads)
                asked = process.submit(answered, question, folder)
            except RuntimeError:  # it ended while it was idle
                process = pool(1, threads)
                asked = process.submit(answered, question, folder)
            return watched(process, asked, wanted, limit, listen)
    finally:
        _one.release()


def report(folder: Path, heard: dict[tuple[str, str], Said], say: Callable[[list], None]) -> None:
    """Pass on what is new in a folder of `bench.progress`, with times that need no common clock.

    Args:
        folder: where a fold says how far it is.
        heard: what was passed on before, by names; brought up to date.
        say: is given names, words, seconds left, since the fold began and since it said so; or only the names of one
            that says nothing any longer.
    """
    from bench.progress import told

    now = time.time()
    there = {(said.of, said.name): said for said in told(folder)}
    for names, said in there.items():
        if heard.get(names) != said:
            say([*names, said.words, said.left, now - said.began, now - said.at])
    for names in [names for names in heard if names not in there]:
        say([*names])
    heard.clear()
    heard.update(there)


def watched(
    process: Executor,
    asked: Future[Answer],
    wanted: Callable[[], bool],
    limit: float | None,
    listen: Callable[[], float | None],
) -> Answer:
    """Wait for an answer while it is wanted, and no longer than a limit; then the process is ended.

    Args:
        process: that answers.
        asked: what it will answer.
        wanted: whether anybody waits for it.
        limit: seconds from its beginning, for which `READY_S` are given; None for as long as it takes.
        listen: passes on what it says, and tells when it began, of `time.time`; None as long as it has not.
    """
    given = time.time()
    while True:
        try:
            return asked.result(timeout=OFTEN_S)
        except NotYet:
            began = listen()
            until = given + READY_S if began is None else began
            late = limit is not None and time.time() - until > limit
        except BrokenProcessPool:
            return Answer("died")
        if late or not wanted():
            process.shutdown(wait=True, kill_workers=True)
            return Answer("late", b"" if began is None else b"begun") if late else Answer("unwanted")


def answered(question: bytes, told: str) -> Answer:
    """Call a pickled function with its arguments, in the process of a worker; a fold tells a folder how far it is."""
    import cloudpickle

    _told[:] = [Path(told)]
    try:
        function, arguments = pickle.loads(question)
        return Answer("done", cloudpickle.dumps(function(*arguments)))
    except Unknown:
        return Answer("unknown")
    except BaseException:  # one that ends a process would end the worker, which raises it again
        return Answer("raised", traceback.format_exc().encode())


def examined(
    command: str, cells: Sequence[Cell], experiments: Sequence[Experiment], corpora: Sequence[Address]
) -> Facts:
    """What this machine has for a command, which may then ask this process for folds."""
    found = facts(cells, experiments, corpora)
    _examined.add(command)
    return found


def fold(
    command: str, experiment: Experiment, cell: Cell, corpus: Corpus, fold: Fold, threads: int, key: str
) -> tuple[FoldResult, Machine]:
    """One fold, after features that need no learning were computed once for all processes of this machine.

    Raises:
        Unknown: this process is not the one that the command has examined.
    """
    if command not in _examined:
        raise Unknown
    import hashlib

    from filelock import FileLock, Timeout

    from bench.outcomes.store import lock_folder
    from bench.work.machine import this_machine
    from bench.work.workers import do_fold, fill_cache

    parts = repr((cell.features, cell.model, cell.tuning, corpus.digest))
    features = hashlib.sha256(parts.encode()).hexdigest()[:20]
    if features not in _filled:
        try:
            with FileLock(lock_folder() / f"features-{features}.lock", timeout=READY_S / 2):
                fill_cache(cell, corpus)
        except Timeout:  # the fold computes them itself
            pass
        _filled.add(features)
    return do_fold(experiment, cell, corpus, fold, threads, key, *_told), this_machine()


def receive(token: str, name: str, place: int, content: bytes) -> str:
    """Take a piece of a file of a corpus that is being sent to this machine; the folder that it comes into.

    Raises:
        InputError: a corpus has no such file.
    """
    from bench.corpora.folder import FILES
    from bench.errors import InputError

    if name not in ("corpus.json", *FILES) or not token.isalnum():
        raise InputError(f"{name}: no file of a corpus")
    folder = home() / "corpora" / f".{owner()}{token}"
    if not folder.exists():
        for left in folder.parent.glob(f".{owner()}*"):  # by a command that was cut off
            if time.time() - max(path.stat().st_mtime for path in (left, *left.iterdir())) > OLD_S:
                shutil.rmtree(left, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).touch()
    with (folder / name).open("r+b") as file:  # dask may do this twice
        file.seek(place)
        file.write(content)
    return str(folder)


def adopt(folder: str, digest: str) -> None:
    """Store a corpus that was sent, if it has the content of its digest.

    Raises:
        InputError: it has not.
    """
    from bench.corpora.folder import content_digest, open_folder, sent, write_folder
    from bench.errors import InputError

    try:
        corpus = open_folder(Path(folder))
        if content_digest(corpus) != digest:
            raise InputError("what was sent is another corpus")
        write_folder(corpus, sent(digest), digest)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
