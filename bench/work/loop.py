"""The one loop: plans in, folds done in workers and stored as they finish, runs measured. For every kind of run."""

from __future__ import annotations

import tempfile
from collections import deque
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

from bench import contract
from bench.corpora.corpus import reserved
from bench.corpora.duplicates import named
from bench.corpora.read.limits import briefly
from bench.corpora.recordings import as_touches, is_recorded
from bench.errors import ClusterError, InputError
from bench.outcomes.store import Store, connect, only_one
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan, planned, usable_cores
from bench.progress import console, warn
from bench.registry import check_loaded, imported
from bench.result import Result
from bench.work.backend import HERE, Backend
from bench.work.bar import Bar
from bench.work.curves import COLUMNS
from bench.work.tracking import TrackedRun, key_of
from bench.work.workers import Done, Processes, Task, Todo, Workers


class Interrupted(KeyboardInterrupt):
    """Ctrl-C after finished results were stored."""


def prepared(cells: Iterable[Cell], jobs: int | None) -> Todo:
    """A plan for each cell; all is checked before the first fold starts.

    Raises:
        InputError: something in the cells, the data or what installed packages add cannot be used.
    """
    check_loaded()
    todo = planned(list(cells), jobs)
    for plan in todo:
        if taken := reserved(map(str, plan.corpus.captures), columns_of(plan.cell)):
            raise InputError(
                f"{plan.corpus.name} has a column {min(taken)!r}, a name that tables of results use; rename "
                "the column and import again"
            )
        if plan.cell.circumstances and any(fold.known for fold in plan.folds):
            raise InputError(
                f"protocol={plan.cell.protocol}: {plan.cell.circumstances[0].key}= does not adapt systems to a person; "
                "leave protocol.shots= and protocol.unlabelled= out"
            )
        for one in plan.cell.producers:
            one.refuse(plan)
    return todo


def columns_of(cell: Cell) -> frozenset[str]:
    """Further columns of the tables of labels of its runs."""
    return frozenset().union(COLUMNS if cell.circumstances else (), *(one.columns for one in cell.producers))


def execute(todo: Todo, backend: Backend = HERE) -> list[Result]:
    """Run missing folds; stored ones are scored again from their tables.

    Args:
        todo: plans from `prepared`.
        backend: workers that do the folds.

    Raises:
        InputError: the store or the cluster cannot be used, or another process runs one of the cells.
        ClusterError: the cluster is gone; what is finished is stored.
        Interrupted: Ctrl-C; what is finished is stored.
    """
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)  # where folds leave their messages (`bench.progress`)
            if not backend.workers:
                workers: Workers = Processes(folder)
                if backend.jobs and backend.jobs > usable_cores():
                    cores = f"this machine has {usable_cores()} cores"
                    console.print(f"warning: jobs={backend.jobs}: {cores}, more workers do not help")
            else:
                workers = imported(backend.workers)(backend.address, todo, warn, folder)
            if workers.threads:
                todo = [replace(plan, threads=workers.threads) for plan in todo]
            with workers:
                for line in dict.fromkeys(line for plan in todo for line in warnings(plan)):
                    warn(line)
                with Bar(folder) as bar, Queue(connect(writes=True), todo, workers, bar) as queue:
                    return queue.work()
    except KeyboardInterrupt as e:
        raise Interrupted(
            "interrupted; every finished fold is stored, and the same command continues from there"
        ) from e


@dataclass(eq=False)
class Begun:
    """A run whose folds are under way.

    Attributes:
        index: index of its plan in the command's list.
        run: tracked run.
        waiting: folds that no worker has yet.
        lock: lock of the run against other processes.
    """

    index: int
    run: TrackedRun
    waiting: deque[Fold]
    lock: ExitStack


