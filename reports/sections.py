"""Exhibits of the page: figures, tables and sentences on sets of comparable results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.reading.frame import group_results
from bench.reports.figures import Picture, save_figure
from bench.reports.notes import few_subjects_notes
from bench.values.measures import text_measure
from bench.values.result import Result, footnotes_of_system, seed_number
from bench.values.table import Table

GROUPS = 3  # sets of comparable results that are shown
SYSTEMS = 10  # systems of a set


@dataclass(frozen=True)
class Exhibit:
    """A figure, a table with its caption, and sentences of a section; each may be absent."""

    heading: str  # of the section, which has all exhibits with this heading
    picture: Picture | None = None
    table: Table | None = None
    caption: str = ""
    sentences: Sequence[str] = ()
    summary: str = ""  # line beside the heading while the section is closed


def group_by_heading(exhibits: Iterable[Exhibit]) -> dict[str, list[Exhibit]]:
    """The exhibits of each section by its heading."""
    sections: dict[str, list[Exhibit]] = {}
    for exhibit in exhibits:
        sections.setdefault(exhibit.heading, []).append(exhibit)
    return sections


def view_exhibit(
    view: Any, words: str, results: Sequence[Result], folder: Path, number: int
) -> Exhibit:
    """The figure and the table of a `View` on comparable results, which ``words`` describe."""
    figure, picture = view.draw_for_page(results), None
    figure_caption, table_caption = view.page_captions()
    if figure is not None:
        caption = f"{words}: {figure_caption}"
        picture = save_figure(figure, folder, f"0-{view.key}-{number}", words, caption)
    columns = [
        text_measure("system", source=lambda r: r.system_with_seed),
        *view.page_columns(results),
    ]
    footnotes = [footnotes_of_system(r["system"], str(r["data"])) for r in results]
    return Exhibit(
        view.section_heading or view.heading or view.noun.capitalize() or view.key,
        picture,
        Table(columns, results, remarks=footnotes),
        f"{words}: {table_caption}",
        few_subjects_notes(results),
        view.section_summary,
    )


def comparable_groups(
    results: Sequence[Result],
    shared_parameters: Mapping[str, tuple[str, str]] | None = None,
    score: str = "accuracy",
    more: str = "",
) -> list[tuple[str, list[Result]]]:
    """At most `GROUPS` sets of comparable results, in words, with their best `SYSTEMS` systems.

    Each system has its newest complete result of the lowest seed; a result with more numbers whose
    names begin with ``more`` precedes a newer one. Comparable results share the parameters;
    ``score`` orders them.
    """

    def precedence(result: Result) -> tuple[int, int]:
        numbers = sum(name.startswith(more) for name in result.metrics) if more else 0
        return seed_number(result["seed"]), -numbers

    newest_first = [r for r in results if r.is_complete][::-1]
    groups = []
    for words, runs in group_results(
        sorted(newest_first, key=precedence), shared_parameters
    ).items():
        first: dict[str, Result] = {}
        for r in runs:
            first.setdefault(r["system"], r)
        several_seeds = any(first[r["system"]]["seed"] != r["seed"] for r in runs)
        best = sorted(first.values(), key=lambda r: -r[score])[:SYSTEMS]
        if omitted := len(first) - len(best):
            words += f", {omitted} less accurate systems left out"
        words += ", only the lowest seed of each system" * several_seeds
        groups.append((next(iter(first.values()))["synthetic"], -len(first), words, best))
    groups.sort(key=lambda group: group[:2])
    return [(words, best) for _, _, words, best in groups[:GROUPS]]


def runs_of_systems(results: Sequence[Result]) -> dict[str, list[Result]]:
    """The complete runs of each system, the lowest seed first."""
    runs: dict[str, list[Result]] = {}
    for r in sorted(results, key=lambda r: seed_number(r["seed"])):
        if r.is_complete and r.predicts_alone:
            runs.setdefault(r.system, []).append(r)
    return runs
