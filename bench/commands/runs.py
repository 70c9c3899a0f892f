"""The command ``bench runs``: stored runs listed, or deleted."""

from __future__ import annotations

import sys
from datetime import datetime
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import COMPARE, STORED, Command, Option, keys, parse, settings
from bench.values.measures import percent, text
from bench.values.result import several

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
        *STORED,
        Option("delete", "yes", False, "yes: delete the selected runs"),
        Option("yes", "yes", False, "yes: delete without a question"),
    ),
)
STATES = {"RUNNING": "goes on, or was cut off", "KILLED": "interrupted"}


def command(arguments: list[str]) -> int:
    """List the selected runs, and delete them if that is asked; exit code 1 if the answer is no."""
    from bench.commands.printing import output, say
    from bench.ground.registry import run_views
    from bench.reading.runs import asked_of, wanted
    from bench.store.client import connect
    from bench.store.database import only_one

    values = parse(arguments, keys("runs"))
    given = settings("runs", values)
    asked = asked_of(values)
    if given["delete"] and not asked:
        raise InputError(
            "delete=yes: select the runs to delete, such as data=haart, model=svm or run=ID"
        )
    if given["delete"] and not given["yes"] and not sys.stdin.isatty():
        raise InputError(
            "delete=yes asks before it deletes, and there is no terminal to ask; add yes=yes"
        )
    store = connect(writes=given["delete"])
    found = wanted([store.result(run) for run in store.of_kind(*run_views())], asked)
    table_of(found).print(output())
    if not given["delete"]:
        return 0
    if not given["yes"] and not _agreed(f"Delete {several(len(found), 'run')}? [yes/no] "):
        say("no run is deleted")
        return 1
    for result in found:
        with only_one(result["touchbench.cell"]):
            store.delete(result["run_id"])
    first = found[0]["run_id"]
    say(
        f"{several(len(found), 'run')} deleted; to bring one back: mlflow runs restore --run-id {first}"
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
    from bench.commands.printing import CONTEXT
    from bench.reading.frame import names
    from bench.values.table import Table

    called = dict(zip(results, names(results), strict=True))
    columns = [
        text("run", read=lambda r: f"{r['run_id']:.8}"),
        text("system", read=lambda r: called[r]),
        *CONTEXT,
        percent("accuracy", "accuracy %", ends="accuracy", spare=1),
        text("state", read=_state),
        text(
            "started",
            read=lambda r: f"{datetime.fromtimestamp(r['started'] / 1000):%Y-%m-%d %H:%M}",
            spare=2,
        ),
    ]
    return Table(columns, results, f"{several(len(results), 'stored run')}, the newest first")


def _state(result: Result) -> str:
    """Whether a run is whole, or why not."""
    if failed := int(result.get("folds_failed", 0)):
        return f"{failed} of {failed + int(result['folds'])} folds failed"
    lacking = [f"{key}= failed" for key in result.failed]
    return ", ".join(lacking) or STATES.get(result["status"], "complete")
