"""The commands that make runs: ``bench run``, ``bench stress``, and those of packages."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import (
    COMPARE,
    DRY,
    RUN_KEYS,
    START,
    Command,
    Option,
    backend_keys,
    backend_of,
    key_options,
    parse_arguments,
    parse_option,
    values_from_keywords,
)
from bench.ground.registry import load_part, load_parts, load_view
from bench.corpora.fault_names import ALL_FAULTS, FAULT_NAMES, MORE_FAULT_NAMES, NO_FAULT
from bench.ground.typed import SMALL_SYSTEM, Values

if TYPE_CHECKING:
    import pandas as pd

    from bench.ground.machine import Backend
    from bench.plan.cells import Cell
    from bench.plan.plan import Plan
    from bench.reports.views.base import View
    from bench.running.circumstances.base import Circumstance
    from bench.values.result import Result

STEPS = (
    Option(
        "model.window", "number", None, "seconds per window, also for a model of whole captures"
    ),
    Option(
        "model.repair", "text", "", "sensor damage to correct", ("stuck", "dead", "offset"), "+"
    ),
    Option(
        "model.scale",
        "text",
        "",
        "divide by the largest reading so far, or take logs",
        ("peak", "log"),
    ),
    Option(
        "model.faults",
        "text",
        "",
        "also train on damaged copies: all, or faults of bench stress",
        joint="+",
    ),
    Option(
        "model.turns", "count", 0, "number of mirrored or rotated copies of each training capture"
    ),
    Option("model.device", "text", "cpu", "device that trains networks", ("cpu", "cuda")),
)
RUN = Command(
    START,
    "evaluate systems under a protocol and store the runs",
    "Evaluates every combination of the given values; commas separate values. A dotted key sets a "
    "parameter of that part. Each combination is one MLflow run. under=, after= and "
    "train_subjects= test each fitted system again: under faults, after some of the touch, or "
    "fitted on fewer subjects. An interrupted command continues where it stopped. A TOML file "
    "names several grids: each table has keys of the command line, and lists for several values. "
    "Keys above the first table hold for all.",
    "bench run protocol=loso model=cnn85\n"
    f"bench run data=haart {SMALL_SYSTEM}\n"
    "bench run data=haart protocol=challenge,loso model=bayes,svm,rf,xgb features=jung28,jung54\n"
    "bench run data=cost model=svm model.C=8,32,128 model.gamma=0.125\n"
    "bench run data=haart model=lda features=touch under=noise,dead_taxels after=250ms,1s\n"
    "bench run data=synth data.subjects=12 data.repetitions=2\n"
    "bench run paper.toml dry=yes",
    "[FILE.toml] [key=value ...]",
    makes="run",
    options=STEPS,
)
STRESS = Command(
    COMPARE,
    "find faults, subjects and conditions under which systems fail",
    "Trains every fold once and tests it on clean captures and under every fault at five "
    "severities. Then bench report lists subjects, classes, conditions and faults whose accuracy is "
    "significantly below that of the system. With several seeds, it also counts captures whose "
    "label changes. bench stress is bench run with under= and train_subjects=. An interrupted "
    "command continues where it stopped.",
    "bench stress data=haart protocol=loso model=svm,rf features=jung54\n"
    "bench stress data=haart protocol=loso model=rf seed=0,1,2 faults=noise,shift "
    "train_subjects=2,4,8",
    makes="under",
    options=(
        Option(
            "faults",
            "text",
            ALL_FAULTS,
            "faults that damage the test captures, or all",
            (*FAULT_NAMES, *MORE_FAULT_NAMES, NO_FAULT),
        ),
        Option("train_subjects", "text", "", "numbers of training subjects for a learning curve"),
    ),
)


def run_from_python(name: str, values: Values) -> pd.DataFrame:
    """Make the runs of a command by keyword arguments; return a row per run."""
    from bench.reading.frame import frame
    from bench.running.loop import run_plans

    known = key_options(name, [key.replace("__", ".") for key in values]).keys() - {DRY.key}
    typed = values_from_keywords(values, known)
    backend = backend_of(typed)
    return frame(run_plans(plan_grids(name, {"": typed}, backend), backend))


def command(name: str, arguments: list[str]) -> int:
    """Make the runs that the arguments name, and print them; exit code 1 if a fold failed."""
    from bench.running.loop import run_plans

    file, digest = "", ""
    if name == "run" and arguments and arguments[0].endswith(".toml"):
        file, *arguments = arguments
    values = parse_arguments(arguments, key_options(name, arguments))
    grids: Mapping[str, Values] = {"": values}
    if file:
        from bench.commands.run_grids import read_grids

        digest, grids = read_grids(file, values)
    backend = backend_of(values)
    plans = plan_grids(name, grids, backend)
    if is_dry(values):
        from bench.commands.run_grids import print_missing_runs

        return print_missing_runs(plans, backend)
    circumstances = dict.fromkeys(each.key for plan in plans for each in plan.cell.circumstances)
    return print_results(name, run_plans(plans, backend, digest), [*circumstances])


def is_dry(values: Values) -> bool:
    """True if typed values ask for a list of the missing runs, and for no run."""
    return bool(parse_option(DRY, values.get(DRY.key, DRY.default)))


def plan_grids(name: str, grids: Mapping[str, Values], backend: Backend) -> list[Plan]:
    """Plan the runs of all grids of a command, each run once.

    Args:
        name: the command.
        grids: typed values, by the place in a file that an error names; "" for a command line.
        backend: the workers.
    """
    from bench.plan.plan import make_plans

    cells: list[Cell] = []
    for place, values in grids.items():
        try:
            cells += _make_cells_of_grid(name, values)
        except InputError as e:
            raise InputError(f"{place}: {e}" if place else str(e)) from e
    return [*{plan.key: plan for plan in make_plans(cells, backend.jobs)}.values()]


def _make_cells_of_grid(name: str, values: Values) -> list[Cell]:
    """Make the cells of a grid, each with the circumstances, or the study, that it names."""
    from bench.plan.grid import make_cells

    shared = {*RUN_KEYS, *backend_keys(), DRY.key}
    options = {key: value for key, value in values.items() if key.partition(".")[0] not in shared}
    cells = make_cells({key: value for key, value in values.items() if key not in options})
    if name == "stress":
        options["under"] = options.pop("faults", ALL_FAULTS)
    makes = load_part("commands", name).makes
    if makes != "run" and (study := load_part("circumstances", makes)).is_run_kind:
        return [replace(cell, study=each) for cell in cells for each in study.from_typed(options)]
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
    from bench.commands.printing import (
        print_lines,
        print_next_commands,
        print_tables,
        results_console,
    )
    from bench.values.table import Table

    main_view = load_view(load_part("commands", name).makes)
    views: list[tuple[View, Sequence[Result]]] = [(main_view, results)]
    for view in map(load_view, circumstances if name == "run" else ()):
        if members := [r for r in results if view.holds(r)]:  # none if all of them failed
            views.append((view, members))
    exit_code = print_tables(results, views)
    for view, members in views:
        for part in view.printed(members):
            part.print(results_console()) if isinstance(part, Table) else print_lines(part)
    if complete := [r for r in results if r.has_scores and r.is_complete]:
        print_next_commands(main_view.then(complete))
    return exit_code


def run_cells(cells: list[Cell], backend: Backend) -> list[Result]:
    """Run cells of captures as ``bench run`` does; return a result for each."""
    from bench.plan.plan import make_plans
    from bench.running.loop import run_plans

    return run_plans(make_plans(cells, backend.jobs), backend)
