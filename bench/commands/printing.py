"""Printed results of runs, and exit codes."""

from __future__ import annotations

import errno
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.errors import InputError
from bench.outcomes.comparable import MARKED, comparable, context_of, depends_on_batch, system_of
from bench.outcomes.scores import captures
from bench.progress import console
from bench.work.bar import named

if TYPE_CHECKING:
    from bench.work.loop import Outcome

NAMED = 3  # folds or systems that a line names
WIDTH = 100  # columns of a file or a log, which has no width of its own
WORDS = 34  # columns of text, before it takes more lines rather than the place of another column
COMPARED = ("cell", "stream", "chip")  # kinds of run whose best one is marked
ACCURACY = ("captures", "clean", "whole", "in C")  # what kinds of run call the accuracy of whole captures
HEADINGS = {  # of columns that kinds of run call otherwise
    "captures": "accuracy %",
    "windows": "window accuracy %",
    "flash": "flash kB",
    "failing slices": "failing groups",
    "trained on": "faults trained on",
    "stopped": "early stop %",
    "after ms": "at mean ms",
    "a second": "decisions per s",
    "own hop ms": "system hop ms",
    "per touch": "reports per touch",
}
SPARE = (  # columns that a narrow terminal does not get, the first to go first
    "own hop ms",
    "mean ms",
    "a second",
    "decision ms",
    "windows",
    "macro-F1",
    "SD",
    "start",
    "90 % s",
    "touches",
    "per touch",
    "2000 ms",
    "250 ms",
    "other labels",
    "instructions a frame",
    "trained on",
    "subset",
)
_led = [False]  # whether another command leads from one command to the next


def output() -> Console:
    """The console for results."""
    out = Console()
    if not out.is_terminal:
        out.width = WIDTH
    return out


def say(*lines: str) -> None:
    """Print lines unwrapped, long ones too, so that they can be pasted."""
    out = output()
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def then(*commands: str) -> None:
    """Print the next command to type."""
    if commands and not _led[0]:
        say(*(f"{'      ' if i else 'next: '}{command}" for i, command in enumerate(commands)))


@contextmanager
def led() -> Iterator[None]:
    """Suppress hints of commands in between; the caller prints its own."""
    before, _led[0] = _led[0], True
    try:
        yield
    finally:
        _led[0] = before


