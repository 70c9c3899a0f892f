"""The folds of a plan in worker processes; each result is handed over as soon as it is there."""

from __future__ import annotations

import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Generator
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import ParamSpec, Protocol, TypeVar

from joblib.externals.loky import get_reusable_executor

from bench.corpora.corpus import Corpus
from bench.outcomes.results import FoldResult
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan, usable_cores
from bench.progress import telling
from bench.work.experiment import Experiment
from bench.work.fold import forget_peak

Given = ParamSpec("Given")
Result = TypeVar("Result")


class Workers(Protocol):
    """What is asked of loky, which has no types."""

    def submit(self, work: Callable[Given, Result], *args: Given.args, **kwargs: Given.kwargs) -> Future[Result]:
        """Have something done in a worker."""

    def shutdown(self, wait: bool, kill_workers: bool) -> None:
        """End the processes."""


def run_folds(
    plan: Plan, experiment: Experiment, folds: list[Fold], told: Path | None = None
) -> Generator[FoldResult, None, None]:
    """Results in the order in which folds finish; every fold gives one, a crashed worker a failed one.

    Args:
        plan: what is run, with the number of workers and their threads.
        experiment: what a worker does with a fold.
        folds: those to run.
        told: folder where they say how far they are (`bench.progress`).
    """
    jobs, threads = plan.workers, plan.threads
    executor = _workers(jobs, threads)
    waiting = list(folds)
    running: dict[Future[FoldResult], Fold] = {}
    try:
        try:
            while waiting or running:
                # One more than can run, so that no worker waits while a result is tracked; all of them at once is what
                # loky stumbles over when it is killed.
                while waiting and len(running) <= jobs:
                    fold = waiting[0]
                    task = executor.submit(do_fold, experiment, plan.cell, plan.corpus, fold, threads, told)
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
                yield executor.submit(do_fold, experiment, plan.cell, plan.corpus, fold, threads, told).result()
            except BrokenProcessPool as e:
                yield FoldResult(fold.name, error=f"The worker process died; out of memory?\n{e}")
    except (KeyboardInterrupt, GeneratorExit):
        executor.shutdown(wait=True, kill_workers=True)  # else the folds that wait would be run before the process ends
        raise


def do_fold(
    experiment: Experiment, cell: Cell, corpus: Corpus, fold: Fold, threads: int, told: Path | None = None
) -> FoldResult:
    """One fold of an experiment, in a worker; an exception becomes the result's ``error``."""
    forget_peak()
    try:
        with telling(told, fold.name):
            return experiment.fold(cell, corpus, fold, threads)
    except Exception:  # whatever a system raises is this fold's result, not the end of the command
        return FoldResult(fold.name, error=traceback.format_exc())


def start_workers(jobs: int, threads: int) -> None:
    """Let worker processes start and import what they need while the caller does something else."""
    executor = _workers(jobs, threads)
    for _ in range(jobs):
        executor.submit(usable_cores)


def _workers(jobs: int, threads: int) -> Workers:
    """Worker processes that stay for the next cell: importing torch takes seconds."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return get_reusable_executor(
        max_workers=jobs,
        timeout=60,
        initializer=_begin,
        initargs=(os.getpid(),),
        env=dict.fromkeys(names, str(threads)),
    )


def _begin(parent: int) -> None:
    """Ctrl-C reaches the whole process group, only the parent acts on it; a parent that is killed cannot."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process, in the middle of a fold, once its parent is gone: nobody would take the result."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
