"""The commands that make runs: ``bench run``, ``bench stress``, and those of packages."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import pandas as pd

from bench.commands.printing import (
    print_lines,
    print_next_commands,
    print_results_and_failures,
    results_console,
)
from bench.commands.run_grids import print_missing_runs, read_grids
from bench.corpora.fault_names import ALL_FAULTS
from bench.errors import InputError
from bench.grammar.options import (
    DRY,
    RUN_KEYS,
    executor_keys,
    key_options,
    make_executor,
    parse_option,
    values_from_keywords,
)
from bench.ground.progress import warn
from bench.ground.registry import load_part, load_parts, load_view
from bench.ground.typed import Values
from bench.plan.cells import Cell
from bench.plan.grid import make_cells
from bench.plan.plan import Plan, make_plans
from bench.reading.frame import runs_table
from bench.running.loop import run_plans
from bench.running.workers import FoldExecutor
from bench.store.database import RunLocked
from bench.values.result import Result
from bench.values.table import Table

if TYPE_CHECKING:
    from bench.reports.views.base import View
    from bench.running.circumstances.base import Circumstance


WAIT = 10  # seconds until runs of another process are looked for again


def command(name: str, values: Values, file: str = "") -> int:
    """Make and print the runs of typed values, or of a file; exit code 1 if a fold failed."""
    digest, grids = read_grids(file, values) if file else ("", {"": values})
    executor = make_executor(values)
    plans = plan_grids(name, grids, executor)
    if is_dry(values):
        return print_missing_runs(plans, executor)
    circumstances = dict.fromkeys(each.key for plan in plans for each in plan.cell.circumstances)
    return print_results(name, run_plans(plans, executor, digest), [*circumstances])


def run_from_python(name: str, values: Values) -> pd.DataFrame:
    """Make the runs of a command by keyword arguments; return a row per run."""
    known = key_options(name, [key.replace("__", ".") for key in values]).keys() - {DRY.key}
    typed = values_from_keywords(values, known)
    executor = make_executor(typed)
    return runs_table(run_plans(plan_grids(name, {"": typed}, executor), executor))


def is_dry(values: Values) -> bool:
    """True if typed values ask for a list of the missing runs, and for no run."""
    return bool(parse_option(DRY, values.get(DRY.key, DRY.default)))


def plan_grids(name: str, grids: Mapping[str, Values], executor: FoldExecutor) -> list[Plan]:
    """Plan the runs of all grids of a command, each run once.

    Args:
        name: the command.
        grids: typed values, by the place in a file that an error names; "" for a command line.
        executor: runs the folds.
    """
    cells: list[Cell] = []
    for place, values in grids.items():
        try:
            cells += _make_cells_of_grid(name, values)
        except InputError as e:
            raise InputError(f"{place}: {e}" if place else str(e)) from e
    return [*{plan.key: plan for plan in make_plans(cells, executor.jobs)}.values()]


def _make_cells_of_grid(name: str, values: Values) -> list[Cell]:
    """Make the cells of a grid, each with the circumstances, or the kind of run, that it names."""
    shared = {*RUN_KEYS, *executor_keys(), DRY.key}
    options = {key: value for key, value in values.items() if key.partition(".")[0] not in shared}
    cells = make_cells({key: value for key, value in values.items() if key not in options})
    if name == "stress":
        options["under"] = options.setdefault("faults", ALL_FAULTS)
    makes = load_part("commands", name).makes
    if makes != "run" and (kind := load_part("circumstances", makes)).is_run_kind:
        return [replace(cell, run_kind=each) for cell in cells for each in kind.from_typed(options)]
    combinations = combine_circumstances(options) if options else [()]
    return [replace(cell, circumstances=each) for cell in cells for each in combinations]


def combine_circumstances(values: Values) -> list[tuple[Circumstance, ...]]:
    """Return every combination of the circumstances whose first option has typed values."""
    chosen = []
    for circumstance in load_parts("circumstances").values():
        if circumstance.is_run_kind:
            continue
        key = circumstance.key
        if key in values:
            chosen.append(circumstance.from_typed(values))
        elif alone := circumstance.options_by_key().keys() & values.keys():
            raise InputError(f"{min(alone)}= needs {key}=; add it or leave {min(alone)}= out")
    return [*itertools.product(*chosen)]


def print_results(name: str, results: list[Result], circumstances: Iterable[str] = ()) -> int:
    """Print runs, and their circumstances, as a command shows them; return the exit code."""
    main_view = load_view(load_part("commands", name).makes)
    views: list[tuple[View, Sequence[Result]]] = [(main_view, results)]
    for view in map(load_view, circumstances if name == "run" else ()):
        if shown := [r for r in results if view.applies_to(r)]:  # none if all of them failed
            views.append((view, shown))
    exit_code = print_results_and_failures(results, views)
    for view, members in views:
        for part in view.further_output(members):
            part.print(results_console()) if isinstance(part, Table) else print_lines(part)
    if complete := [r for r in results if r.has_scores and r.is_complete]:
        print_next_commands(main_view.next_command(complete))
    return exit_code


def run_cells(cells: list[Cell], executor: FoldExecutor) -> list[Result]:
    """Run cells of captures as ``bench run`` does; return a result for each."""
    return run_plans(make_plans(cells, executor.jobs), executor)


def run_complete(cells: Sequence[Cell], values: Values) -> list[Result]:
    """Run cells with the workers that typed values name; refuse to go on without one of the folds.

    Waits for cells that another process runs, such as a second search.

    Raises:
        InputError: a fold failed.
    """
    results: list[Result] = []
    while not results:
        try:
            results = run_cells([*cells], make_executor(values))
        except RunLocked:
            warn("another process is evaluating what is left; waiting for it")
            time.sleep(WAIT)
    for result in results:
        for fold, failure in result.errors.items():
            reason = f"{failure.reason}; traceback: {failure.where}"
            raise InputError(f"{result.system}: fold {fold} failed: {reason}")
    return results
