"""The command ``bench audit``: verify that systems keep the rules of the contract."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator

from bench.commands.printing import print_lines, print_next_commands, results_console
from bench.ground.typed import DEFAULTS, Values, format_command
from bench.plan.cells import Cell
from bench.plan.grid import make_cells
from bench.running.audit import FAILED, PASSED, SKIPPED, CheckResult, audit_system, refuse_system
from bench.running.exchanged import AuditedCorpus, audit_corpus
from bench.values.measures import text_measure
from bench.values.table import Table


def command(values: Values) -> int:
    """Print a table of checks for each system; exit code 1 if a check failed."""
    has_failed = False
    for cell, checks in audit_systems(values):
        print_checks(cell, checks)
        has_failed |= any(check.result == FAILED for check in checks)
    if not has_failed:
        print_next_commands(format_command("run", cell.arguments()))
    return int(has_failed)


def audit_systems(values: Values) -> Iterator[tuple[Cell, list[CheckResult]]]:
    """Audit the systems of typed values, one at a time, if all of them can be built."""
    cells = make_cells(values)
    corpora = [AuditedCorpus(cell) for cell in cells] if "data" in values else []
    for cell in cells:
        refuse_system(cell)
    for cell, corpus in itertools.zip_longest(cells, corpora):
        checks = audit_system(cell)
        yield cell, checks + (audit_corpus(corpus, checks) if corpus else [])


def print_checks(cell: Cell, checks: list[CheckResult]) -> None:
    """Print the checks of one system, and how many passed."""
    system = cell.system_name()
    columns = [text_measure("check"), text_measure("result"), text_measure("sentence", "reason")]
    failed = [i for i, check in enumerate(checks) if check.result == FAILED]
    title = f"Audit of {system} on generated captures (synthetic)"
    if cell.data != DEFAULTS["data"]:
        title += f", then on {cell.data} with exchanged labels"
    Table(columns, [vars(check) for check in checks], title, failed).print(results_console())
    counts = Counter(check.result for check in checks)
    words = [f"{counts[result]} {result}" for result in (PASSED, FAILED, SKIPPED) if counts[result]]
    print_lines(f"{system}: {', '.join(words)}; {sum(check.seconds for check in checks):.1f} s")
