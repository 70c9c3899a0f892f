"""Printing for commands: lines, next commands, tables of runs, and failures with the exit code."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from bench.errors import InputError
from bench.ground.machine import BUSY_SLOWDOWN
from bench.ground.progress import console
from bench.ground.registry import registered_parts
from bench.ground.typed import quote_value
from bench.reading.frame import group_results, name_rows
from bench.running.bar import fold_title
from bench.values.few import FEWEST_FOR_INTERVAL, too_few_sentence
from bench.values.measures import Interval, Measure, text_measure, value_or_none
from bench.values.result import Result, footnotes_of_system
from bench.values.table import Table, rows_of_frame

if TYPE_CHECKING:
    from bench.reports.views.base import View

COMMAND = re.compile(r"\bbench ([a-z]+)")  # in a line to type
NEARLY_PERFECT = 0.99  # accuracy; no system of a person left out comes near it
MOST_NAMES = 3  # of folds or systems in a line
WIDTH = 100  # columns of a file or a log, which has no width of its own
CONTEXT_COLUMNS = (  # columns of tables of runs
    text_measure("data", source=lambda r: r["data"] + "*" * (r["synthetic"] == "true")),
    text_measure(
        "subset",
        source=lambda r: r["subset"] + f", {r['target']}" * (r["target"] != "gesture"),
        spare=3,
    ),
    text_measure(
        "protocol", source=lambda r: r["protocol"] + ", subjects mixed" * r.mixes_subjects
    ),
)


def results_console() -> Console:
    """The console for results."""
    out = Console()
    if not out.is_terminal:
        out.width = WIDTH
    return out


def print_lines(*lines: str) -> None:
    """Print lines unwrapped, so that long ones can be pasted too."""
    out = results_console()
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def print_next_commands(*lines: str) -> None:
    """Print the next commands to type; those of packages that are missing are left out."""
    commands = registered_parts("commands")
    prefix = "next: "
    for line in lines:
        match = COMMAND.search(line)
        if not match or match[1] in commands:
            print_lines(prefix + line)
            prefix = "      "


@contextmanager
def refuse_unwritable(out: Path) -> Iterator[None]:
    """Turn the error of an unwritable destination into one line; existing files stay."""
    try:
        yield
    except OSError as e:
        if e.errno == errno.ENAMETOOLONG:  # `bench.cli` has a line for it
            raise
        raise InputError(
            f"out={out}: {e.filename or out} cannot be written ({e.strerror or e}); choose another"
        ) from e


def print_results_and_failures(
    results: Sequence[Result], views: Sequence[tuple[View, Sequence[Result]]]
) -> int:
    """Print tables of runs in several views, notes and failures; return the exit code.

    Args:
        results: all runs.
        views: each view, with the runs that it shows.
    """
    out = results_console()
    for view, members in views:
        for result in members:
            if view.key == "run" and "chosen" in result.tables:
                table_of_choices(result).print(out)
        printed_runs_table(members, view).print(out)
    if any(r["synthetic"] == "true" for r in results):
        out.print("* synthetic: generated captures, not people; compare systems on a real corpus")
    if slower := {r.system: r["slowdown"] for r in results if r.get("slowdown", 0) > BUSY_SLOWDOWN}:
        line = (
            f"other programs made this machine up to {max(slower.values()):.1f} times slower "
            f"during {_first_names([*slower])}; times are converted to those of the quiet machine"
        )
        out.print(line, markup=False, highlight=False)
    print_lines(*dict.fromkeys(doubt for r in results if (doubt := doubt_perfection(r))))
    footnotes = [note for r in results for note in footnotes_of_system(r.system, str(r["data"]))]
    print_lines(*dict.fromkeys(footnotes))
    return print_failures(results)


def doubt_perfection(result: Result) -> str:
    """Say how to verify a system of the user's own that is nearly always right; "" for others."""
    names = {key: str(result.get(f"{key}_name", "")) for key in ("model", "features")}
    words = {key: name for key, name in names.items() if ".py:" in name}
    if not words or not result.has_scores or result["accuracy"] < NEARLY_PERFECT:
        return ""
    if result["synthetic"] != "true":
        words["data"] = str(result["data"])
    typed = " ".join(f"{key}={quote_value(value)}" for key, value in words.items())
    share = f"{100 * result['accuracy']:.1f} %"
    question = "to see whether it knows captures that it was not given"
    return f"{result.system}: {share}; {question}: bench audit {typed}"


