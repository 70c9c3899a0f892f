"""Executors of folds: this process, or worker processes of this machine."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any, Self

from joblib.externals.loky import get_reusable_executor

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import one_line
from bench.ground.closed import close_corpora
from bench.ground.machine import this_machine
from bench.ground.progress import console
from bench.ground.registry import FILE_MODULE_PREFIX
from bench.ground.source import is_user_code
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan, usable_cores
from bench.running.evaluation import evaluate_fold, fit_folds, fits_folds_together
from bench.running.fold import FittedSystem, reset_peak_memory
from bench.running.results import FoldResult, format_traceback
from bench.values.result import format_count

Folds = Sequence[Fold]
RESTARTED_WORKER = "A worker stopped while some jobs were given"


class FoldExecutor:
    """Runs folds in this process, one at a time; the base of other executors.

    Every fold gives one result, a crashed worker a failed one. Leaving it with an exception
    (Ctrl-C) ends the folds under way.

    Args:
        jobs: number of worker processes; None for one per core.
    """

    threads = 0  # of each fold; 0 for those of its plan
    is_remote = False  # True if other machines may run the folds

    def __init__(self, jobs: int | None = None) -> None:
        self.jobs = jobs

    def __enter__(self) -> Self:
        if self.jobs and self.jobs > usable_cores():
            cores = f"this machine has {usable_cores()} cores"
            console.print(f"warning: jobs={self.jobs}: {cores}, more workers do not help")
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        pass

    def run_folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Run folds of a plan; yield each result as soon as it is there."""
        fill_cache(plan.cell, plan.corpus)
        for folds in group_folds(plan.cell, missing):
            yield from run_group(plan.cell, plan.corpus, folds, plan.threads)


def local_executor(jobs: int | None = None) -> FoldExecutor:
    """Return an executor on this machine; one job needs no process of its own."""
    return FoldExecutor(jobs) if jobs == 1 else ProcessExecutor(jobs)


class ProcessExecutor(FoldExecutor):
    """Worker processes of this machine, which stay for the next plan: importing torch is slow."""

    pool: Any = None  # of loky, which has no types

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind and self.pool:  # else the waiting folds would be run before the process ends
            self.pool.shutdown(wait=True, kill_workers=True)

    def run_folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Run folds side by side.

        After a worker has died (out of memory, say) they run one at a time, to see which kills it.
        """
        waiting, running = deque(group_folds(plan.cell, missing)), dict[Any, tuple[Folds, float]]()
        count = min(plan.workers, len(waiting))
        self._start_pool(count, plan.threads)
        fill_cache(plan.cell, plan.corpus)  # meanwhile
        while waiting or running:
            # One more than can run, so that no worker waits while a result is stored. With all
            # folds submitted at once, loky fails when it is killed.
            most = count + 1 if count > 1 else 1
            while waiting and len(running) < most:
                folds = waiting.popleft()
                task = self.pool.submit(
                    run_group_silently, plan.cell, plan.corpus, folds, plan.threads
                )
                running[task] = folds, time.perf_counter()
            done = next(as_completed(running))
            folds, started = running.pop(done)
            try:
                yield from done.result()
            except BrokenProcessPool as e:
                self.pool.shutdown(wait=True, kill_workers=True)
                if count > 1 or len(folds) > 1:
                    groups = [folds, *(others for others, _ in running.values())]
                    waiting.extendleft([fold] for group in groups for fold in group)
                    running.clear()
                    count = 1
                else:
                    error, seconds = "The worker process died; out of memory?", time.perf_counter()
                    seconds -= started
                    yield FoldResult(folds[0].name, error=f"{error}\n{e}", seconds=seconds)
                self._start_pool(count, plan.threads)

    def _start_pool(self, count: int, threads: int) -> None:
        """Start worker processes with some threads each; equal ones of the last plan go on."""
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        env = dict.fromkeys(names, str(threads))
        # loky replaces a worker whose memory has grown; only its warning would be new to the user.
        warnings.filterwarnings("ignore", RESTARTED_WORKER)
        self.pool = get_reusable_executor(
            count, timeout=60, initializer=_init_worker, initargs=(os.getpid(),), env=env
        )
        for _ in range(count):
            self.pool.submit(usable_cores)  # a worker then imports its modules


def _init_worker(parent: int) -> None:
    """Leave Ctrl-C, which reaches the whole process group, to the parent; end if that is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, args=(parent,), daemon=True).start()


