"""The command ``bench runs``: stored runs listed, or deleted."""

from __future__ import annotations

import sys
from datetime import datetime
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import (
    COMPARE,
    STORED_OPTIONS,
    Command,
    Option,
    key_options,
    parse_arguments,
    typed_settings,
)
from bench.values.measures import percent_measure, text_measure
from bench.values.result import format_count

if TYPE_CHECKING:
    from bench.values.result import Result
    from bench.values.table import Table

COMMAND = Command(
    COMPARE,
    "list stored runs, or delete them",
    "Lists the stored runs, the newest first, with those that failed or were interrupted. The keys of bench run, run= "
    "and latest=yes select among them. delete=yes deletes the selected runs after a question. Without a terminal, it "
    "needs yes=yes. MLflow keeps deleted runs until mlflow gc; docs/store.md tells how to bring them back.",
    "bench runs data=haart protocol=loso\nbench runs model=cnn85 delete=yes\nbench runs run=3f2a9c01 delete=yes",
    options=(
        *STORED_OPTIONS,
        Option("delete", "yes", False, "yes: delete the selected runs"),
        Option("yes", "yes", False, "yes: delete without a question"),
    ),
)
STATES = {"RUNNING": "goes on, or was cut off", "KILLED": "interrupted"}


def command(arguments: list[str]) -> int:
    """List the selected runs, and delete them if that is asked; exit code 1 if the answer is no."""
    from bench.commands.printing import print_lines, results_console
    from bench.ground.registry import views_of_runs
    from bench.reading.runs import parse_selection, select_or_fail
    from bench.store.client import connect
    from bench.store.database import lock_run

    values = parse_arguments(arguments, key_options("runs"))
    given = typed_settings("runs", values)
    asked = parse_selection(values)
    if given["delete"] and not asked:
        raise InputError(
            "delete=yes: select the runs to delete, such as data=haart, model=svm or run=ID"
        )
    if given["delete"] and not given["yes"] and not sys.stdin.isatty():
        raise InputError(
            "delete=yes asks before it deletes, and there is no terminal to ask; add yes=yes"
        )
    store = connect(writes=given["delete"])
    found = select_or_fail(
        [store.load_result(run) for run in store.runs_of_kind(*views_of_runs())], asked
    )
    table_of(found).print(results_console())
    if not given["delete"]:
        return 0
    if not given["yes"] and not _agreed(f"Delete {format_count(len(found), 'run')}? [yes/no] "):
        print_lines("no run is deleted")
        return 1
    for result in found:
        with lock_run(result["touchbench.cell"]):
            store.delete_run(result["run_id"])
    first = found[0]["run_id"]
    print_lines(
        f"{format_count(len(found), 'run')} deleted; to bring one back: mlflow runs restore --run-id {first}"
    )
    return 0


def _agreed(question: str) -> bool:
    """Whether the user agrees."""
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        return False


def table_of(results: list[Result]) -> Table:
    """A row for each run."""
    from bench.commands.printing import CONTEXT_COLUMNS
    from bench.reading.frame import name_rows
    from bench.values.table import Table

    called = dict(zip(results, name_rows(results), strict=True))
    columns = [
        text_measure("run", source=lambda r: f"{r['run_id']:.8}"),
        text_measure("system", source=lambda r: called[r]),
        *CONTEXT_COLUMNS,
        percent_measure("accuracy", "accuracy %", ends="accuracy", spare=1),
        text_measure("state", source=_state),
        text_measure(
            "started",
            source=lambda r: f"{datetime.fromtimestamp(r['started'] / 1000):%Y-%m-%d %H:%M}",
            spare=2,
        ),
    ]
    return Table(columns, results, f"{format_count(len(results), 'stored run')}, the newest first")


def _state(result: Result) -> str:
    """Whether a run is whole, or why not."""
    if failed := int(result.get("folds_failed", 0)):
        return f"{failed} of {failed + int(result['folds'])} folds failed"
    lacking = [f"{key}= failed" for key in result.failed_circumstances]
    return ", ".join(lacking) or STATES.get(result["status"], "complete")
