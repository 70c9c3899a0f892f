"""Grids as a whole: those that a file names, and what a command would run of them."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import KEYS, keys, values_of
from bench.ground.progress import about
from bench.ground.words import spelled, text_of
from bench.values.result import several

if TYPE_CHECKING:
    from bench.plan.plan import Plan

DOTTED = 'write a key with a dot in quotes, such as "model.C" = 8'


def read(file: str, aside: Collection[str]) -> tuple[str, dict[str, dict[str, object]]]:
    """The digest of a file, and the values of ``bench run`` of each of its tables, by its place in words.

    Keys above the first table hold for all tables; without tables, they are one grid. Keys ``aside`` are refused.
    """
    try:
        content = Path(file).read_bytes()
        table = tomllib.loads(content.decode())
    except (OSError, UnicodeError) as e:
        why = getattr(e, "strerror", None) or "not UTF-8 text"
        raise InputError(f"{file}: {why}; give a TOML file of grids, see bench run --help") from e
    except (ValueError, RecursionError) as e:
        raise InputError(f"{file} is not TOML: {e}; {DOTTED}") from e
    shared = {key: value for key, value in table.items() if not isinstance(value, dict)}
    own = {f"{file} [{name}]": value for name, value in table.items() if isinstance(value, dict)}
    if wrong := [
        name for name in KEYS if isinstance(table.get(name), dict)
    ]:  # model.C = 8 is a table to TOML
        raise InputError(
            f"{file} [{wrong[0]}] has the name of a key; give another one, or {DOTTED}"
        )
    grids = {place: shared | values for place, values in (own or {file: {}}).items()}
    if not any(grids.values()):
        raise InputError(
            f'{file}: it names nothing to run; write keys of bench run, such as model = ["svm", "rf"]'
        )
    known = {*keys("run", [key for values in grids.values() for key in values])} - {*aside}
    typed_values = {}
    for place, values in grids.items():
        try:
            typed_values[place] = values_of(
                {key: _typed(key, value) for key, value in values.items()}, known
            )
        except InputError as e:
            raise InputError(f"{place}: {e}") from e
    return hashlib.sha256(content).hexdigest()[:16], typed_values


def _typed(key: str, value: object) -> str | list[str]:
    """A value of a file as the command line has it; a list has several."""
    if isinstance(value, dict):
        raise InputError(f"{key} is a table; {DOTTED}")
    if isinstance(value, list):
        return [str(_typed(key, one)) for one in value]
    if not isinstance(value, str | int | float):
        raise InputError(f"{key} = {value}: give text, a number, true or false, or a list of these")
    return text_of(value)


def foreseen(plans: Sequence[Plan]) -> int:
    """Print which runs are stored, which are missing, and how long these take; the exit code."""
    from bench.commands.printing import output, say
    from bench.running.loop import expected, lookup
    from bench.store.client import connect
    from bench.values.measures import Measure, text
    from bench.values.table import Table

    store = connect()
    _, todo = lookup(store, plans)
    times = {
        id(one.plan): (one.folds, time)
        for one, time in zip(todo, expected(store, todo), strict=True)
    }
    arguments = [plan.cell.arguments() for plan in plans]
    shared = (
        dict(set.intersection(*(set(one.items()) for one in arguments))) if len(plans) > 1 else {}
    )
    rows = []
    for plan, own in zip(plans, arguments, strict=True):
        missing, time = times.get(id(plan), (0, None))
        words = about(time) if time is not None else "unknown" if missing else None
        own_keys = spelled({k: v for k, v in own.items() if k not in shared})
        rows.append(
            {
                "run": own_keys,
                "stored": f"{len(plan.folds) - missing} of {len(plan.folds)}",
                "time": words,
            }
        )
    title = spelled({key: value for key, value in arguments[0].items() if key in shared})
    columns = [text("run"), Measure("stored", "stored folds"), Measure("time")]
    Table(columns, rows, title or "Time from similar stored runs").print(output())
    say(_summary(len(plans), [time for _, time in times.values()]))
    return 0


def _summary(runs: int, seconds: Sequence[float | None]) -> str:
    """Numbers of runs in all, stored and missing, and the time of the missing ones."""
    known, unknown = (
        [time for time in seconds if time is not None],
        sum(time is None for time in seconds),
    )
    line = f"{several(runs, 'run')}, {runs - len(seconds)} stored"
    if known:
        line += f", {about(sum(known))}" + f" for {len(known)} of the others" * bool(unknown)
    return line + f"; time unknown for {several(unknown, 'run')}: no similar run is stored" * bool(
        unknown
    )
