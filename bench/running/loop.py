"""The one loop: run the missing folds of plans, store each as it finishes, and measure the runs."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.duplicates import describe_capture
from bench.corpora.library import first_warnings, left_out_message
from bench.errors import ClusterError
from bench.ground.closed import close_corpora
from bench.ground.progress import console, warn
from bench.plan.plan import Plan
from bench.running.audit import describe_difference, mean_probabilities
from bench.running.bar import Bar
from bench.running.fold import limit_threads, take_evenly
from bench.running.tracking import (
    FOLDS,
    has_fold_files,
    is_finished,
    load_finished_folds,
    load_finished_run,
    open_run,
)
from bench.running.workers import FoldExecutor, fresh_modules, local_executor
from bench.store.client import Store, connect
from bench.store.database import RunLocked, lock_run
from bench.values.result import Result, format_count

if TYPE_CHECKING:
    from mlflow.entities import Run

FITTED_TWICE = 3  # captures of a class to which an own system is fitted twice
NEWEST = 20  # runs among which a similar one is looked for: a store may have thousands
SIMILAR = ("data", "model", "features")  # arguments by which similar runs are looked for
FREE = ("seed", "protocol")  # similar runs may differ in these arguments and all dotted ones


class Interrupted(KeyboardInterrupt):
    """Ctrl-C after finished results were stored."""


def run_plans(
    plans: Sequence[Plan], executor: FoldExecutor | None = None, grid: str = ""
) -> list[Result]:
    """Run the missing folds of plans; read finished runs from the store.

    Args:
        plans: the runs.
        executor: runs the folds; None for worker processes of this machine.
        grid: digest of the file that names the runs, which is tracked with them.

    Returns:
        The run of each plan.
    """
    try:
        with executor or local_executor() as workers:
            if workers.threads:
                plans = [replace(plan, threads=workers.threads) for plan in plans]
            for line in dict.fromkeys(line for plan in plans for line in warnings_of_plan(plan)):
                warn(line)
            store = connect(writes=True)
            stored, unfinished = find_stored_runs(store, plans)
            for plan in {plan.cell.system_name(): plan for plan, _ in unfinished}.values():
                if fits_differ(plan):
                    warn(
                        f"warning: {plan.cell.system_name()}: two fits to the same captures "
                        "differ, so its numbers cannot be repeated; use a parameter seed as "
                        "random_state"
                    )
            count = len(stored) + len(unfinished)
            if stored:
                line = f"{len(stored)} of {format_count(count, 'run')} already stored"
                console.print(line, highlight=False)
            folds = [count for _, count in unfinished]
            times = estimate_seconds(store, unfinished) if len(folds) > 1 else [None] * len(folds)
            waiting = [pair for pair in zip(folds, times, strict=True) if pair[0]]
            results = {key: load_finished_run(store, run, grid) for key, run in stored.items()}
            with Bar(count, len(stored), waiting) as bar:
                for plan, result in _run_unlocked(
                    [plan for plan, _ in unfinished],
                    lambda plan: _run_plan(store, plan, workers, bar, grid),
                ):
                    results[plan.key] = result
            for plan in plans:
                if effect := results[plan.key].get("touchbench.batch_effect"):
                    warn(f"warning: {plan.cell.system_name()}: {effect}")
            return [results[plan.key] for plan in plans]
    except KeyboardInterrupt as e:
        raise Interrupted(
            "interrupted; every finished fold is stored, and the same command continues from there"
        ) from e


def _run_unlocked(
    plans: Sequence[Plan], run_plan: Callable[[Plan], Result]
) -> Iterator[tuple[Plan, Result]]:
    """Run plans; those that another process runs come last, and again while others finish.

    Raises:
        RunLocked: only plans that other processes run are left.
    """
    while plans:
        locked = []
        for plan in plans:
            try:
                yield plan, run_plan(plan)
            except RunLocked as e:
                locked.append(plan)
                error = e
        if len(locked) == len(plans):
            raise error
        plans = locked


def _run_plan(store: Store, plan: Plan, workers: FoldExecutor, bar: Bar, grid: str) -> Result:
    """Run the missing folds of a plan, and measure its run."""
    with lock_run(plan.key):
        stored = store.find_run(plan.key, plan.cell.kind)
        if stored and is_finished(stored):  # by another process, or cut off at the very end
            if has_fold_files(store, stored):
                store.delete_artifact(stored.info.artifact_uri, FOLDS)
            return load_finished_run(store, stored, grid)
        run = open_run(store, plan, stored, grid)
        missing = run.missing_folds
        if not missing:
            return run.store_result()
        bar.begin_run(plan.cell.title(), len(plan.folds), [fold.name for fold in missing])
        try:
            has_warned = False
            for fold_result in workers.run_folds(plan, missing):
                if fold_result.printed and not has_warned:
                    has_warned = True
                    name = plan.cell.system_name()
                    warn(f"{name} prints {fold_result.printed}, in a fold; jobs=1 shows them")
                run.store_fold(fold_result)
                bar.end_fold(fold_result)
        except (KeyboardInterrupt, ClusterError):
            store.set_status(run.info.run_id, "KILLED")  # stored folds stay and are found again
            raise
        result = run.store_result()
        bar.end_run()
        return result


def warnings_of_plan(plan: Plan) -> list[str]:
    """Return warnings before the run."""
    cell, corpus = plan.cell, plan.corpus
    lines, prefix = [], f"warning: {cell.data}: "
    if damage := corpus.info.get("warnings"):
        lines.append(prefix + first_warnings(damage, f"bench data show {cell.data}"))
    if not cell.run_kind and (message := left_out_message(corpus)):
        lines.append(message)
    if plan.mixes_subjects:
        lines.append(
            f"warning: protocol={cell.protocol} trains and tests on the same subjects; expect "
            "lower accuracy for a new person"
        )
    if repeated := plan.repeated_captures:
        tested, trained = (describe_capture(corpus, position) for position in repeated[0])
        lines.append(
            f"{prefix}{len(repeated)} test captures have the same frames as a training capture, "
            f"such as {tested} and {trained}; accuracy is too high"
        )
    untuned = replace(cell, tuning=None) if cell.tuning else cell
    frames = contract.window_frames(untuned.untrained_system, corpus.rate_hz)
    if frames is not None and (short := int((corpus.lengths < frames).sum())):
        lines.append(
            f"{prefix}{short} of {len(corpus)} captures are shorter than the {frames}-frame window "
            f"of {cell.model.short_name}; they are padded"
        )
    for extension in cell.extensions:
        lines += extension.warnings_of_plan(plan)
    return lines


def fits_differ(plan: Plan) -> bool:
    """Fit an own system twice to a few captures; return True if the predictions differ.

    A system that fails on so few captures is left to its folds.
    """
    cell, corpus, fold = plan.cell, plan.corpus, plan.folds[0]
    if not (cell.model.module or cell.objects) or cell.run_kind:
        return False
    labels = pd.Series(corpus.gestures[fold.train])
    few = fold.train[labels.groupby(labels).cumcount() < FITTED_TWICE]
    with (
        suppress(Exception, SystemExit),
        fresh_modules(),
        close_corpora(),
        redirect_stdout(io.StringIO()),
        warnings.catch_warnings(),
        limit_threads(plan.threads),
    ):
        warnings.simplefilter("ignore")
        part, tested = corpus[few], corpus[take_evenly(fold.test, FITTED_TWICE * labels.nunique())]
        systems = [contract.fit_system(cell.estimator(), part, part.gestures) for _ in range(2)]
        first, second = (mean_probabilities(system, tested) for system in systems)
        return bool(describe_difference(first, second))
    return False


def find_stored_runs(
    store: Store, plans: Iterable[Plan]
) -> tuple[dict[str, Run], list[tuple[Plan, int]]]:
    """Find finished runs by their key, and the other plans with their number of missing folds."""
    stored, unfinished = {}, []
    for plan in {plan.key: plan for plan in plans}.values():
        run = store.find_run(plan.key, plan.cell.kind)
        if run is None:
            unfinished.append((plan, len(plan.folds)))
        elif is_finished(run) and not has_fold_files(store, run):
            stored[plan.key] = run
        else:
            unfinished.append((plan, len(plan.folds) - len(load_finished_folds(store, run))))
    return stored, unfinished


def estimate_seconds(store: Store, unfinished: Iterable[tuple[Plan, int]]) -> list[float | None]:
    """Estimate the seconds of the missing folds of each plan; None without a similar stored run."""
    seconds = []
    find_newest = cache(lambda kind, *names: store.newest_runs(kind, NEWEST, **dict(names)))
    for plan, folds in unfinished:
        cell, mean = plan.cell, None
        if not cell.objects:  # which cannot be typed
            arguments = cell.arguments()
            names = [(key, arguments[key]) for key in SIMILAR if key in arguments]
            mean = _mean_fold_seconds(store, find_newest(cell.kind, *names), arguments)
        seconds.append(mean and mean * folds / max(1, min(plan.workers, folds)))
    return seconds


def _mean_fold_seconds(
    store: Store, runs: Iterable[Run], arguments: Mapping[str, str]
) -> float | None:
    """Mean seconds of a fold of the most similar of stored runs, the newest of several."""
    similar = []
    for run in runs:
        stored = json.loads(run.data.tags.get("touchbench.arguments", "{}"))
        if _fixed_arguments(stored) == _fixed_arguments(arguments):
            similar.append((len(arguments.items() ^ stored.items()), run))
    for _, run in sorted(similar, key=lambda pair: pair[0]):
        table = store.load_result(run).tables.get(FOLDS)
        if table is None:  # it was cut off
            seconds = [fold.seconds for fold in load_finished_folds(store, run).values()]
        else:
            seconds = [*table["seconds"][table["status"] == "FINISHED"]]
        if seconds:
            return float(np.mean(seconds))
    return None


def _fixed_arguments(arguments: Mapping[str, str]) -> dict[str, str]:
    """Arguments in which similar runs are equal."""
    return {key: value for key, value in arguments.items() if "." not in key and key not in FREE}