def print_failures(results: Sequence[Result]) -> int:
    """Print the failed folds and where the first traceback is; return the exit code."""
    failures = {
        f"{_title_of_run(r)}: {fold_title(name)}": failure
        for r in results
        for name, failure in r.errors.items()
    }
    if not failures:
        return 0
    reason, place = next(iter(failures.values()))
    line = f"{len(failures)} failed: {_first_names([*failures])}; {reason}; "
    line += f"traceback of the first: {place}"
    console.print(line, style="bold red", markup=False, highlight=False, soft_wrap=True)
    return 1


def _first_names(names: Sequence[str]) -> str:
    """The first names, and the number of the others."""
    rest = len(names) - MOST_NAMES
    return "; ".join(names[:MOST_NAMES]) + f" and {rest} more" * (rest > 0)


def _title_of_run(result: Result) -> str:
    return ", ".join(str(result[name]) for name in ("system", "data", "protocol"))


def printed_runs_table(results: Sequence[Result], view: View) -> Table:
    """Table of results, the most accurate first; the title has what they share."""
    results, best = _rank_results(results, view)
    names = dict(zip(results, name_rows(results), strict=True))
    system = text_measure("system", source=lambda r: names[r] + " (best)" * (r in best))
    context = [m for m in CONTEXT_COLUMNS if len({m.as_text(r) for r in results}) > 1]
    measures, title = view.table_columns(results), view.table_title(results)
    if not context:
        data, subset, protocol = results[0].context
        title = f"{data}, {'all captures' if subset == 'all' else subset}, {protocol}\n{title}"
    values = (measure.value_of_row(r) for measure in measures for r in results)
    if view.marks_best and any(isinstance(value, Interval) for value in values):
        title += "; in brackets 95 % t-intervals over subjects"
    if any(measure.ends for measure in measures):
        people = {int(r.get("subjects", FEWEST_FOR_INTERVAL)) for r in results}
        few = sorted(number for number in people if number < FEWEST_FOR_INTERVAL)
        title += "".join(f"; {too_few_sentence(number)}" for number in few)
    columns = [system, *context, *measures, Measure("folds", source=lambda r: r.folds)]
    return Table(columns, results, title, [i for i, r in enumerate(results) if r in best])


def _rank_results(results: Sequence[Result], view: View) -> tuple[list[Result], list[Result]]:
    """Results, the most accurate of each comparable group first, and the best ones to mark.

    A group has a best one if at least two of its runs are complete.
    """
    ranked: list[Result] = []
    best: list[Result] = []
    for group in group_results(results, view.shared_parameters).values():
        scores = {r: value_or_none(r.get(view.score)) for r in group}
        ranked += sorted(group, key=lambda r: float("inf") if scores[r] is None else -scores[r])
        complete = [r for r in group if r.has_scores and r.is_complete and r.predicts_alone]
        complete = [r for r in complete if scores[r] is not None]
        if view.marks_best and len(complete) > 1:
            highest = max(scores[r] for r in complete)
            best += [r for r in complete if scores[r] == highest]
    return ranked, best


def table_of_choices(result: Result) -> Table:
    """Table of what a search has chosen in the training part of each fold."""
    texts = result.tables["chosen"].rename(columns=str).map(_format_choice)
    columns = [text_measure(str(name), spare=i) for i, name in enumerate(texts)]
    title = f"Chosen in each training part: {_title_of_run(result)}"
    return Table(columns, rows_of_frame(texts), title)


def _format_choice(value: object) -> str:
    """A chosen value: floats with four digits, "" for an unknown one."""
    if value_or_none(value) is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
