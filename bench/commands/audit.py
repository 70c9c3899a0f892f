"""The command ``bench audit``: whether systems keep the rules of the contract."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from bench.grammar.options import (
    COMPARE,
    FEATURES,
    MODEL,
    SEED,
    Command,
    key_options,
    parse_arguments,
)
from bench.ground.typed import Values, format_command

if TYPE_CHECKING:
    from bench.plan.cells import Cell
    from bench.running.audit import CheckResult

COMMAND = Command(
    COMPARE,
    "verify that your own system keeps the rules",
    "Verifies on generated captures that a system predicts without labels and one capture at a time. Equal seeds "
    "must give equal results, and test captures and earlier fits must change nothing. The system must accept "
    "another grid and frame rate, and it must be possible to copy, save and load it. Nothing is stored. Exit code "
    "1 if a check failed. The audit finds mistakes, not fraud.",
    "bench audit model=my.py:Mine\nbench audit model=lda,svm features=touch",
    options=(MODEL, FEATURES, SEED),
)


def command(arguments: list[str]) -> int:
    """Print a table of checks for each system; exit code 1 if a check failed."""
    from bench.commands.printing import print_next_commands
    from bench.running.audit import FAILED

    failed = False
    for cell, verdicts in audit_systems(parse_arguments(arguments, key_options("audit"))):
        show(cell, verdicts)
        failed |= any(verdict.result == FAILED for verdict in verdicts)
    if not failed:
        print_next_commands(format_command("run", cell.arguments()))
    return int(failed)


def audit_systems(values: Values) -> Iterator[tuple[Cell, list[CheckResult]]]:
    """The systems of some values, each with its checks; all can be made before the first is checked."""
    from bench.plan.grid import make_cells
    from bench.running import audit

    systems = make_cells(values)
    for cell in systems:
        audit.refuse_system(cell)
    for cell in systems:
        yield cell, audit.audit_system(cell)


def show(cell: Cell, verdicts: list[CheckResult]) -> None:
    """Print the checks of one system, and how many passed."""
    from bench.commands.printing import print_lines, results_console
    from bench.running.audit import FAILED, PASSED, SKIPPED
    from bench.values.measures import text_measure
    from bench.values.table import Table

    columns = [text_measure("check"), text_measure("result"), text_measure("sentence", "reason")]
    failed = [i for i, verdict in enumerate(verdicts) if verdict.result == FAILED]
    title = f"Audit of {cell.system_name()} on generated captures (synthetic)"
    Table(columns, [vars(v) for v in verdicts], title, failed).print(results_console())
    counts = Counter(verdict.result for verdict in verdicts)
    words = ", ".join(
        f"{counts[result]} {result}" for result in (PASSED, FAILED, SKIPPED) if counts[result]
    )
    print_lines(f"{cell.system_name()}: {words}; {sum(v.seconds for v in verdicts):.1f} s")
