"""The one loop: plans in, folds done in workers and stored as they finish, runs measured. For every kind of run."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress import Task as BarTask
from rich.text import Text

from bench import contract
from bench.arguments import HERE, Backend
from bench.corpora.duplicates import named
from bench.corpora.read.limits import briefly
from bench.errors import ClusterError, InputError
from bench.outcomes.results import Findings, FoldResult, Shown
from bench.outcomes.scores import RESERVED
from bench.outcomes.store import Store, connect, only_one
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan, planned, usable_cores
from bench.progress import Said, console, seconds_left, span, told, warn
from bench.work.experiment import Experiment
from bench.work.tracking import Illustrate, TrackedRun, key_of
from bench.work.workers import Processes, Task, Todo, Workers


class Interrupted(KeyboardInterrupt):
    """Ctrl-C where what is finished is stored."""


@dataclass(frozen=True)
class Outcome(Generic[Shown]):
    """What came of one plan.

    Attributes:
        plan: what was run.
        experiment: its kind.
        run_id: of its run in the store.
        tags: as it is tracked.
        findings: what was measured, None if no fold went well.
        results: folds that went well.
        errors: by name of a fold that failed, where its traceback is.
    """

    plan: Plan
    experiment: Experiment[Shown]
    run_id: str
    tags: dict[str, str]
    findings: Findings[Shown] | None
    results: list[FoldResult]
    errors: dict[str, str] = field(default_factory=dict)

    @property
    def metrics(self) -> dict[str, float]:
        """What was measured; empty if no fold went well."""
        return self.findings.metrics if self.findings else {}

    @property
    def analysis(self) -> Shown:
        """What its kind of run shows besides; there is none if no fold went well."""
        if self.findings is None or self.findings.analysis is None:
            raise ValueError(f"nothing was found by {self.run_id}")
        return self.findings.analysis

    @property
    def chosen(self) -> dict[str, dict[str, object]]:
        """By fold, what was chosen on its training part."""
        return {r.name: r.chosen for r in self.results if r.chosen}


def prepared(asked: Iterable[Cell], experiments: Sequence[Experiment[Shown]], jobs: int | None) -> Todo[Shown]:
    """Every cell with every experiment; all is checked before the first fold starts.

    Raises:
        InputError: something in the cells, the data or the experiments cannot be used.
    """
    todo = [(plan, experiment) for plan in planned(list(asked), jobs) for experiment in experiments]
    for plan, experiment in todo:
        if not experiment.adapts and any(fold.known for fold in plan.folds):
            raise InputError(
                f"protocol={plan.cell.protocol}: bench {experiment.kind} tests systems as they are for anybody; leave "
                "shots and unlabelled out"
            )
        taken = (RESERVED | experiment.columns) & set(plan.corpus.captures)
        if taken:
            raise InputError(
                f"{plan.corpus.name} has a column {min(taken)!r}, and so has the table of results; rename it and "
                "import again"
            )
        experiment.refuse(plan)
    return todo


def execute(todo: Todo[Shown], backend: Backend = HERE, illustrate: Illustrate | None = None) -> list[Outcome[Shown]]:
    """Run what is not stored yet; what is stored is measured again from its tables.

    Args:
        todo: what `prepared` gave.
        backend: where folds are done.
        illustrate: draws what is kept with a run besides its tables.

    Raises:
        InputError: the store or the cluster cannot be used, or another process runs one of the cells.
        ClusterError: the cluster is gone; what is finished is stored.
        Interrupted: Ctrl-C; what is finished is stored.
    """
    with tempfile.TemporaryDirectory() as folder:
        workers: Workers
        under_way: list[Begun] = []
        try:
            if backend.cluster:
                from bench.work.cluster import Cluster

                workers = cluster = Cluster(backend.cluster, todo, warn, Path(folder))
                todo = [(replace(plan, threads=cluster.threads), experiment) for plan, experiment in todo]
            else:
                workers = Processes(Path(folder))
                if backend.jobs and backend.jobs > usable_cores():
                    has = f"this machine has {usable_cores()} cores"
                    console.print(f"warning: jobs={backend.jobs}: {has}, more workers would only wait")
            with workers:
                for line in dict.fromkeys(line for plan, _ in todo for line in warnings(plan)):
                    warn(line)
                store = connect()
                with progress(Path(folder)) as bar:
                    return work(store, todo, workers, bar, under_way, illustrate)
        except (KeyboardInterrupt, ClusterError) as e:
            for begun in under_way:
                if not begun.run.finished:
                    begun.run.interrupt()
            if isinstance(e, ClusterError):
                raise
            said = "interrupted; every finished fold is stored and the same command goes on from there"
            raise Interrupted(said) from e
        finally:
            for begun in under_way:
                begun.lock.close()


@dataclass(eq=False)
class Begun(Generic[Shown]):
    """A run whose folds are under way.

    Attributes:
        place: of its plan among those of the command.
        run: where it is tracked.
        waiting: folds that nobody does yet.
        left: number of folds that are not stored yet.
        bar: of its folds.
        lock: holds it against other processes.
        errors: by name of a fold that failed, where its traceback is.
        spent: seconds of each fold that went well.
    """

    place: int
    run: TrackedRun[Shown]
    waiting: list[Fold]
    left: int
    bar: TaskID
    lock: ExitStack
    errors: dict[str, str] = field(default_factory=dict)
    spent: list[float] = field(default_factory=list)


def work(
    store: Store,
    todo: Todo[Shown],
    workers: Workers,
    bar: Bar,
    under_way: list[Begun[Shown]],
    illustrate: Illustrate | None,
) -> list[Outcome[Shown]]:
    """Give workers the folds of all plans in one queue; a plan begins when they have room for its first fold.

    Args:
        store: where runs are tracked.
        todo: plans, in the order in which they begin.
        workers: who do folds.
        bar: of folds.
        under_way: filled with what is begun and not ended.
        illustrate: draws what is kept with a run besides its tables.

    Raises:
        InputError: another process runs one of the cells; those before it are finished.
    """
    outcomes: dict[int, Outcome[Shown]] = {}
    refused: InputError | None = None

    def close(begun: Begun[Shown]) -> None:
        run, plan = begun.run, begun.run.plan
        found = run.close(illustrate)
        outcome = Outcome(plan, run.experiment, run.run_id, run.tags, found, run.results(), begun.errors)
        outcomes[begun.place] = outcome
        for result in outcome.results:
            if result.batch_effects:
                warn(f"warning: {plan.cell.system()}: fold {result.name}: {result.batch_effects[0]}")
                break
        bar.end(begun.bar)
        under_way.remove(begun)
        begun.lock.close()

    while len(outcomes) < len(todo):
        while True:
            ready = next((b for b in under_way if b.waiting), None)
            if ready and workers.room(ready.run.plan):
                workers.submit(Task(ready.run.plan, ready.run.experiment, ready.waiting.pop(0), ready.run.key))
                continue
            place = len(outcomes) + len(under_way)
            if ready or refused or place == len(todo) or (under_way and not workers.overlap):
                break
            if not workers.room(todo[place][0]):
                break
            try:
                begun = begin(store, todo, place, under_way, workers, bar)
            except InputError as e:
                refused = e
                break
            if begun is None:
                break
            if not begun.left:
                close(begun)
        if refused and not under_way:
            raise refused
        if under_way:
            for each in under_way:
                bar.update(each.bar, spent=each.spent, workers=workers.count(each.run.plan))
            task, result, machine = workers.finished()
            begun = next(b for b in under_way if b.run.key == task.key)
            child = begun.run.add(result, machine)
            begun.left -= 1
            if not result.error:  # what failed at once says nothing of the others
                begun.spent.append(result.seconds)
            bar.advance(begun.bar)
            if result.error:
                begun.errors[result.name] = store.where(child, "fold/traceback.txt")
                reason = result.error.strip().splitlines()[-1]
                bar.console.print(f"fold {result.name} failed: {reason}", style="red", markup=False)
            if not bar.console.is_terminal:
                bar.line(begun.bar, result)
            if not begun.left:
                close(begun)
    return [outcomes[place] for place in range(len(todo))]


def begin(
    store: Store, todo: Todo[Shown], place: int, under_way: list[Begun[Shown]], workers: Workers, bar: Bar
) -> Begun[Shown] | None:
    """Find or make the run of a plan and add it to those under way; None if one of them is the same run.

    Raises:
        InputError: another process runs it.
    """
    plan, experiment = todo[place]
    cell, key = plan.cell, key_of(plan, experiment)
    if any(begun.run.key == key for begun in under_way):
        return None
    with ExitStack() as stack:
        stack.enter_context(only_one(key))
        run = TrackedRun(store, plan, experiment, key)
        missing = [fold for fold in plan.folds if fold.name not in run.done]
        begun = Begun(place, run, missing, len(missing), TaskID(-1), ExitStack())
        under_way.append(begun)
        begun.lock = stack.pop_all()
    if missing:
        workers.begin(plan)
    else:
        said = f"{cell.system()} on {cell.data}, {cell.protocol}: all {len(plan.folds)} folds were stored before"
        console.print(said, markup=False, soft_wrap=True)
    done = len(plan.folds) - len(missing)
    begun.bar = bar.add_task(cell.title(), total=len(plan.folds), completed=done, key=key, left="")
    return begun


def warnings(plan: Plan) -> list[str]:
    """What a user should know before the run."""
    cell, corpus = plan.cell, plan.corpus
    told = corpus.info.get("warnings", [])
    lines = [f"warning: {cell.data}: {briefly(told, f'bench data show {cell.data}')}"] if told else []
    if plan.mixes_subjects:
        lines.append(f"warning: protocol={cell.protocol} mixes subjects: scores are optimistic for a new person")
    if plan.repeats:
        tested, trained = plan.repeats[0]
        lines.append(
            f"warning: {cell.data}: captures with the same frames as a training capture: {len(plan.repeats)}, such as "
            f"{named(corpus, tested)} and {named(corpus, trained)}: scores are optimistic"
        )
    frames = contract.window(replace(cell, tuning=None).estimator(), corpus.rate_hz)
    if frames is not None and (short := int((corpus.lengths < frames).sum())):
        lines.append(
            f"warning: {cell.data}: {short} of {len(corpus)} captures are shorter than the {frames}-frame window "
            f"of {cell.model.short}; they are padded"
        )
    return lines


class Bar(Progress):
    """A bar of folds, and below it a line for each that says how far it is.

    Args:
        folder: where they say so (`bench.progress`).
        columns: of the bar.
        console: to draw on.
    """

    def __init__(self, folder: Path, *columns: ProgressColumn, console: Console) -> None:
        self.folder = folder
        super().__init__(*columns, console=console, transient=True)

    def end(self, task: TaskID) -> None:
        """Print the bar of a run that is measured once and for all; others are under way."""
        (ended,) = (t for t in self.tasks if t.id == task)
        self._tell_left([ended], told(self.folder))
        self.console.print(self.make_tasks_table([ended]))
        self.remove_task(task)

    def stop(self) -> None:
        """Leave the bars of what is cut off where they are."""
        for task in self.tasks:
            self.end(task.id)
        super().stop()

    def line(self, task: TaskID, result: FoldResult) -> None:
        """Print what a log should have of a fold that has ended: there no bar is seen before the end."""
        (of,) = (t for t in self.tasks if t.id == task)
        self._tell_left([of], told(self.folder))
        how = "failed" if result.error else "done"
        after = f" after {span(result.seconds)}" if result.seconds else ""
        left = f", {of.fields['left']}" if of.fields["left"] else ""
        said = f"{of.description}: fold {result.name} {how}{after}, {of.completed:.0f} of {of.total:.0f}{left}"
        self.console.print(said, markup=False, highlight=False, soft_wrap=True)

    def _tell_left(self, tasks: Sequence[BarTask], heard: Sequence[Said]) -> None:
        """Note of bars how long their folds take still; nothing where that cannot be known."""
        now = time.time()
        for task in tasks:
            running = [
                (now - said.began, None if said.left is None else said.left - (now - said.at))
                for said in heard
                if said.of == task.fields["key"]
            ]
            remaining = int(task.remaining or 0)
            waiting = max(remaining - len(running), 0)
            left = seconds_left(task.fields.get("spent", []), running, waiting, task.fields.get("workers", 1))
            task.fields["left"] = f"{span(left)} left" if remaining and left is not None else ""

    def get_renderables(self) -> Iterable[RenderableType]:
        """The bar and the lines."""
        heard = told(self.folder)
        self._tell_left(self.tasks, heard)
        yield self.make_tasks_table(self.tasks)
        titles = {task.fields["key"]: task.description for task in self.tasks}
        for said in heard:
            if said.words:
                of = f"{titles.get(said.of, '')}: " if len(self.tasks) > 1 else ""
                left = "" if said.left is None else f", {span(said.left - (time.time() - said.at))} left"
                yield Text(f"  {of}{said.name}: {said.words}{left}", overflow="ellipsis", no_wrap=True)


def progress(folder: Path) -> Bar:
    """A bar of folds that tell in a folder how far they are; in a notebook too, where it needs ipywidgets."""
    return Bar(
        folder,
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("folds"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}", style="progress.remaining", markup=False),
        console=console,
    )
