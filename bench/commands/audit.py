"""The command ``bench audit``: whether systems keep the rules of the contract."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from bench.arguments import parse
from bench.commands.printing import output, say, then
from bench.measures import text
from bench.options import keys
from bench.plan.cells import Cell, cells
from bench.table import Table
from bench.words import Values, typed
from bench.work.audit import FAILED, PASSED, SKIPPED, Verdict, audited, refuse


def audit(arguments: list[str]) -> int:
    """Print a table of checks for each system; exit code 1 if a check failed.

    Raises:
        InputError: something in the arguments cannot be used, or a system cannot be made.
    """
    failed = False
    for cell, verdicts in audited_values(parse(arguments, keys("audit"))):
        show(cell, verdicts)
        failed |= any(verdict.result == FAILED for verdict in verdicts)
    if not failed:
        then(typed("run", cell.arguments()))
    return int(failed)


def audited_values(values: Values) -> Iterator[tuple[Cell, list[Verdict]]]:
    """The systems of some values, each with its checks.

    Raises:
        InputError: something in the values cannot be used, or a system cannot be made; nothing was checked.
    """
    systems = cells(values)
    for cell in systems:
        refuse(cell)
    for cell in systems:
        yield cell, audited(cell)


def show(cell: Cell, verdicts: list[Verdict]) -> None:
    """Print the checks of one system, and how many passed."""
    columns = [text("check"), text("result"), text("sentence", "reason")]
    failed = [i for i, verdict in enumerate(verdicts) if verdict.result == FAILED]
    title = f"Audit of {cell.system()} on generated captures (synthetic)"
    Table(columns, [vars(v) for v in verdicts], title, failed).print(output())
    counts = Counter(verdict.result for verdict in verdicts)
    words = ", ".join(f"{counts[result]} {result}" for result in (PASSED, FAILED, SKIPPED) if counts[result])
    say(f"{cell.system()}: {words}; {sum(v.seconds for v in verdicts):.1f} s")
