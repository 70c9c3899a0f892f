"""Runs the folds of a cell in worker processes and hands each result over as soon as it is there."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

import numpy as np
from joblib.externals.loky import get_reusable_executor

from bench.cells import Cell
from bench.corpus import Corpus, InputError
from bench.fold import FoldResult, run_fold


@dataclass(frozen=True)
class Fold:
    """One split of the captures of a corpus, by position."""

    name: str
    train: np.ndarray
    test: np.ndarray


def folds_of(cell: Cell, corpus: Corpus) -> list[Fold]:
    """All folds of a protocol, named after the tested subject where there is just one.

    Raises:
        InputError: the protocol cannot split this corpus, or a fold tests a class that it does not train.
    """
    gestures, subjects = corpus.gestures, corpus.subjects
    if len(set(gestures)) < 2:
        raise InputError(
            f"data={cell.data} where={cell.where!r}: only one {corpus.target} is left, nothing to tell apart"
        )
    found: list[Fold] = []
    protocol = cell.protocol.make()
    for train, test in protocol.split(corpus, gestures, subjects):
        tested = set(subjects[test])
        name = tested.pop() if len(tested) == 1 and not protocol.mixes_subjects else f"fold{len(found) + 1:02d}"
        if lacking := sorted(set(gestures[test]) - set(gestures[train])):
            leave = "" if "+" in corpus.target else f"leave it out with where=\"{corpus.target} != '{lacking[0]}'\" or "
            raise InputError(
                f"protocol={cell.protocol}: fold {name} tests {corpus.target} {lacking[0]} and trains none of it; "
                f"{leave}choose another protocol"
            )
        found.append(Fold(name, train, test))
    if len({fold.name for fold in found}) < len(found):  # random splits may test the same subject twice
        found = [Fold(f"fold{i:02d}", fold.train, fold.test) for i, fold in enumerate(found, 1)]
    return found


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_cores(jobs: int | None, folds: int) -> tuple[int, int]:
    """Worker processes and threads in each, so that their product fits the cores.

    Raises:
        InputError: ``jobs`` is less than 1.
    """
    cores = usable_cores()
    if jobs is not None and jobs < 1:
        raise InputError(f"jobs={jobs}: give at least 1, or leave it out for {cores} (the cores of this machine)")
    jobs = min(jobs or cores, folds, cores)
    return jobs, max(1, cores // jobs)


def run_folds(
    cell: Cell, corpus: Corpus, folds: list[Fold], jobs: int, threads: int, work: Callable[..., FoldResult] = run_fold
) -> Iterator[FoldResult]:
    """Results in the order in which folds finish; every fold gives one, a crashed worker a failed one.

    Args:
        cell: what is run.
        corpus: the captures that the folds are of.
        folds: those to run.
        jobs: worker processes.
        threads: in each of them.
        work: what a worker does with a fold, called as `run_fold` is.
    """
    executor = _workers(jobs, threads)
    waiting, running = list(folds), {}
    try:
        try:
            while waiting or running:
                # One more than can run, so that no worker waits while a result is tracked; all of them at once is what
                # loky stumbles over when it is killed.
                while waiting and len(running) <= jobs:
                    fold = waiting[0]
                    task = executor.submit(work, cell, corpus, fold.name, fold.train, fold.test, threads)
                    running[task] = waiting.pop(0)
                done = next(as_completed(running))
                result = done.result()
                del running[done]
                yield result
        except BrokenProcessPool:
            pass
        # A worker died (out of memory, say) and took the pool with it; which fold it was shows when each runs alone.
        for fold in [*running.values(), *waiting]:
            try:
                executor = _workers(1, threads)
                yield executor.submit(work, cell, corpus, fold.name, fold.train, fold.test, threads).result()
            except BrokenProcessPool as e:
                yield FoldResult(fold.name, error=f"The worker process died; out of memory?\n{e}")
    except (KeyboardInterrupt, GeneratorExit):
        executor.shutdown(wait=True, kill_workers=True)  # else the folds that wait would be run before the process ends
        raise


def start_workers(jobs: int, threads: int) -> None:
    """Let worker processes start and import what they need while the caller does something else."""
    executor = _workers(jobs, threads)
    for _ in range(jobs):
        executor.submit(usable_cores)


def _workers(jobs: int, threads: int) -> object:
    """Worker processes that stay for the next cell: importing torch takes seconds."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return get_reusable_executor(
        max_workers=jobs, timeout=60, initializer=_ignore_interrupts, env=dict.fromkeys(names, str(threads))
    )


def _ignore_interrupts() -> None:
    """Ctrl-C reaches the whole process group; only the parent acts on it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
