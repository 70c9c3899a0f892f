"""Of ``bench run``: grids in a TOML file, and the runs that are still missing (``dry=yes``)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from bench.commands.printing import print_lines, results_console
from bench.errors import InputError
from bench.grammar.options import DRY, RUN_KEYS, executor_keys, key_options, values_from_keywords
from bench.ground.progress import format_estimate
from bench.ground.typed import DOTTED, Values, format_arguments, format_value, parse_toml
from bench.plan.plan import Plan
from bench.running.loop import estimate_seconds, find_stored_runs
from bench.running.workers import FoldExecutor
from bench.store.client import connect
from bench.values.measures import Measure, text_measure
from bench.values.result import format_count
from bench.values.table import Table


def read_grids(file: str, typed: Values) -> tuple[str, dict[str, dict[str, object]]]:
    """Read the digest of a file of grids, and the values of ``bench run`` of each grid.

    A table of the file is a grid, by its place in words. Keys above the first table hold for all
    tables; without tables, they are one grid. The keys ``typed`` beside the file may only say
    whether and where runs are made, and the file may not.
    """
    not_in_files = {DRY.key, *executor_keys()}
    if extra := [key for key in typed if key not in not_in_files]:
        raise InputError(
            f"{extra[0]}= stands beside {file}, which names what is run; write it in the file"
        )
    try:
        content = Path(file).read_bytes()
        document = parse_toml(content)
    except OSError as e:
        raise InputError(
            f"{file}: {e.strerror}; give a TOML file of grids, see bench run --help"
        ) from e
    except InputError as e:
        raise InputError(f"{file}: {e}") from e
    shared = {key: value for key, value in document.items() if not isinstance(value, dict)}
    tables = {key: value for key, value in document.items() if isinstance(value, dict)}
    if keys_of_run := [key for key in RUN_KEYS if key in tables]:  # model.C = 8 is a table to TOML
        raise InputError(
            f"{file} [{keys_of_run[0]}] has the name of a key; give another one, or {DOTTED}"
        )
    grids = {f"{file} [{name}]": shared | table for name, table in tables.items()}
    grids = grids or {file: shared}
    if not any(grids.values()):
        example = 'model = ["svm", "rf"]'
        raise InputError(
            f"{file}: it names nothing to run; write keys of bench run, such as {example}"
        )
    known = {*key_options("run", [key for grid in grids.values() for key in grid])} - not_in_files
    values = {}
    for place, grid in grids.items():
        try:
            texts = {key: _as_typed(key, value) for key, value in grid.items()}
            values[place] = values_from_keywords(texts, known)
        except InputError as e:
            raise InputError(f"{place}: {e}") from e
    return hashlib.sha256(content).hexdigest()[:16], values


def _as_typed(key: str, value: object) -> str | list[str]:
    """A value of a file as the command line has it; a list has format_count."""
    if isinstance(value, dict):
        raise InputError(f"{key} is a table; {DOTTED}")
    if isinstance(value, list):
        return [str(_as_typed(key, each)) for each in value]
    if not isinstance(value, str | int | float):
        raise InputError(f"{key} = {value}: give text, a number, true or false, or a list of these")
    return format_value(value)


def print_missing_runs(plans: Sequence[Plan], executor: FoldExecutor) -> int:
    """Print which runs are stored, which are missing, and their time; return the exit code."""
    from bench.running.estimates import estimate_from_work  # no other run needs it

    if executor.is_remote:
        raise InputError(
            "dry=yes looks up runs of this machine's workers; leave out the key of other workers"
        )
    store = connect()
    _, unfinished = find_stored_runs(store, plans)
    times = estimate_seconds(store, unfinished)
    rough = 0
    for place, (plan, folds) in enumerate(unfinished):
        if times[place] is None and (seconds := estimate_from_work(plan)) is not None:
            times[place] = seconds * folds / max(1, min(plan.workers, folds))
            rough += 1
    missing = {}
    for (plan, folds), seconds in zip(unfinished, times, strict=True):
        missing[id(plan)] = folds, seconds
    arguments = [plan.cell.arguments() for plan in plans]
    shared = set.intersection(*(set(each.items()) for each in arguments)) if plans[1:] else set()
    rows = []
    for plan, own in zip(plans, arguments, strict=True):
        folds, seconds = missing.get(id(plan), (0, None))
        time = format_estimate(seconds) if seconds is not None else "unknown" * bool(folds)
        run = format_arguments({k: v for k, v in own.items() if (k, v) not in shared})
        stored = f"{len(plan.folds) - folds} of {len(plan.folds)}"
        rows.append({"run": run, "stored": stored, "time": time or None})
    title = format_arguments({k: v for k, v in arguments[0].items() if (k, v) in shared})
    columns = [text_measure("run"), Measure("stored", "stored folds"), Measure("time")]
    Table(columns, rows, title or "Time from similar stored runs").print(results_console())
    print_lines(_summarise_missing(len(plans), times, rough))
    return 0


def _summarise_missing(runs: int, times: Sequence[float | None], rough: int) -> str:
    """Numbers of runs in all, stored and missing, and the seconds of the missing ones."""
    known = [seconds for seconds in times if seconds is not None]
    unknown = len(times) - len(known)
    line = f"{format_count(runs, 'run')}, {runs - len(times)} stored"
    if known:
        line += f", {format_estimate(sum(known))}"
    if known and unknown:
        line += f" for {len(known)} of the others"
    if rough:
        line += f"; {format_count(rough, 'time')} rough: no similar run is stored"
    if unknown:
        line += f"; time unknown for {format_count(unknown, 'run')}: no similar run is stored"
    return line
