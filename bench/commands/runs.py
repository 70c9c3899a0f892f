"""The command ``bench runs``: list stored runs, name their system, or delete them."""

from __future__ import annotations

import sys
from datetime import datetime

from bench.commands.printing import CONTEXT_COLUMNS, print_lines, results_console
from bench.errors import InputError
from bench.grammar.options import typed_settings
from bench.ground.registry import registered_parts
from bench.ground.typed import Values
from bench.reading.captures import stale_sentences
from bench.reading.frame import name_rows
from bench.reading.runs import load_all_runs, parse_selection, select_or_fail
from bench.store.client import Store, connect
from bench.store.database import lock_run
from bench.values.measures import percent_measure, text_measure
from bench.values.result import NAME_TAG, Result, format_count
from bench.values.sentences import shorten_list
from bench.values.table import Table

STATES = {"RUNNING": "goes on, or was cut off", "KILLED": "interrupted"}


def command(values: Values) -> int:
    """List the selected runs, or delete them; exit code 1 if the user says no."""
    settings = typed_settings("runs", values)
    selection = parse_selection(values)
    if settings["delete"] and not selection:
        raise InputError(
            "delete=yes: select the runs to delete, such as data=haart, model=svm or run=ID"
        )
    if settings["delete"] and not settings["yes"] and not sys.stdin.isatty():
        raise InputError(
            "delete=yes asks before it deletes, and there is no terminal to ask; add yes=yes"
        )
    store = connect(writes=settings["delete"] or bool(settings["name"]))
    every = load_all_runs(store)
    results = select_or_fail(every, selection)
    if settings["name"]:
        _name_system(store, settings["name"], results, every)
        results = select_or_fail(load_all_runs(store), selection)
    table_of_stored_runs(results).print(results_console())
    print_lines(*stale_sentences(results))
    if not settings["delete"]:
        return 0
    count = format_count(len(results), "run")
    if not settings["yes"] and not _confirm(f"Delete {count}? [yes/no] "):
        print_lines("no run is deleted")
        return 1
    for result in results:
        with lock_run(result["touchbench.cell"]):
            store.delete_run(result["run_id"])
    restore = f"mlflow runs restore --run-id {results[0]['run_id']}"
    print_lines(f"{count} deleted; to bring one back: {restore}")
    return 0


def _name_system(store: Store, name: str, results: list[Result], every: list[Result]) -> None:
    """Give the system of some runs a short name, in MLflow, too.

    Raises:
        InputError: these are several systems, or another one has this name.
    """
    systems = sorted({r["system"] for r in results})
    if len(systems) > 1:
        raise InputError(
            f"name={name}: these are {len(systems)} systems ({shorten_list(systems, 3)}); select "
            "one with model= and features="
        )
    parts = {*registered_parts("models"), *registered_parts("features")}
    if name in parts or any(
        name in (r["system"], r.get(NAME_TAG)) for r in every if r["system"] != systems[0]
    ):
        raise InputError(f"name={name} is the name of another system; give a different one")
    for r in results:
        title = str(r.get("mlflow.runName", "")).replace(str(r.get(NAME_TAG) or systems[0]), name)
        store.log_values(r["run_id"], tags={NAME_TAG: name, "mlflow.runName": title})


def _confirm(question: str) -> bool:
    """Ask a question; True if the user says yes."""
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        return False


def table_of_stored_runs(results: list[Result]) -> Table:
    """Table with a row for each run."""
    names = dict(zip(results, name_rows(results), strict=True))
    columns = [
        text_measure("run", source=lambda r: f"{r['run_id']:.8}"),
        text_measure("system", source=lambda r: names[r]),
        *CONTEXT_COLUMNS,
        percent_measure("accuracy", "accuracy %", ends="accuracy", spare=1),
        text_measure("state", source=_state),
        text_measure("started", source=_start_time, spare=2),
    ]
    return Table(columns, results, f"{format_count(len(results), 'stored run')}, the newest first")


def _state(result: Result) -> str:
    """``complete``, or why a run is not."""
    if failed := int(result.get("folds_failed", 0)):
        return f"{failed} of {failed + int(result['folds'])} folds failed"
    failures = [f"{key}= failed" for key in result.failed_circumstances]
    state = STATES.get(result["status"], "complete") + ", earlier captures" * result.is_stale
    return ", ".join(failures) or state


def _start_time(result: Result) -> str:
    return f"{datetime.fromtimestamp(result['started'] / 1000):%Y-%m-%d %H:%M}"
