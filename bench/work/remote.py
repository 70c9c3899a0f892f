"""What a dask worker does for `bench.work.cluster`: it has folds done by a process of its own, and takes corpora.

The worker itself only waits. So libraries may hold Python's lock for as long as they like, a fold that dies takes no
worker with it, and one that nobody waits for any longer can be ended. What is heavy is imported in that process.
"""

from __future__ import annotations

import multiprocessing
import pickle
import shutil
import socket
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
from bench.work.pool import pool

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bench.corpora.corpus import Corpus
    from bench.corpora.folder import Address
    from bench.outcomes.results import FoldResult
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold
    from bench.progress import Said
    from bench.work.experiment import Experiment
    from bench.work.machine import Machine
    from bench.work.pool import Executor

OFTEN_S = 0.2  # between two looks whether a fold is still wanted
LOCK_S = 600.0  # that a fold waits for another that computes the same features
_one = threading.Lock()  # a worker has one thing done at a time, whatever the number of its threads
_told: list[Path] = []  # of this process: the folder where its fold says how far it is
_filled: set[str] = set()  # of this process: whose features are kept


class Answer(NamedTuple):
    """What became of something that was asked.

    Attributes:
        status: ``done``, ``raised``, ``died`` (the process), ``late`` or ``unwanted``.
        content: the pickled result of what is done, the traceback of what has raised.
    """

    status: str
    content: bytes = b""


class Facts(NamedTuple):
    """What tells a machine that gives the same results from one that does not.

    Attributes:
        versions: of Python and the packages that results depend on.
        code: what each system computes, as a digest.
        wrong: why a system cannot be had there, empty for one that can.
        lacks: digests of the corpora that are not there.
        host: name of the machine.
        home: its data folder.
    """

    versions: dict[str, str]
    code: list[str]
    wrong: list[str]
    lacks: list[str]
    host: str
    home: str


def answer(question: bytes, threads: int, limit: float | None, topic: str) -> Answer:
    """Have a pickled function with its arguments called in this worker's process, unless nobody waits for it.

    Args:
        question: of `answered`.
        threads: that the process computes with.
        limit: seconds that it may take; None for as long as it takes.
        topic: of dask's events, under which is said how far it is (`bench.progress`); empty for none.
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
        process = pool(1, threads)
        with tempfile.TemporaryDirectory() as folder:

            def listen() -> None:
                if topic:
                    report(Path(folder), heard, lambda said: worker.log_event(topic, said))

            heard: dict[tuple[str, str], Said] = {}
            return watched(process, process.submit(answered, question, folder), wanted, limit, listen)
    except BrokenProcessPool:  # while it was idle
        return Answer("died")
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
    listen: Callable[[], None] = lambda: None,
) -> Answer:
    """Wait for an answer while it is wanted, and no longer than a limit; then the process is ended."""
    begun = time.monotonic()
    while True:
        try:
            found = asked.result(timeout=OFTEN_S)
            listen()
            return found
        except NotYet:
            listen()
            late = limit is not None and time.monotonic() - begun > limit
        except BrokenProcessPool:
            return Answer("died")
        if late or not wanted():
            process.shutdown(wait=True, kill_workers=True)
            return Answer("late" if late else "unwanted")


def answered(question: bytes, told: str) -> Answer:
    """Call a pickled function with its arguments, in the process of a worker; a fold tells a folder how far it is."""
    import cloudpickle

    _told[:] = [Path(told)]
    try:
        function, arguments = pickle.loads(question)
        return Answer("done", cloudpickle.dumps(function(*arguments)))
    except Exception:
        return Answer("raised", traceback.format_exc().encode())


def facts(cells: Sequence[Cell], experiments: Sequence[Experiment], corpora: Sequence[Address]) -> Facts:
    """What a machine has for a command.

    Args:
        cells: one of each kind that it runs.
        experiments: their kinds of run.
        corpora: that it needs.
    """
    from bench.errors import InputError
    from bench.source import versions

    found, code, wrong, lacks = versions(), [], [], []
    for cell, experiment in zip(cells, experiments, strict=True):
        digest = why = ""
        try:
            found |= versions(cell.packages())
            digest = digest_of(cell, experiment)
        except (InputError, ImportError, OSError) as e:
            why = str(e)
        code.append(digest)
        wrong.append(why)
    for address in corpora:
        try:
            address.open()
        except InputError:
            lacks.append(address.digest)
    return Facts(found, code, wrong, lacks, socket.gethostname(), str(home().absolute()))


def digest_of(cell: Cell, experiment: Experiment) -> str:
    """Hash of what a run of a cell computes; classes that were typed in travel with the cell and count for nothing."""
    import hashlib
    import json

    from bench.source import source_digest
    from models import contract

    same = cell.identity()
    del same["versions"]  # which are told apart by name
    given = [p.given for p in (cell.protocol, cell.features, cell.model) if p is not None and p.given is not None]
    if any(kind.__module__ == "__main__" for one in given for kind in contract.classes(one)):
        del same["parts"]
    code = [same, source_digest(*experiment.depends())]
    return hashlib.sha256(json.dumps(code, sort_keys=True, default=str).encode()).hexdigest()


def fold(experiment: Experiment, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> tuple[FoldResult, Machine]:
    """One fold, after features that need no learning were computed once for all processes of this machine."""
    import hashlib

    from filelock import FileLock, Timeout

    from bench.outcomes.store import lock_folder
    from bench.work.machine import this_machine
    from bench.work.workers import do_fold, fill_cache

    parts = repr((cell.features, cell.model, cell.tuning, corpus.digest))
    key = hashlib.sha256(parts.encode()).hexdigest()[:20]
    if key not in _filled:
        try:
            with FileLock(lock_folder() / f"features-{key}.lock", timeout=LOCK_S):
                fill_cache(cell, corpus)
        except Timeout:  # the fold computes them itself
            pass
        _filled.add(key)
    return do_fold(experiment, cell, corpus, fold, threads, *_told), this_machine()


def receive(token: str, name: str, content: bytes) -> str:
    """Add to a file of a corpus that is being sent to this machine; the folder that it comes into.

    Raises:
        InputError: a corpus has no such file.
    """
    from bench.corpora.folder import FILES
    from bench.errors import InputError

    if name not in ("corpus.json", *FILES) or not token.isalnum():
        raise InputError(f"{name}: no file of a corpus")
    folder = home() / "corpora" / f".{owner()}{token}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / name).open("ab") as file:
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
