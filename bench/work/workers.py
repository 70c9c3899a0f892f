"""Workers for folds: processes of this machine, or others (`Workers`)."""

from __future__ import annotations

import time
import traceback
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol

from bench import contract
from bench.corpora.corpus import Corpus
from bench.machine import Machine, this_machine
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan, usable_cores
from bench.progress import forget, telling
from bench.work.evaluation import folded
from bench.work.fold import forget_peak
from bench.work.pool import Executor, pool
from bench.work.results import FoldResult

Todo = list[Plan]  # what a command is to run


@dataclass(frozen=True, eq=False)
class Task:
    """A fold of a plan.

    Attributes:
        plan: plan of the fold.
        fold: fold to do.
        key: key of its run.
    """

    plan: Plan
    fold: Fold
    key: str


class Done(NamedTuple):
    """A task with its result and its machine; None if the machine is unknown."""

    task: Task
    result: FoldResult
    machine: Machine | None


class Workers(Protocol):
    """Workers that do several folds at once; every submitted fold gives one result, a crashed worker a failed one.

    Left with an exception (Ctrl-C), it ends the folds that are under way.

    Attributes:
        overlap: True if a plan may begin while folds of another are under way.
        threads: threads of each fold; 0 for those of its plan.
    """

    overlap: bool
    threads: int

    def __enter__(self) -> Workers: ...

    def __exit__(self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None) -> None: ...

    def count(self, plan: Plan) -> int:
        """The number of folds of this plan at a time, as far as others leave room."""

    def room(self, plan: Plan) -> bool:
        """Return True to submit a fold of this plan now."""

    def begin(self, plan: Plan) -> None:
        """Make ready for the folds of a plan."""

    def submit(self, task: Task) -> None:
        """Have a fold done."""

    def finished(self) -> Done:
        """Wait until a fold that was submitted is done."""


class Processes:
    """Worker processes of this machine, which take one plan after the other, each with its number of threads.

    Args:
        folder: folder for messages of folds (`bench.progress`).
    """

    threads = 0
    overlap = False  # plans have their own numbers of processes and threads, and share the cores with `fill_cache`

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.running: dict[Future[FoldResult], Task] = {}
        self.suspects: list[Task] = []
        self.alone: Plan | None = None  # of which a fold has killed its worker
        self.submitted = 0.0  # when the last fold was, of `time.perf_counter`

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None) -> None:
        if kind and self.running:  # else the folds that wait would be run before the process ends
            plan = next(iter(self.running.values())).plan
            self._pool(plan).shutdown(wait=True, kill_workers=True)

    def count(self, plan: Plan) -> int:
        """The number of folds of this plan at a time."""
        return 1 if plan is self.alone else plan.workers

    def room(self, plan: Plan) -> bool:
        """Return True to submit a fold of this plan now.

        One more than can run, so that no worker waits while a result is tracked; all of them at once is what loky
        stumbles over when it is killed.
        """
        if plan is self.alone:
            return not self.running and not self.suspects
        return len(self.running) <= plan.workers

    def begin(self, plan: Plan) -> None:
        """Start the processes, which import their modules; meanwhile compute features that need no learning."""
        self.alone = None
        for _ in range(plan.workers):
            self._pool(plan).submit(usable_cores)
        fill_cache(plan.cell, plan.corpus)

    def submit(self, task: Task) -> None:
        """Have a fold done."""
        plan = task.plan
        arguments = (plan.cell, plan.corpus, task.fold, plan.threads, task.key, self.folder)
        self.submitted = time.perf_counter()
        self.running[self._pool(plan).submit(do_fold, *arguments)] = task

    def finished(self) -> Done:
        """Wait until a fold that was submitted is done."""
        while True:
            if not self.running:
                self.submit(self.suspects.pop(0))
            done = next(as_completed(self.running))
            task = self.running[done]
            try:
                result = done.result()
            except BrokenProcessPool as e:
                self._pool(task.plan).shutdown(wait=True, kill_workers=True)
                for other in self.running.values():  # they cannot remove their messages
                    if self.folder:
                        forget(self.folder, other.key, other.fold.name)
                if task.plan is not self.alone:
                    # A worker died (out of memory, say) and took the pool with it; which fold it was shows when each
                    # runs alone.
                    self.suspects, self.alone, self.running = list(self.running.values()), task.plan, {}
                    continue
                error = f"The worker process died; out of memory?\n{e}"
                result = FoldResult(task.fold.name, error=error, seconds=time.perf_counter() - self.submitted)
            del self.running[done]
            return Done(task, result, this_machine())

    def _pool(self, plan: Plan) -> Executor:
        return pool(self.count(plan), plan.threads)


def do_fold(cell: Cell, corpus: Corpus, fold: Fold, threads: int, key: str, folder: Path | None = None) -> FoldResult:
    """Do one fold, in a worker; an exception becomes the result's ``error``.

    Its messages lie in a folder under the key of its run (`bench.progress`).
    """
    forget_peak()
    began = time.perf_counter()
    try:
        with telling(folder, fold.name, key):
            result = folded(cell, corpus, fold, threads)
    except BaseException:  # whatever a system raises is this fold's result; even `sys.exit` does not end the command
        result = FoldResult(fold.name, error=traceback.format_exc())
    result.seconds = time.perf_counter() - began
    return result


def fill_cache(cell: Cell, corpus: Corpus) -> None:
    """Compute once for all folds the features that need no learning; failures recur in every fold, recorded there."""
    for features in cell.feature_sets().values():
        with suppress(Exception, SystemExit):
            for seen in contract.seen_by_features(cell.untrained, corpus[:1]):
                features.fit_transform(seen, seen.gestures)
