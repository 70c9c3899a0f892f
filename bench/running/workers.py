"""Workers for folds: this process, or processes of this machine."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

from joblib.externals.loky import get_reusable_executor

from bench import contract
from bench.corpora.corpus import Corpus
from bench.ground.machine import this_machine
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan, usable_cores
from bench.running.evaluation import folded
from bench.running.fold import forget_peak
from bench.running.results import FoldResult, failure


class Here:
    """This process: of one fold at a time, starting another one takes longer than most folds.

    Other workers have the same methods. Every fold gives one result, a crashed worker a failed one. Left with an
    exception (Ctrl-C), they end the folds that are under way.
    """

    threads = 0  # of each fold; 0 for those of its plan

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None
    ) -> None:
        pass

    def folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Do folds of a plan; each result as soon as it is there."""
        fill_cache(plan.cell, plan.corpus)
        for fold in missing:
            yield do_fold(plan.cell, plan.corpus, fold, plan.threads)


class Processes(Here):
    """Worker processes of this machine, which stay for the next plan: importing torch takes seconds."""

    pool: Any = None  # of loky, which has no types

    def __exit__(
        self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None
    ) -> None:
        if kind and self.pool:  # else the folds that wait would be run before the process ends
            self.pool.shutdown(wait=True, kill_workers=True)

    def folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Do folds side by side; after a worker has died (out of memory, say), one at a time, to see which kills it."""
        waiting, running, count = deque(missing), dict[Any, tuple[Fold, float]](), plan.workers
        self._start(count, plan.threads)
        fill_cache(plan.cell, plan.corpus)  # meanwhile
        while waiting or running:
            # One more than can run, so that no worker waits while a result is stored; all of them at once is what loky
            # stumbles over when it is killed.
            while waiting and len(running) < (count + 1 if count > 1 else 1):
                fold = waiting.popleft()
                task = self.pool.submit(do_fold, plan.cell, plan.corpus, fold, plan.threads)
                running[task] = fold, time.perf_counter()
            done = next(as_completed(running))
            fold, began = running.pop(done)
            try:
                yield done.result()
            except BrokenProcessPool as e:
                self.pool.shutdown(wait=True, kill_workers=True)
                if count > 1:
                    waiting.extendleft([fold, *(other for other, _ in running.values())])
                    running.clear()
                    count = 1
                else:
                    error = f"The worker process died; out of memory?\n{e}"
                    yield FoldResult(fold.name, error=error, seconds=time.perf_counter() - began)
                self._start(count, plan.threads)

    def _start(self, count: int, threads: int) -> None:
        """Have so many processes with so many threads each; those of the last plan, if they are like that."""
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        env = dict.fromkeys(names, str(threads))
        self.pool = get_reusable_executor(
            count, timeout=60, initializer=_begin, initargs=(os.getpid(),), env=env
        )
        for _ in range(count):
            self.pool.submit(usable_cores)  # imports what they need


def _begin(parent: int) -> None:
    """Ctrl-C reaches the whole process group, only the parent acts on it; a parent that is killed cannot."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process, in the middle of a fold, once its parent is gone: nobody would take the result."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def do_fold(cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
    """Do one fold, in a worker; an exception becomes the result's ``error``."""
    forget_peak()
    began = time.perf_counter()
    try:
        result = folded(cell, corpus, fold, threads)
    except KeyboardInterrupt:  # in this process
        raise
    except (
        BaseException
    ):  # whatever a system raises is this fold's result; even `sys.exit` does not end the command
        result = FoldResult(fold.name, error=failure())
    result.seconds, result.machine = time.perf_counter() - began, this_machine()
    return result


def fill_cache(cell: Cell, corpus: Corpus) -> None:
    """Compute once for all folds the features that need no learning; failures recur in every fold, recorded there."""
    for features in cell.feature_sets().values():
        with suppress(Exception, SystemExit):
            for seen in contract.seen_by_features(cell.untrained, corpus[:1]):
                features.fit_transform(seen, seen.gestures)
