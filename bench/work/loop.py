"""The one loop: plans in, folds done in workers and stored as they finish, runs measured. For every kind of run."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from bench.errors import InputError
from bench.outcomes.results import Findings, FoldResult, Shown
from bench.outcomes.scores import RESERVED
from bench.outcomes.store import Store, connect, only_one
from bench.plan.cells import Cell
from bench.plan.plan import Plan, planned, usable_cores
from bench.progress import span, told
from bench.work.experiment import Experiment
from bench.work.tracking import Illustrate, TrackedRun, key_of
from bench.work.workers import run_folds, start_workers
from models import contract

console = Console(stderr=True)
Todo = list[tuple[Plan, Experiment[Shown]]]


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


def execute(todo: Todo[Shown], jobs: int | None = None, illustrate: Illustrate | None = None) -> list[Outcome[Shown]]:
    """Run what is not stored yet; what is stored is measured again from its tables.

    Args:
        todo: what `prepared` gave.
        jobs: as asked for, to warn of more than there are cores.
        illustrate: draws what is kept with a run besides its tables.

    Raises:
        InputError: the store cannot be used.
        Interrupted: Ctrl-C; what is finished is stored.
    """
    first = todo[0][0]
    start_workers(first.workers, first.threads)  # takes as long as opening the store
    if jobs and jobs > usable_cores():
        console.print(f"warning: jobs={jobs}: this machine has {usable_cores()} cores, more workers would only wait")
    for line in dict.fromkeys(line for plan, _ in todo for line in warnings(plan)):
        warn(line)
    store = connect()
    return [run_one(store, plan, experiment, illustrate) for plan, experiment in todo]


def run_one(
    store: Store, plan: Plan, experiment: Experiment[Shown], illustrate: Illustrate | None = None
) -> Outcome[Shown]:
    """Run the folds of one plan that are not stored yet, and measure it.

    Raises:
        InputError: another process runs it.
        Interrupted: Ctrl-C; what is finished is stored.
    """
    cell, key = plan.cell, key_of(plan, experiment)
    with only_one(key):
        run = TrackedRun(store, plan, experiment, key)
        missing = [fold for fold in plan.folds if fold.name not in run.done]
        if missing:
            fill_cache(plan)
        else:
            said = f"{cell.system()} on {cell.data}, {cell.protocol}: all {len(plan.folds)} folds were stored before"
            console.print(said, markup=False, soft_wrap=True)
        errors = {}
        try:
            with (
                tempfile.TemporaryDirectory() as folder,
                closing(run_folds(plan, experiment, missing, Path(folder))) as results,
                progress(Path(folder)) as bar,
            ):
                task = bar.add_task(cell.title(), total=len(plan.folds))
                bar.advance(task, len(plan.folds) - len(missing))
                for result in results:
                    child = run.add(result)
                    bar.advance(task)
                    if result.error:
                        errors[result.name] = store.where(child, "fold/traceback.txt")
                        reason = result.error.strip().splitlines()[-1]
                        bar.console.print(f"fold {result.name} failed: {reason}", style="red", markup=False)
            found = run.close(illustrate)
            return Outcome(plan, experiment, run.run_id, run.tags, found, run.results(), errors)
        except KeyboardInterrupt as e:
            if not run.finished:
                run.interrupt()
            said = "interrupted; every finished fold is stored and the same command goes on from there"
            raise Interrupted(said) from e


def fill_cache(plan: Plan) -> None:
    """Compute once for all folds what needs no learning; a set that fails here fails in every fold, recorded there."""
    given = contract.seen_by_features(plan.cell.estimator(), plan.corpus[:1])
    for features in plan.cell.feature_sets().values():
        for seen in given:
            with suppress(Exception):
                features.fit_transform(seen, seen.gestures)


def warnings(plan: Plan) -> list[str]:
    """What a user should know before the run."""
    cell, corpus = plan.cell, plan.corpus
    lines = [f"warning: {cell.data}: {w}" for w in corpus.info.get("warnings", [])]
    if plan.mixes_subjects:
        lines.append(f"warning: protocol={cell.protocol} mixes subjects: scores are optimistic for a new person")
    frames = contract.window(replace(cell, tuning=None).estimator(), corpus.rate_hz)
    if frames is not None and (short := int((corpus.lengths < frames).sum())):
        lines.append(
            f"warning: {cell.data}: {short} of {len(corpus)} captures are shorter than the {frames}-frame window "
            f"of {cell.model.short}; they are padded"
        )
    return lines


def warn(line: str) -> None:
    """A line that a user should see."""
    console.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


class Bar(Progress):
    """A bar of folds, and below it a line for each that says how far it is.

    Args:
        folder: where they say so (`bench.progress`).
        columns: of the bar.
        console: to draw on.
    """

    def __init__(self, folder: Path, *columns: ProgressColumn, console: Console) -> None:
        self.folder = folder
        super().__init__(*columns, console=console)

    def get_renderables(self) -> Iterable[RenderableType]:
        """The bar and the lines."""
        yield self.make_tasks_table(self.tasks)
        for name, said in told(self.folder).items():
            left = "" if said.left is None else f", {span(said.left - (time.time() - said.at))} left"
            yield Text(f"  {name}: {said.words}{left}", overflow="ellipsis", no_wrap=True)


def progress(folder: Path) -> Progress:
    """A bar of folds that tell in a folder how far they are; in a notebook too, where it needs ipywidgets."""
    return Bar(
        folder,
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("folds"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=console,
    )
