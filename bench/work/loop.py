"""The one loop: plans in, folds done by workers and stored as they finish, runs measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from bench import contract
from bench.corpora.corpus import reserved
from bench.corpora.duplicates import named
from bench.corpora.library import briefly, left_out
from bench.database import only_one
from bench.errors import ClusterError, InputError
from bench.machine import HERE, Backend
from bench.plan.cells import Cell
from bench.plan.plan import Plan, planned, usable_cores
from bench.progress import console, warn
from bench.registry import imported
from bench.result import Result, several
from bench.store import Store, connect
from bench.work.bar import Bar
from bench.work.left import expected, left
from bench.work.tracking import tracked
from bench.work.workers import Here, Processes


class Interrupted(KeyboardInterrupt):
    """Ctrl-C after finished results were stored."""


def prepared(cells: Iterable[Cell], jobs: int | None) -> list[Plan]:
    """A plan for each cell; all is checked before the first fold starts."""
    plans = planned(list(cells), jobs)
    for plan in plans:
        if taken := reserved(map(str, plan.corpus.captures), columns_of(plan.cell)):
            raise InputError(
                f"{plan.corpus.name} has a column {min(taken)!r}, a name that tables of results use; rename "
                "the column and import again"
            )
        if plan.cell.circumstances and any(fold.pairs for fold in plan.folds):
            raise InputError(
                f"protocol={plan.cell.protocol} has several systems in a fold, {plan.cell.circumstances[0].key}= tests "
                "one; leave one of them out"
            )
        for one in plan.cell.producers:
            one.refuse(plan)
    return plans


def columns_of(cell: Cell) -> frozenset[str]:
    """Further columns of the tables of labels of its runs."""
    if not cell.producers:
        return frozenset()
    from bench.work.curves import COLUMNS

    return frozenset().union(COLUMNS if cell.circumstances else (), *(one.columns for one in cell.producers))


def execute(plans: Sequence[Plan], backend: Backend = HERE, grid: str = "") -> list[Result]:
    """Run missing folds, plan after plan; a run that is finished is read from the store.

    Args:
        plans: what to run.
        backend: where folds are done.
        grid: digest of the file that names the runs, to track with them; empty without one.
    """
    try:
        with _workers(plans, backend) as workers:
            if workers.threads:
                plans = [replace(plan, threads=workers.threads) for plan in plans]
            for line in dict.fromkeys(line for plan in plans for line in warnings(plan)):
                warn(line)
            store = connect(writes=True)
            runs = [*{plan.key: plan for plan in plans}.values()]
            todo = left(store, runs)
            if stored := len(runs) - len(todo):
                console.print(f"{stored} of {several(len(runs), 'run')} already stored", highlight=False)
            seconds = expected(store, todo) if len(todo) > 1 else [None] * len(todo)
            times = [(one.folds, time) for one, time in zip(todo, seconds, strict=True) if one.folds]
            with Bar(len(runs), stored, times) as bar:
                return [_run(store, plan, workers, bar, grid) for plan in plans]
    except KeyboardInterrupt as e:
        raise Interrupted(
            "interrupted; every finished fold is stored, and the same command continues from there"
        ) from e


def _workers(plans: Sequence[Plan], backend: Backend) -> Here:
    if backend.workers:
        return imported(backend.workers)(backend.address, plans, warn)
    if backend.jobs and backend.jobs > usable_cores():
        cores = f"this machine has {usable_cores()} cores"
        console.print(f"warning: jobs={backend.jobs}: {cores}, more workers do not help")
    return Here() if backend.jobs == 1 else Processes()


def _run(store: Store, plan: Plan, workers: Here, bar: Bar, grid: str) -> Result:
    """Find or make the run of a plan, have its missing folds done, and measure it."""
    key, cell = plan.key, plan.cell
    with only_one(key):
        run = tracked(store, plan, key, grid)
        if missing := run.missing:
            bar.begin(cell.title(), len(plan.folds), [fold.name for fold in missing])
        try:
            for done in workers.folds(plan, missing) if missing else ():
                run.add(done)
                bar.end_fold(done)
        except (KeyboardInterrupt, ClusterError):
            store.mark(run.made.run_id, "KILLED")  # stored folds stay and are found again
            raise
        result = run.close()
        if why := result.get("touchbench.batch_effect"):
            warn(f"warning: {cell.system()}: {why}")
        if missing:
            bar.end()
        return result


def warnings(plan: Plan) -> list[str]:
    """Warnings before the run."""
    cell, corpus = plan.cell, plan.corpus
    damage = corpus.info.get("warnings", [])
    lines = [f"warning: {cell.data}: {briefly(damage, f'bench data show {cell.data}')}"] if damage else []
    if (line := left_out(corpus)) and not cell.study:
        lines.append(line)
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
