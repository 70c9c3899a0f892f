"""What commands print of what was run, and where; exit codes."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.errors import InputError
from bench.work.loop import Outcome, console

FAILED = 3  # folds that are named


def output() -> Console:
    """Where results are printed."""
    out = Console()
    if not out.is_terminal:  # a file or a log has no width to fit into
        out.width = 200
    return out


def writable(folder: Path) -> Path:
    """Make the folder before anything is run.

    Raises:
        InputError: it cannot be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(f"out={folder}: {folder} cannot be written ({e.strerror}); choose another folder") from e
    return folder


def show(outcomes: list[Outcome]) -> int:
    """Print what was chosen in each fold, a row for each run, and what failed; the exit code.

    Args:
        outcomes: of one kind.
    """
    out = output()
    for outcome in outcomes:
        if outcome.chosen and not outcome.experiment.options():  # else it is what the experiment learned
            out.print(_choices(outcome))
    out.print(_rows(outcomes))
    if any(outcome.plan.corpus.synthetic for outcome in outcomes):
        out.print("* synthetic: generated captures, not people; compare systems on a real corpus")
    failed = {f"{_named(o)}: fold {name}": where for o in outcomes for name, where in o.errors.items()}
    if not failed:
        return 0
    more = f" and {len(failed) - FAILED} more" if len(failed) > FAILED else ""
    console.print(
        f"{len(failed)} failed: {'; '.join([*failed][:FAILED])}{more}; the traceback of the first is in "
        f"{next(iter(failed.values()))}",
        style="bold red",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    return 1


def _named(outcome: Outcome) -> str:
    cell = outcome.plan.cell
    return f"{cell.system()}, {cell.data}, {cell.protocol}"


def _rows(outcomes: list[Outcome]) -> Table:
    table = Table(title=outcomes[0].experiment.heading)
    for name in ("system", "data", "subset", "protocol"):
        table.add_column(name)
    rows = [outcome.experiment.row(outcome.metrics) for outcome in outcomes]
    for name in (*rows[0], "folds"):
        table.add_column(name, justify="right")
    for outcome, row in zip(outcomes, rows, strict=True):
        cell, good = outcome.plan.cell, len(outcome.results)
        table.add_row(
            escape(cell.system()),  # rich would take svm[C=8.0] for markup
            cell.data + ("*" if outcome.plan.corpus.synthetic else ""),
            escape((cell.where or "all") + (f", {cell.target}" if cell.target != "gesture" else "")),
            escape(str(cell.protocol)),
            *map(escape, row.values()),
            f"{good}/{len(outcome.plan.folds)}",
        )
    return table


def _choices(outcome: Outcome) -> Table:
    """What a search has chosen on the training part of each fold."""
    table = Table(title=escape(f"Chosen in each training part: {_named(outcome)}"))
    names = list(dict.fromkeys(name for row in outcome.chosen.values() for name in row))
    for name in ("fold", *names):
        table.add_column(escape(name))
    for fold, row in outcome.chosen.items():
        cells = [row.get(name, "") for name in names]
        table.add_row(fold, *(f"{c:.4g}" if isinstance(c, float) else escape(str(c)) for c in cells))
    return table
