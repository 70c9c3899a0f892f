"""The commands that make runs: ``bench run`` and others."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.arguments import backend_of, parse
from bench.commands.printing import output, say, show, then, writable
from bench.errors import InputError
from bench.options import keys, makers, measured
from bench.plan.cells import Cell, cells
from bench.registry import check_loaded, circumstance_views, classes, views
from bench.result import Result
from bench.table import Table
from bench.words import Values
from bench.work.backend import Backend
from bench.work.loop import execute, prepared

if TYPE_CHECKING:
    from bench.circumstances.base import Circumstance
    from bench.reports.views.base import View


def command(name: str, arguments: list[str]) -> int:
    """Make the runs that the arguments name, print and write them; exit code 1 if a fold failed.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    try:
        values = parse(arguments, keys(name))
    except InputError:
        check_loaded()  # the key may be one of such a package
        raise
    todo, out = planned(name, values)
    folder = writable(Path(out)) if out else None
    return printed(name, execute(todo, backend_of(values)), folder)


def made(name: str, values: Values) -> list[Result]:
    """The runs of some values.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return execute(planned(name, values)[0], backend_of(values))


def planned(name: str, values: Values) -> tuple[list, str]:
    """What a command is to run, and the folder of ``out=``; empty for none.

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    one = makers()[name]
    own = {option.key for option in measured(one)} | {*one.given}
    of_cells = {k: v for k, v in values.items() if k not in own and k.partition(".")[0] not in own}
    given = {**one.given, **{k: v for k, v in values.items() if k not in of_cells}}
    out = str(values.get("out", one.out[0])) if one.out[0] else ""
    every = classes("circumstances")
    if (study := every.get(one.makes)) and study.study:
        studies = study.of(given)
        todo = [replace(s.ready(cell), study=s) for cell in cells(of_cells) for s in studies]
    else:
        several = circumstances(given)
        todo = [replace(cell, circumstances=each) for cell in cells(of_cells) for each in several]
    return prepared(todo, backend_of(values).jobs), out


def circumstances(values: Values) -> list[tuple[Circumstance, ...]]:
    """Every combination of the circumstances that typed values ask for, by their first option.

    Raises:
        InputError: a value cannot be used, or belongs to a circumstance that was not asked for.
    """
    asked = []
    for one in (c for c in classes("circumstances").values() if not c.study):
        names = [n for name, (_, alias) in one.fields().items() for n in (name, alias) if n]
        first, (_, alias) = next(iter(one.fields().items()))
        if {first, alias} & {*values}:
            asked.append(one)
        elif alone := {*names} & {*values}:
            raise InputError(f"{min(alone)}= needs {one.key}=; add it or leave {min(alone)}= out")
    return [*itertools.product(*(one.of(values) for one in asked))]


def printed(name: str, results: list[Result], folder: Path | None = None) -> int:
    """Print runs as a command shows them, and write what it writes; the exit code.

    Args:
        name: command whose view is shown; ``bench run`` shows captures, and each circumstance.
        results: results of one kind of run.
        folder: folder of ``out=``.
    """
    view = views()[makers()[name].makes]
    shown: list[tuple[View, Sequence[Result]]] = [(view, results)]
    if name == "run":
        held = ((one, [r for r in results if one.holds(r)]) for one in circumstance_views())
        shown += [(one, members) for one, members in held if members]
    code = show(results, shown)
    if folder is not None:
        say(*view.write([r for r in results if r.scored and view.holds(r)], folder))
    for one, members in shown:
        for part in one.printed(members):
            part.print(output()) if isinstance(part, Table) else say(part)
    then(view.then(results))
    return code


def evaluated(todo: list[Cell], backend: Backend) -> list[Result]:
    """Cells of captures, evaluated as ``bench run`` does.

    Raises:
        InputError: something in the cells or the data cannot be used; nothing was run.
    """
    return execute(prepared(todo, backend.jobs), backend)
