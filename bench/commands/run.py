"""The commands that make runs: ``bench run``, ``bench stress``, and those of packages."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.errors import InputError
from bench.grammar.options import (
    COMPARE,
    DRY,
    KEYS,
    START,
    Command,
    Option,
    backend_keys,
    backend_of,
    keys,
    parse,
    value_of,
    values_of,
)
from bench.ground.registry import load, loaded, view
from bench.ground.words import ALL, CLEAN, FAULTS, LATER, SMALL, Values

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
        "model.window",
        "number",
        None,
        "seconds per window; a model of whole captures then uses windows",
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
        (),
        "+",
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
    "train_subjects= let each fitted system label the test captures again: under faults, after some of the touch, or "
    "fitted on fewer subjects. An interrupted command continues where it stopped. A TOML file names several grids: "
    "each table has keys of the command line, and lists for several values. Keys above the first table hold for all.",
    "bench run protocol=loso model=cnn85\n"
    f"bench run data=haart {SMALL}\n"
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
    "Trains every fold once and tests it on clean captures and under every fault at five severities. Lists "
    "subjects, classes, conditions and faults whose accuracy is significantly below that of the system. "
    "With several seeds, it also counts captures whose label changes. It is bench run with under= and "
    "train_subjects=. An interrupted command continues where it stopped.",
    "bench stress data=haart protocol=loso model=svm,rf features=jung54\n"
    "bench stress data=haart protocol=loso model=rf seed=0,1,2 faults=noise,shift train_subjects=2,4,8",
    makes="under",
    options=(
        Option(
            "faults",
            "text",
            ALL,
            "faults that damage the test captures, or all",
            (*FAULTS.split(), *LATER.split(), CLEAN),
        ),
        Option("train_subjects", "text", "", "numbers of training subjects for a learning curve"),
        Option("out", "text", "stress", "folder for tables and figures"),
    ),
)


def made(name: str, values: Values) -> pd.DataFrame:
    """The runs of a command that makes runs, by its name."""
    from bench.reading.frame import frame
    from bench.running.loop import execute

    typed = values_of(
        values, keys(name, [key.replace("__", ".") for key in values]).keys() - {DRY.key}
    )
    backend = backend_of(typed)
    return frame(execute(planned(name, {"": typed}, backend), backend))


def command(name: str, arguments: list[str]) -> int:
    """Make the runs that the arguments name, print and write them; exit code 1 if a fold failed."""
    from bench.commands.printing import writable
    from bench.running.loop import execute

    file = arguments[0] if name == "run" and arguments and arguments[0].endswith(".toml") else ""
    values = parse(arguments[bool(file) :], keys(name, arguments[bool(file) :]))
    backend, digest = backend_of(values), ""
    grids: Mapping[str, Values] = {"": values}
    dry = is_dry(values)
    if file:
        from bench.commands.grid import read

        aside = {DRY.key, *backend_keys()}
        if extra := [key for key in values if key not in aside]:
            raise InputError(
                f"{extra[0]}= stands beside {file}, which names what is run; write it in the file"
            )
        digest, grids = read(file, aside)
    plans = planned(name, grids, backend)
    if dry:
        if backend.workers:
            raise InputError(
                "dry=yes looks up runs of this machine's workers; leave out the key of other workers"
            )
        from bench.commands.grid import foreseen

        return foreseen(plans)
    folder = writable(Path(out)) if (out := given_to(name, values).get("out")) else None
    circumstances = dict.fromkeys(one.key for plan in plans for one in plan.cell.circumstances)
    return printed(name, execute(plans, backend, digest), [*circumstances], folder)


def is_dry(values: Values) -> bool:
    """Whether typed values ask what would be run, and for no run."""
    return bool(value_of(DRY, values.get(DRY.key, DRY.default)))


def given_to(name: str, values: Values) -> dict[str, Any]:
    """What a command that makes runs is given besides keys of its cells and workers; its own keys with defaults."""
    usual = {
        one.key: one.default
        for one in load("commands", name).options
        if one.default and "." not in one.key
    }
    of_runs = {*KEYS, *backend_keys(), DRY.key}
    return usual | {
        key: value for key, value in values.items() if key.partition(".")[0] not in of_runs
    }


def planned(name: str, grids: Mapping[str, Values], backend: Backend) -> list[Plan]:
    """What a command is to run of each grid, by its place in words; every run once."""
    from bench.running.loop import prepared

    todo: list[Cell] = []
    for place, values in grids.items():
        try:
            todo += _wanted(name, values)
        except InputError as e:
            raise InputError(f"{place}: {e}" if place else str(e)) from e
    return [*{plan.key: plan for plan in prepared(todo, backend.jobs)}.values()]


def _wanted(name: str, values: Values) -> list[Cell]:
    """The cells of a grid, each with what is measured of it."""
    from bench.plan.cells import cells

    makes, given = load("commands", name).makes, given_to(name, values)
    made = cells({key: value for key, value in values.items() if key not in given})
    given.pop("out", "")
    if "faults" in given:  # what bench stress calls under=
        given["under"] = given["faults"]
    if makes != "run" and (study := load("circumstances", makes)).study:
        return [replace(cell, study=each) for cell in made for each in study.of(given)]
    several = circumstances(given) if given else [()]
    return [replace(cell, circumstances=each) for cell in made for each in several]


def circumstances(values: Values) -> list[tuple[Circumstance, ...]]:
    """Every combination of the circumstances that typed values ask for, by their first option."""
    asked = []
    for one in (c for c in loaded("circumstances").values() if not c.study):
        if one.key in values:
            asked.append(one)
        elif alone := one.fields().keys() & values.keys():
            raise InputError(f"{min(alone)}= needs {one.key}=; add it or leave {min(alone)}= out")
    return [*itertools.product(*(one.of(values) for one in asked))]


def printed(
    name: str, results: list[Result], keys: Sequence[str] = (), folder: Path | None = None
) -> int:
    """Print runs as a command shows them, and write what it writes; the exit code."""
    from bench.commands.printing import output, say, show, then
    from bench.values.table import Table

    main = view(load("commands", name).makes)
    shown: list[tuple[View, Sequence[Result]]] = [(main, results)]
    if name == "run":
        held = ((view(key), [r for r in results if view(key).holds(r)]) for key in keys)
        shown += [
            (one, members) for one, members in held if members
        ]  # a circumstance may have failed
    code = show(results, shown)
    if folder is not None:
        say(*main.write([r for r in results if r.scored and main.holds(r)], folder))
    for one, members in shown:
        for part in one.printed(members):
            part.print(output()) if isinstance(part, Table) else say(part)
    if whole := [r for r in results if r.scored and r.complete]:
        then(main.then(whole))
    return code


def evaluated(todo: list[Cell], backend: Backend) -> list[Result]:
    """Cells of captures, evaluated as ``bench run`` does."""
    from bench.running.loop import execute, prepared

    return execute(prepared(todo, backend.jobs), backend)