def _exit_with_parent(parent: int) -> None:
    """End this process, even within a fold, once its parent is gone: the result has no use."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def group_folds(cell: Cell, folds: Sequence[Fold]) -> list[Folds]:
    """Groups of folds whose systems are fitted at once: all folds, or each by itself."""
    return [folds] if fits_folds_together(cell) else [[fold] for fold in folds]


def run_group(cell: Cell, corpus: Corpus, folds: Folds, threads: int) -> Iterator[FoldResult]:
    """Run folds, in a worker; those of a larger group are fitted at once."""
    if len(folds) == 1:
        yield run_fold(cell, corpus, folds[0], threads)
        return
    reset_peak_memory()
    fitted: Sequence[FittedSystem | Exception]
    try:
        with fresh_modules(), close_corpora():
            fitted = fit_folds(cell, corpus, folds, threads)
    except Exception as e:
        fitted = [e] * len(folds)
    for fold, system in zip(folds, fitted, strict=True):
        yield run_fold(cell, corpus, fold, threads, system)


def run_fold(
    cell: Cell,
    corpus: Corpus,
    fold: Fold,
    threads: int,
    fitted_system: FittedSystem | Exception | None = None,
) -> FoldResult:
    """Run one fold, in a worker; an exception becomes the result's ``error``."""
    started = time.perf_counter()
    try:
        if isinstance(fitted_system, Exception):
            raise fitted_system
        if fitted_system:
            started -= fitted_system.metrics["fit_wall_seconds"]
        else:
            reset_peak_memory()
        with fresh_modules(), close_corpora():
            result = evaluate_fold(cell, corpus, fold, threads, fitted_system)
    except KeyboardInterrupt:  # in this process
        raise
    except BaseException:  # a system may raise anything; even `sys.exit` only fails its fold
        result = FoldResult(fold.name, error=format_traceback())
    result.seconds, result.machine = time.perf_counter() - started, this_machine()
    return result


def run_group_silently(cell: Cell, corpus: Corpus, folds: Folds, threads: int) -> list[FoldResult]:
    """Run folds; count what their systems print, which the lines of several folds would mix."""
    with redirect_stdout(io.StringIO()) as printed:
        results = [*run_group(cell, corpus, folds, threads)]
    if lines := printed.getvalue().splitlines():
        words = f"{format_count(len(lines), 'line')}, such as {one_line(lines[0])}"
        results[0].printed = words
    return results


@contextmanager
def fresh_modules() -> Iterator[None]:
    """Import files of the user, and what they import from their folder, anew for a fold.

    So a fold finds nothing that an earlier one left in a module or a class. The modules of before
    return at the end: objects of this process belong to them.
    """
    before = {name: sys.modules.pop(name) for name in _modules_of_files()}
    try:
        yield
    finally:
        for name in _modules_of_files():
            del sys.modules[name]
        sys.modules.update(before)


def _modules_of_files() -> list[str]:
    """Names of the modules of loaded files, and of modules that lie in the folders of the files."""
    files = {}
    for name, module in [*sys.modules.items()]:
        if isinstance(file := getattr(module, "__file__", None), str):
            files[name] = file
    loaded = [name for name in files if name.startswith(FILE_MODULE_PREFIX)]
    folders = {Path(files[name]).parent for name in loaded}
    prefixes, beside = tuple(f"{folder}{os.sep}" for folder in folders), []
    for name, file in files.items():
        if not file.startswith(prefixes) or name.startswith("__"):  # the command itself
            continue
        depth = name.count(".") + file.endswith("__init__.py")
        if Path(file).parents[depth] in folders and is_user_code(file):
            beside.append(name)
    return [*dict.fromkeys(loaded + beside)]


def fill_cache(cell: Cell, corpus: Corpus) -> None:
    """Compute the features that need no learning, once for all folds.

    A failure recurs in every fold and is recorded there.
    """
    for features in cell.feature_sets().values():
        with suppress(Exception, SystemExit):
            for seen in contract.input_of_features(cell.untrained_system, corpus[:1]):
                features.fit_transform(seen, seen.gestures)