class Queue:
    """The folds of all plans, plan after plan; the run of a plan begins when workers have room for its first fold.

    Left with an exception (Ctrl-C, a cluster that is gone), it marks the runs that are under way as killed.

    Args:
        store: store of the runs.
        todo: plans, in the order in which they begin.
        workers: do folds.
        bar: progress bar.
    """

    def __init__(self, store: Store, todo: Todo, workers: Workers, bar: Bar) -> None:
        self.store, self.workers, self.bar = store, workers, bar
        self.plans = deque(enumerate(todo))
        self.under_way: dict[str, Begun] = {}  # by key of the run
        self.results: dict[int, Result] = {}  # by index of the plan
        self.refusal: InputError | None = None

    def __enter__(self) -> Queue:
        return self

    def __exit__(self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None) -> None:
        try:
            for begun in self.under_way.values():
                if isinstance(e, KeyboardInterrupt | ClusterError) and not begun.run.finished:
                    begun.run.interrupt()
        finally:
            for begun in self.under_way.values():
                begun.lock.close()

    def work(self) -> list[Result]:
        """Have all folds done, and measure each run as soon as its last fold is stored.

        Raises:
            InputError: another process runs one of the cells; those before it are finished.
        """
        while True:
            while task := self.next():
                self.workers.submit(task)
            if not self.under_way:
                break
            self.keep(self.workers.finished())
        if self.refusal:
            raise self.refusal
        return [self.results[index] for index in sorted(self.results)]

    def next(self) -> Task | None:
        """The next fold for the workers; None if they are full, must finish others first, or all are submitted."""
        while True:
            for key, begun in self.under_way.items():
                if begun.waiting:
                    plan = begun.run.plan
                    room = self.workers.room(plan)
                    return Task(plan, begun.waiting.popleft(), key) if room else None
            if not self._begin():
                return None

    def _begin(self) -> bool:
        """Find or make the run of the next plan; whether that is done, or it has to wait for others."""
        if not self.plans or (self.under_way and not self.workers.overlap):
            return False
        index, plan = self.plans[0]
        if not self.workers.room(plan) or (key := key_of(plan)) in self.under_way:
            return False  # of two that are the same the second finds what the first one stores
        try:
            with ExitStack() as lock:
                lock.enter_context(only_one(key))
                run = TrackedRun(self.store, plan, key)
                begun = self.under_way[key] = Begun(index, run, deque(run.missing), lock.pop_all())
        except InputError as e:
            self.refusal = e
            self.plans.clear()
            return False
        self.plans.popleft()
        if begun.waiting:
            self.workers.begin(plan)
        else:
            line = f"{plan.cell.system()} on {plan.cell.data}, {plan.cell.protocol}: all {len(plan.folds)} folds"
            console.print(f"{line} are already stored", markup=False, soft_wrap=True)
        self.bar.begin(key, plan.cell.title(), len(plan.folds), len(run.done), lambda: self.workers.count(plan))
        if not begun.waiting:
            self._close(key)
        return True

    def keep(self, done: Done) -> None:
        """Store a fold; measure its run if it was the last one."""
        key, run = done.task.key, self.under_way[done.task.key].run
        run.add(done.result, done.machine)
        self.bar.advance_fold(key, done.result)
        if run.complete:
            self._close(key)

    def _close(self, key: str) -> None:
        """Measure and end a run."""
        begun = self.under_way[key]
        run, plan = begun.run, begun.run.plan
        self.results[begun.index] = run.close()
        if affected := next((r for r in run.results() if r.batch_effects), None):
            warn(f"warning: {plan.cell.system()}: fold {affected.name}: {affected.batch_effects[0]}")
        self.bar.end(key)
        del self.under_way[key]
        begun.lock.close()


def warnings(plan: Plan) -> list[str]:
    """Warnings before the run."""
    cell, corpus = plan.cell, plan.corpus
    damage = corpus.info.get("warnings", [])
    lines = [f"warning: {cell.data}: {briefly(damage, f'bench data show {cell.data}')}"] if damage else []
    if is_recorded(corpus) and not cell.recordings:
        lines.append(as_touches(corpus))
    if plan.mixes_subjects:
        lines.append(
            f"warning: protocol={cell.protocol} trains and tests on the same subjects; expect lower accuracy for a new "
            "person"
        )
    if plan.repeats:
        tested, trained = plan.repeats[0]
        lines.append(
            f"warning: {cell.data}: {len(plan.repeats)} test captures have the same frames as a training capture, "
            f"such as {named(corpus, tested)} and {named(corpus, trained)}; accuracy is too high"
        )
    plain = replace(cell, tuning=None) if cell.tuning else cell
    frames = contract.window(plain.untrained, corpus.rate_hz)
    if frames is not None and (short := int((corpus.lengths < frames).sum())):
        lines.append(
            f"warning: {cell.data}: {short} of {len(corpus)} captures are shorter than the {frames}-frame window "
            f"of {cell.model.short}; they are padded"
        )
    return [*lines, *(line for one in cell.producers for line in one.warnings(plan))]
