"""The command ``bench compare``: compare two systems on the same captures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from bench.commands.printing import print_lines, refuse_unwritable, results_console
from bench.errors import InputError
from bench.grammar.options import (
    RUN_KEYS,
    STORED_OPTIONS,
    key_options,
    parse_words,
    values_from_keywords,
)
from bench.ground.scratch import write_then_rename
from bench.ground.typed import Values, split_values
from bench.plan.grid import make_cells
from bench.reading.compare import (
    Compared,
    Side,
    compare_sides,
    find_runs,
    side_of_file,
    side_of_frame,
    sides_of_runs,
)
from bench.reading.runs import load_all_runs, parse_selection, select_or_fail, select_runs
from bench.store.client import connect
from bench.values.measures import Measure, text_measure
from bench.values.result import Result
from bench.values.table import Table, rows_of_frame, write_sheet

GESTURES = (
    text_measure("gesture"),
    Measure("captures", form=".0f"),
    Measure("accuracy", "A %"),
    Measure("other_accuracy", "B %"),
    Measure("difference", "A - B", form="+.1f", ends="difference"),
    Measure("only", "only A right", form=".0f"),
    Measure("other_only", "only B right", form=".0f"),
)
CAPTURES = ("data", "where", "target", "protocol")  # keys that tell which captures were tested


def command(arguments: list[str]) -> int:
    """Print how two systems differ, and write their captures."""
    words, values = parse_words(arguments, key_options("compare"), 2)
    if len(words) < 2:
        raise InputError(
            "give two files, systems or runs: bench compare A B; see bench compare --help"
        )
    out = values.pop("out", "")
    result = compare_systems(words, values)
    print_lines(*repr(result).splitlines())
    ends = {"low": "difference_low", "high": "difference_high"}
    rows = rows_of_frame(result.gestures.rename(columns=ends))
    title = (
        f"A: {result.system}; B: {result.other}; means over subjects, not corrected for several "
        "gestures"
    )
    Table(GESTURES, rows, title).print(results_console())
    if out:
        with refuse_unwritable(Path(out)), write_then_rename(Path(out)) as unfinished:
            write_sheet(result.captures, unfinished)
        print_lines(f"{out}: {len(result.captures)} captures")
    return 0


def compare_systems(systems: Sequence[object], values: Values) -> Compared:
    """Compare two systems.

    Args:
        systems: a table, a file, keys of ``bench run``, or a name or run id of ``bench runs`` each.
        values: keys that select stored runs.
    """
    typed = values_from_keywords(values, {option.key for option in STORED_OPTIONS})
    sides = _read_files(systems)
    first, second = sides
    if first and second:
        if typed:
            raise InputError(
                f"{[*typed][0]}= selects stored runs, and both are files; leave it out"
            )
        return compare_sides(first, second)
    results = select_or_fail(load_all_runs(connect()), parse_selection(typed))
    found = {i: _find_runs(system, results) for i, system in enumerate(systems) if sides[i] is None}
    stored = sides_of_runs(dict(found.values()))
    first, second = (side or stored[found[i][0]] for i, side in enumerate(sides))
    return compare_sides(first, second)


def _read_files(systems: Sequence[object]) -> list[Side | None]:
    """The sides that are tables or files; None for stored systems."""
    sides: list[Side | None] = []
    files = [Path(system).name if isinstance(system, str | Path) else "" for system in systems]
    titles = ("the first table", "the second table")
    for system, file, title in zip(systems, files, titles, strict=True):
        if isinstance(system, pd.DataFrame):
            sides.append(side_of_frame(system, title))
        elif _is_file(system):
            name = str(system) if files.count(file) > 1 else file
            sides.append(side_of_file(Path(str(system)), name))
        else:
            sides.append(None)
    return sides


def _is_file(system: object) -> bool:
    """True for a path, and for text that ends like a file of predictions or names a file."""
    if isinstance(system, Path):
        return True
    if not isinstance(system, str):
        return False
    return system.lower().endswith((".csv", ".parquet")) or Path(system).is_file()


def _find_runs(system: object, results: Sequence[Result]) -> tuple[str, list[Result]]:
    """The name and the stored runs of one system, given by keys of ``bench run``, name or id."""
    if not isinstance(system, Mapping):
        return str(system), find_runs(str(system), results)
    values = values_from_keywords(system, RUN_KEYS)
    captures = {key: split_values(key, values.pop(key)) for key in CAPTURES if key in values}
    names = {cell.system_name() for cell in make_cells(values)}
    if len(names) > 1:
        raise InputError(f"{system} describes {len(names)} systems; give one")
    (name,) = names
    return name, find_runs(name, select_runs(results, captures))
