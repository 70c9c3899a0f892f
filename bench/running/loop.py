"""The one loop: plans in, folds done by workers and stored as they finish, runs measured."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bench import contract
from bench.corpora.duplicates import named
from bench.corpora.library import briefly, left_out
from bench.errors import ClusterError
from bench.ground.machine import LOCAL_BACKEND, Backend
from bench.ground.progress import console, warn
from bench.ground.registry import import_object
from bench.plan.plan import Plan, usable_cores
from bench.running.bar import Bar
from bench.running.tracking import FOLDS, finished, is_whole, tracked, whole
from bench.running.workers import Here, Processes
from bench.store.client import Store, connect
from bench.store.database import only_one
from bench.values.result import Result, several

if TYPE_CHECKING:
    from mlflow.entities import Run


NEWEST = 20  # runs among which one like another is looked for: a store may have thousands
FREE = (
    "seed",
    "protocol",
)  # arguments in which runs that take about as long may differ, as in parameters of parts


class Interrupted(KeyboardInterrupt):
    """Ctrl-C after finished results were stored."""


def execute(plans: Sequence[Plan], backend: Backend = LOCAL_BACKEND, grid: str = "") -> list[Result]:
    """Run missing folds, plan after plan; a run that is finished is read from the store.

    ``grid`` is the digest of the file that names the runs, which is tracked with them.
    """
    try:
        with _workers(plans, backend) as workers:
            if workers.threads:
                plans = [replace(plan, threads=workers.threads) for plan in plans]
            for line in dict.fromkeys(line for plan in plans for line in warnings(plan)):
                warn(line)
            store = connect(writes=True)
            stored, todo = lookup(store, plans)
            runs = len(stored) + len(todo)
            if stored:
                console.print(
                    f"{len(stored)} of {several(runs, 'run')} already stored", highlight=False
                )
            seconds = expected(store, todo) if len(todo) > 1 else [None] * len(todo)
            times = [
                (one.folds, time) for one, time in zip(todo, seconds, strict=True) if one.folds
            ]
            results = {key: whole(store, run, grid) for key, run in stored.items()}
            with Bar(runs, len(stored), times) as bar:
                for plan, _ in todo:
                    results[plan.key] = _run(store, plan, workers, bar, grid)
            for plan in plans:
                if why := results[plan.key].get("touchbench.batch_effect"):
                    warn(f"warning: {plan.cell.system()}: {why}")
            return [results[plan.key] for plan in plans]
    except KeyboardInterrupt as e:
        raise Interrupted(
            "interrupted; every finished fold is stored, and the same command continues from there"
        ) from e


def _workers(plans: Sequence[Plan], backend: Backend) -> Here:
    if backend.workers:
        return import_object(backend.workers)(backend.address, plans, warn)
    if backend.jobs and backend.jobs > usable_cores():
        cores = f"this machine has {usable_cores()} cores"
        console.print(f"warning: jobs={backend.jobs}: {cores}, more workers do not help")
    return Here() if backend.jobs == 1 else Processes()


def _run(store: Store, plan: Plan, workers: Here, bar: Bar, grid: str) -> Result:
    """Find or make the run of a plan, have its missing folds done, and measure it."""
    with only_one(plan.key):
        stored = store.find(plan.key, plan.cell.kind)
        if stored and is_whole(
            stored
        ):  # by another process, or by a command that was cut off at the very end
            if store.names(stored.info.run_id, stored.info.artifact_uri, FOLDS):
                store.drop(stored.info.artifact_uri, FOLDS)
            return whole(store, stored, grid)
        run = tracked(store, plan, stored, grid)
        if missing := run.missing:
            bar.begin(plan.cell.title(), len(plan.folds), [fold.name for fold in missing])
        try:
            for done in workers.folds(plan, missing) if missing else ():
                run.add(done)
                bar.end_fold(done)
        except (KeyboardInterrupt, ClusterError):
            store.mark(run.made.run_id, "KILLED")  # stored folds stay and are found again
            raise
        result = run.close()
        if missing:
            bar.end()
        return result


def warnings(plan: Plan) -> list[str]:
    """Warnings before the run."""
    cell, corpus = plan.cell, plan.corpus
    damage = corpus.info.get("warnings", [])
    lines = (
        [f"warning: {cell.data}: {briefly(damage, f'bench data show {cell.data}')}"]
        if damage
        else []
    )
    if (line := left_out(corpus)) and not cell.study:
        lines.append(line)
    if plan.mixes_subjects:
        lines.append(
            f"warning: protocol={cell.protocol} trains and tests on the same subjects; expect lower accuracy for a new "
            "person"
        )
    if plan.repeated_captures:
        tested, trained = plan.repeated_captures[0]
        lines.append(
            f"warning: {cell.data}: {len(plan.repeated_captures)} test captures have the same frames as a training capture, "
            f"such as {named(corpus, tested)} and {named(corpus, trained)}; accuracy is too high"
        )
    plain = replace(cell, tuning=None) if cell.tuning else cell
    frames = contract.window(plain.untrained, corpus.rate_hz)
    if frames is not None and (short := int((corpus.lengths < frames).sum())):
        lines.append(
            f"warning: {cell.data}: {short} of {len(corpus)} captures are shorter than the {frames}-frame window "
            f"of {cell.model.short_name}; they are padded"
        )
    return [*lines, *(line for one in cell.measurements for line in one.warnings(plan))]


class Left(NamedTuple):
    """A run that is not stored whole, and the number of its missing folds."""

    plan: Plan
    folds: int


def lookup(store: Store, plans: Iterable[Plan]) -> tuple[dict[str, Run], list[Left]]:
    """The runs that are stored whole, by their key, and the others."""
    stored, todo = {}, []
    for plan in {plan.key: plan for plan in plans}.values():
        run = store.find(plan.key, plan.cell.kind)
        if run and is_whole(run) and not store.names(run.info.run_id, run.info.artifact_uri, FOLDS):
            stored[plan.key] = run
        else:
            todo.append(Left(plan, len(plan.folds) - (len(finished(store, run)) if run else 0)))
    return stored, todo


def expected(store: Store, todo: Iterable[Left]) -> list[float | None]:
    """Seconds that the missing folds of each run take with its workers; None where no run like it has a fold."""
    seconds = []
    for plan, folds in todo:
        cell = plan.cell  # objects cannot be typed
        each = None if cell.objects else _of_a_fold(store, cell.kind, cell.arguments())
        seconds.append(each and each * folds / max(1, min(plan.workers, folds)))
    return seconds


def _of_a_fold(store: Store, kind: str, arguments: Mapping[str, str]) -> float | None:
    """Mean seconds of a fold of the stored run in which fewest arguments differ, or itself; the newest of several."""
    names = {key: arguments[key] for key in ("data", "model", "features") if key in arguments}
    like = []
    for run in store.newest(kind, NEWEST, **names):
        theirs = json.loads(run.data.tags.get("touchbench.arguments", "{}"))
        if _fixed(theirs) == _fixed(arguments):
            like.append((len(arguments.items() ^ theirs.items()), run))
    for _, run in sorted(like, key=lambda one: one[0]):
        if (table := store.result(run).tables.get(FOLDS)) is not None:
            done = [*table["seconds"][table["status"] == "FINISHED"]]
        else:  # it was cut off
            done = [result.seconds for result in finished(store, run).values()]
        if done:
            return float(np.mean(done))
    return None


def _fixed(arguments: Mapping[str, str]) -> dict[str, str]:
    return {key: value for key, value in arguments.items() if "." not in key and key not in FREE}
