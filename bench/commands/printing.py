"""Printed results of runs, and exit codes."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from bench.errors import InputError
from bench.ground.progress import console
from bench.ground.registry import names as registered
from bench.ground.words import BUSY
from bench.reading.frame import grouped, names
from bench.running.bar import named
from bench.values.few import INTERVAL, too_few
from bench.values.measures import Interval, Measure, known, text
from bench.values.result import Result, notes_on
from bench.values.table import Table, rows_of

if TYPE_CHECKING:
    from bench.reports.views.base import View

COMMAND = re.compile(r"\bbench ([a-z]+)")  # in a line to type
NAMED = 3  # folds or systems that a line names
WIDTH = 100  # columns of a file or a log, which has no width of its own
CONTEXT = (  # columns of tables of runs
    text("data", read=lambda r: r["data"] + "*" * (r["synthetic"] == "true")),
    text(
        "subset",
        read=lambda r: r["subset"] + f", {r['target']}" * (r["target"] != "gesture"),
        spare=3,
    ),
    text("protocol", read=lambda r: r["protocol"] + ", subjects mixed" * r.mixed),
)


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
    """Print the next commands to type, those that are here."""
    here = [
        line
        for line in commands
        if not (found := COMMAND.search(line)) or found[1] in registered("commands")
    ]
    if here:
        say(*(f"{'      ' if i else 'next: '}{command}" for i, command in enumerate(here)))


def writable(folder: Path) -> Path:
    """Make the folder of ``out=`` before anything is run."""
    with unwritable(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def unwritable(out: Path) -> Iterator[None]:
    """Refuse an unwritable destination, in one line; existing files stay."""
    try:
        yield
    except OSError as e:
        if e.errno == errno.ENAMETOOLONG:  # which has a line of its own
            raise
        raise InputError(
            f"out={out}: {e.filename or out} cannot be written ({e.strerror or e}); choose another"
        ) from e


def show(results: Sequence[Result], views: Sequence[tuple[View, Sequence[Result]]]) -> int:
    """Print the chosen values of each fold, a row for each run in each view that shows it, and failures; exit code."""
    out = output()
    for view, members in views:
        for result in members:
            if view.searches and "chosen" in result.tables:
                choices_table(result).print(out)
        runs_table(members, view).print(out)
    if any(r["synthetic"] == "true" for r in results):
        out.print("* synthetic: generated captures, not people; compare systems on a real corpus")
    if slower := {r.system: r["slowdown"] for r in results if r.get("slowdown", 0) > BUSY}:
        line = f"other programs made this machine up to {max(slower.values()):.1f} times slower during "
        line += f"{_first([*slower], 'more')}; times are converted to those of the quiet machine"
        out.print(line, markup=False, highlight=False)
    for note in dict.fromkeys(note for r in results for note in notes_on(r.system, str(r["data"]))):
        out.print(note, markup=False, highlight=False, soft_wrap=True)
    return failures(results)


def failures(results: Sequence[Result]) -> int:
    """Print which folds failed, the first exception and where its traceback is; the exit code."""
    failed = {
        f"{_title(r)}: {named(name)}": failure
        for r in results
        for name, failure in r.errors.items()
    }
    if failed:
        reason, where = next(iter(failed.values()))
        line = f"{len(failed)} failed: {_first([*failed], 'more')}; {reason}; traceback of the first: {where}"
        console.print(line, style="bold red", markup=False, highlight=False, soft_wrap=True)
    return int(bool(failed))


def _first(names: Sequence[str], rest: str) -> str:
    """The first names, and how many more there are."""
    return "; ".join(names[:NAMED]) + (
        f" and {len(names) - NAMED} {rest}" if len(names) > NAMED else ""
    )


def _title(result: Result) -> str:
    return ", ".join(str(result[name]) for name in ("system", "data", "protocol"))


def runs_table(results: Sequence[Result], view: View) -> Table:
    """A table of results, the most accurate first: what they share stands above it, what differs in columns."""
    ordered: list[Result] = []
    marked: list[
        Result
    ] = []  # the most accurate complete ones of each group in which there is something to compare
    for group in grouped(results, view.alike).values():
        scores = {r: known(r.get(view.score)) for r in group}
        ordered += sorted(group, key=lambda r: float("inf") if scores[r] is None else -scores[r])
        whole = {
            r: score
            for r, score in scores.items()
            if score is not None and r.scored and r.complete and r.alone
        }
        if view.ranked and len(whole) > 1:
            marked += [r for r, score in whole.items() if score == max(whole.values())]
    results, called = ordered, dict(zip(ordered, names(ordered), strict=True))
    differing = [measure for measure in CONTEXT if len({measure.of(r) for r in results}) > 1]
    system = text("system", read=lambda r: called[r] + " (best)" * (r in marked))
    folds = Measure("folds", read=lambda r: r.folds)
    measures = view.shows(results)
    title = view.title(results)
    if not differing:
        data, captures_of, protocol = results[0].context
        title = f"{data}, {'all captures' if captures_of == 'all' else captures_of}, {protocol}\n{title}"
    if view.ranked and any(isinstance(m.cell(r), Interval) for m in measures for r in results):
        title += "; in brackets 95 % t-intervals over subjects"
    if any(measure.ends for measure in measures):
        few = sorted(
            {int(r["subjects"]) for r in results if r.get("subjects", INTERVAL) < INTERVAL}
        )
        title += "".join(f"; {too_few(people)}" for people in few)
    bold = [i for i, r in enumerate(results) if r in marked]
    return Table([system, *differing, *measures, folds], results, title, bold)


def choices_table(result: Result) -> Table:
    """What a search has chosen on the training part of each fold."""
    chosen = result.tables["chosen"].rename(columns=str)
    words = chosen.map(
        lambda v: "" if known(v) is None else f"{v:.4g}" if isinstance(v, float) else str(v)
    )
    columns = [text(str(name), spare=i) for i, name in enumerate(words)]
    return Table(columns, rows_of(words), f"Chosen in each training part: {_title(result)}")
