"""The side of the worker (`bench.on_cluster.cluster`): a dask worker has folds done one at a time, by another process.

The worker itself only waits. So a fold that dies takes no worker with it, the fold of a command that is gone can be
ended, and each command has a process that has imported the code that is there now.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import pickle
import tempfile
import threading
import time
from concurrent.futures import TimeoutError as NotYet
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.progress import Message, messages
from bench.work.pool import pool

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from bench.plan.cells import Cell, Part

OFTEN_S = 0.2  # between two looks whether a fold is still wanted
_one = threading.Lock()  # a worker has one fold done at a time, whatever the number of its threads
_served: set[str] = set()  # commands that this worker's process was begun for, or that began later
_same: set[bytes] = set()  # of the process: checks that it has passed
_filled: set[str] = set()  # of the process: systems whose features are kept


def answer(command: str, threads: int, check: bytes, fold: bytes) -> tuple[str, str, bytes]:
    """Run a fold in this worker's process, unless its command is gone; called by dask.

    Python keeps the code that it has imported, so a process does nothing for a command that is younger than itself:
    another takes its place.

    Args:
        command: name of the one that asks, and of dask's topic for how far the fold is.
        threads: threads of the process.
        check: result of `check_of`.
        fold: pickled arguments of `fold_here`; empty for a check only.

    Returns:
        The address of this worker, why it cannot be used if that is so, and the pickled result.

    Raises:
        RuntimeError: the process has died.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()
    multiprocessing.current_process().daemon = False  # that of a nanny is one, which may have no process of its own
    with _one, tempfile.TemporaryDirectory() as folder:
        if _served and command not in _served:
            pool(1, threads).shutdown(wait=True, kill_workers=True)
        _served.add(command)
        passed_on: set[Message] = set()
        answered = pool(1, threads).submit(fold_here, check, fold, folder)
        while True:
            try:
                return worker.address, *answered.result(timeout=OFTEN_S)
            except BrokenProcessPool:
                raise RuntimeError("The worker process died twice; out of memory?") from None
            except NotYet:
                now = time.time()
                for message in {*messages(Path(folder))} - passed_on:  # times that need no common clock
                    passed_on.add(message)
                    worker.log_event(command, [*message[:4], now - message.began, now - message.at])
            # dask lets a task run on that was cancelled, or whose command is gone.
            task = worker.state.tasks.get(key)
            going = worker.status.name in ("closing", "closed", "failed")
            if going or task is None or task.state in ("cancelled", "released", "forgotten"):
                pool(1, threads).shutdown(wait=True, kill_workers=True)
                return worker.address, "", b""


def fold_here(check: bytes, fold: bytes, folder: str) -> tuple[str, bytes]:
    """The reason why this machine cannot be used, if any, and the pickled fold result with the machine's properties."""
    import cloudpickle

    from bench.machine import this_machine
    from bench.work.workers import do_fold, fill_cache

    try:
        if check not in _same:
            if refusal := difference(*pickle.loads(check)):
                return refusal, b""
            _same.add(check)
        if not fold:
            return "", b""
        cell, corpus, split, threads, key = pickle.loads(fold)
    except Exception as e:  # a file that is not there, or whatever a user's object raises when it is unpickled
        return " ".join(f"{e}".split()) or type(e).__name__, b""
    parts = repr((cell.features, cell.model, cell.tuning, corpus.digest))
    if parts not in _filled:
        fill_cache(cell, corpus)
        _filled.add(parts)
    result = do_fold(cell, corpus, split, threads, key, Path(folder))
    return "", cloudpickle.dumps((result, this_machine()))


def packed(*values: object) -> bytes:
    """Values as they travel; dask's own workers do not open them.

    Raises:
        InputError: an object of the user's cannot be pickled.
    """
    import cloudpickle

    from bench.errors import InputError

    try:
        return cloudpickle.dumps(values)
    except (TypeError, AttributeError, pickle.PicklingError) as e:
        raise InputError(f"cluster=: what is run cannot be sent to a worker ({e}); leave cluster= out") from e


def check_of(cells: Iterable[Cell]) -> bytes:
    """Requirements for a machine to give the results of this one, pickled: `difference` takes it."""
    kinds: dict[str, Cell] = {}
    for cell in cells:
        parts = [(p.room, p.name, id(p.instance)) for p in cell.parts]
        kinds.setdefault(repr((cell.data, cell.data_parameters, cell.where, cell.target, parts)), cell)
    return packed(facts([]), facts([*kinds.values()]), packed(*kinds.values()))


def facts(cells: Sequence[Cell]) -> dict[str, str]:
    """Properties of this machine: versions, touchbench's code, and of cells corpora and code, by name.

    Raises:
        InputError: a corpus or a part of a cell is not there.
    """
    from bench.plan.plan import corpus_of
    from bench.registry import place_of
    from bench.source import versions

    code = hashlib.sha256()
    for package in ("bench", "bench.features", "bench.models", "bench.protocols"):
        for path in sorted(place_of(package).rglob("*.py")):
            code.update(path.relative_to(place_of(package)).as_posix().encode() + path.read_bytes())
    values = versions() | {"touchbench's code": code.hexdigest()[:12]}
    for cell in cells:
        values |= versions(cell.packages())
        values[f"the captures of {cell.title()}"] = corpus_of(cell).digest[:12]
        values |= {f"the code of {p.name}": _code_of(p) for p in cell.parts}
    return values


def _code_of(part: Part[Any]) -> str:
    """Digest of a part's code; of what was typed into a script or a notebook none, as it travels itself."""
    from bench import contract
    from bench.source import source_digest

    typed = part.instance is not None and any(c.__module__ == "__main__" for c in contract.classes(part.instance))
    return "" if typed else source_digest(*part.code())[:12]


def difference(base: dict[str, str], here: dict[str, str], cells: bytes) -> str:
    """The first thing that makes this machine's results others than those of the command's; empty if there is none.

    Args:
        base: versions and touchbench's code on the command's machine; under others, the cells may not be understood.
        here: all that it has.
        cells: cells of the command, pickled.

    Raises:
        InputError: a corpus or a part of a cell is not there.
    """
    there = facts([])
    if there == base:
        there = facts(pickle.loads(cells))
    for name, value in here.items():
        if there.get(name) != value:
            return f"it has {name} {there.get(name, 'not at all')}, this machine {value}"
    return ""