def writable(folder: Path) -> Path:
    """Make the folder of ``out=`` before anything is run.

    Raises:
        InputError: it cannot be.
    """
    with unwritable(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def unwritable(out: Path) -> Iterator[None]:
    """Refuse an unwritable destination, in one line; existing files stay.

    Raises:
        InputError: it cannot be.
    """
    try:
        yield
    except OSError as e:
        if e.errno == errno.ENAMETOOLONG:  # which has a line of its own
            raise
        raise InputError(f"out={out}: {e.filename or out} cannot be written ({e.strerror or e}); choose another") from e


def grid(
    out: Console,
    title: str,
    rows: Sequence[dict[str, str]],
    left: Collection[str] = (),
    spare: Sequence[str] = (),
    bold: Collection[int] = (),
) -> None:
    """Print a table that fits; headings of columns without room follow below it.

    Args:
        out: console; its width counts.
        title: heading of the table.
        rows: text by heading; all have the same headings. A column without any text but dashes is not shown.
        left: headings of text, which is aligned left; numbers are aligned right.
        spare: headings that may be left out, the first to go first.
        bold: numbers of highlighted rows.
    """
    names = [n for n in rows[0] if n not in spare or any(row[n] not in ("-", "") for row in rows)]
    wide = {n: max(cell_len(text) for text in (n, *(row[n] for row in rows))) for n in names}
    wide |= {n: min(wide[n], WORDS) for n in left if n in wide}  # words go on in the next line
    dropped: list[str] = []
    for name in (n for n in spare if n in names):
        if sum(wide[n] + 3 for n in names) + 1 <= out.width:
            break
        names.remove(name)
        dropped.append(name)
    table = Table()
    for name in names:
        table.add_column(escape(name), justify="left" if name in left else "right", overflow="fold")
    for i, row in enumerate(rows):  # rich would take svm[C=8.0] for markup
        table.add_row(*(escape(row[n]) for n in names), style="bold" if i in bold else None)
    out.print(title, style="bold", markup=False, highlight=False)
    out.print(table)
    if dropped:
        needed = sum(wide[n] + 3 for n in [*names, *dropped]) + 1
        words = f"columns left out: {', '.join(dropped)}; a terminal of {needed} columns shows them"
        out.print(words, style="dim", markup=False, highlight=False)


def contexts(outcomes: Sequence[Outcome]) -> list[list[int]]:
    """Numbers of the runs that were measured, grouped by captures and protocol: only these may be compared."""
    groups: dict[tuple, list[int]] = {}
    for i, outcome in enumerate(outcomes):
        if outcome.findings:
            same = {**outcome.tags, "corpus_digest": outcome.plan.corpus.digest, **outcome.experiment.options()}
            groups.setdefault(comparable(same), []).append(i)
    return list(groups.values())


def best(outcomes: Sequence[Outcome]) -> list[int]:
    """Numbers of the most accurate complete runs of each context in which there is something to compare."""
    winners = []
    for group in contexts(outcomes):
        complete = [i for i in group if not outcomes[i].errors and not depends_on_batch(outcomes[i].tags)]
        if len(complete) > 1:
            most = max(outcomes[i].metrics["accuracy"] for i in complete)
            winners += [i for i in complete if outcomes[i].metrics["accuracy"] == most]
    return winners


def show(outcomes: Sequence[Outcome]) -> int:
    """Print the chosen values of each fold, a row for each run, and failures; return the exit code.

    Args:
        outcomes: outcomes of one kind of run.
    """
    out = output()
    for outcome in outcomes:
        if outcome.chosen and not outcome.experiment.options():  # else it is what the experiment learned
            _choices(out, outcome)
    _rows(out, outcomes)
    if any(outcome.plan.corpus.synthetic for outcome in outcomes):
        out.print("* synthetic: generated captures, not people; compare systems on a real corpus")
    if any(depends_on_batch(outcome.tags) for outcome in outcomes):
        out.print(MARKED, markup=False, highlight=False)
    return failures(outcomes)


def one_label(outcomes: Sequence[Outcome]) -> None:
    """Warn of systems that predict one label for all test captures of a fold with several classes."""
    systems = []
    for outcome in outcomes:
        tables = [captures(result.table) for result in outcome.results]
        if count := sum(t["true"].nunique() > 1 and t["predicted"].nunique() == 1 for t in tables):
            systems.append(f"{outcome.plan.cell.system()} in {count} of {len(tables)} folds")
    if systems:
        say(f"warning: all test captures of a fold get the same label: {_first(systems, 'more systems')}")


def system_in_tables(outcome: Outcome) -> str:
    """The system of a run, as tables name it."""
    return system_of({"system": outcome.plan.cell.system()} | outcome.tags)


def failures(outcomes: Sequence[Outcome]) -> int:
    """Print which folds failed and where the first traceback is; the exit code."""
    failed = {f"{_title(o)}: {named(name)}": where for o in outcomes for name, where in o.errors.items()}
    if failed:
        words = f"{len(failed)} failed: {_first([*failed], 'more')}; traceback of the first: "
        line = words + next(iter(failed.values()))
        console.print(line, style="bold red", markup=False, highlight=False, soft_wrap=True)
    return int(bool(failed))


def _first(names: Sequence[str], rest: str) -> str:
    """The first names, and how many more there are."""
    return "; ".join(names[:NAMED]) + (f" and {len(names) - NAMED} {rest}" if len(names) > NAMED else "")


def _title(outcome: Outcome) -> str:
    cell = outcome.plan.cell
    return f"{cell.system()}, {cell.data}, {cell.protocol}"


def _rows(out: Console, outcomes: Sequence[Outcome]) -> None:
    """A table of runs: what they share stands above it, what differs in columns."""
    contexts_of = []
    for outcome in outcomes:
        cell, star = outcome.plan.cell, "*" * outcome.plan.corpus.synthetic
        subset = (cell.where or "all") + (f", {cell.target}" if cell.target != "gesture" else "")
        contexts_of.append({"data": cell.data + star, "subset": subset, "protocol": str(cell.protocol)})
    differing = [name for name in contexts_of[0] if len({context[name] for context in contexts_of}) > 1]
    marked = best(outcomes) if outcomes[0].experiment.kind in COMPARED else []
    rows = []
    for i, (outcome, context) in enumerate(zip(outcomes, contexts_of, strict=True)):
        row = {"system": system_in_tables(outcome) + " (best)" * (i in marked)}
        row |= {name: context[name] for name in differing} | _measured(outcome)
        row["folds"] = f"{len(outcome.results)}/{len(outcome.plan.folds)}"
        rows.append({HEADINGS.get(name, name): text for name, text in row.items()})
    title = outcomes[0].experiment.heading
    if not differing:
        data, subset, protocol = context_of(outcomes[0].tags)
        title = f"{data}, {'all captures' if subset == 'all' else subset}, {protocol}\n{title}"
    if outcomes[0].experiment.kind == "watch" or any(
        "[" in row.get(HEADINGS.get(name, name), "") for row in rows for name in ACCURACY
    ):
        title += "; in brackets 95 % confidence intervals over subjects"
    spare = [HEADINGS.get(name, name) for name in SPARE]
    grid(out, title, rows, ("system", *contexts_of[0], "worst fault"), spare, marked)


def _measured(outcome: Outcome) -> dict[str, str]:
    """What the kind of run shows, with the interval of the accuracy and the size where they were measured."""
    metrics, row = outcome.metrics, outcome.experiment.row(outcome.metrics)
    if {"accuracy_low", "accuracy_high"} <= metrics.keys():
        for name in (n for n in ACCURACY if n in row):
            row[name] += f" [{100 * metrics['accuracy_low']:.1f}, {100 * metrics['accuracy_high']:.1f}]"
    if outcome.experiment.kind == "cell":
        row["flash"] = f"{metrics['flash_bytes'] / 1000:,.1f}" if "flash_bytes" in metrics else "-"
    return row


def _choices(out: Console, outcome: Outcome) -> None:
    """What a search has chosen on the training part of each fold."""
    names = list(dict.fromkeys(name for row in outcome.chosen.values() for name in row))
    rows = []
    for fold, row in outcome.chosen.items():
        cells = {n: row.get(n, "") for n in names}
        rows.append({"fold": fold} | {n: f"{c:.4g}" if isinstance(c, float) else str(c) for n, c in cells.items()})
    grid(out, f"Chosen in each training part: {_title(outcome)}", rows, ("fold", *names), names[::-1])
