"""The report: ``bench report`` makes it from stored runs and the numbers beside this file."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from bench.errors import InputError, suggest_names
from bench.grammar.options import run_commands
from bench.ground.progress import warn
from bench.ground.registry import import_object, load_part, load_views, registered_parts
from bench.ground.scratch import hold_path, remove_leftovers
from bench.ground.typed import format_command
from bench.reading.candidates import repeated_arguments
from bench.reading.captures import stale_sentences
from bench.reading.frame import group_results
from bench.reading.runs import load_clean_runs, load_results, results_on_captures, select_or_fail
from bench.reports import history, ledger, over_corpora
from bench.reports.bundle import Bundle
from bench.reports.chart import chart_points, draw_cost_chart
from bench.reports.comparison import (
    UNITS,
    average_seeds,
    comparison_table,
    load_published,
    provenance_section,
    provenance_table,
    runs_section,
    score_rows,
)
from bench.reports.details import cost_figure, draw_group_figures
from bench.reports.figures import Picture, save_for_paper
from bench.reports.latex import comparison_latex, make_papers, papers_latex, papers_table
from bench.reports.layout import render_markdown, render_page, slugify
from bench.reports.live import page_data
from bench.reports.notes import add_note_column, join_names
from bench.reports.papers import (
    best_published,
    compare_with_published,
    own_systems,
    published_section,
)
from bench.reports.sections import Exhibit, group_by_heading
from bench.reports.summary import (
    Summary,
    compare_systems,
    split_largest_groups,
    summarise_group,
    tab_labels,
)
from bench.store.client import Store
from bench.values import few
from bench.values.measures import all_costs
from bench.values.result import BATCH_NOTE, Result, format_count
from bench.values.table import write_sheet


def write_report(
    store: Store | Bundle,
    folder: Path,
    budgets: Mapping[str, float] | None = None,
    against: str = "",
    selection: Mapping[str, Iterable[object]] | None = None,
    paper_columns: Sequence[str] = ("accuracy",),
    with_history: bool = False,
    numbers: pd.DataFrame | None = None,
) -> list[Path]:
    """Write ``index.html``, ``comparison.md``, LaTeX tables, CSV tables and figures as SVG.

    Args:
        store: store or bundle of the runs.
        folder: folder for all files; a report that is interrupted leaves the earlier one there.
        budgets: largest or smallest amount of each cost.
        against: system that tests compare with, in each group that has it; empty for the best one.
        selection: values of the selected runs (`bench.reading.runs.select_runs`).
        paper_columns: columns of ``paper.tex`` and ``paper.csv``.
        with_history: True adds each system over git revisions.
        numbers: published numbers (`bench.reports.own_numbers.load_numbers`); default the papers'.

    Raises:
        InputError: no run is stored or selected, ``against`` has no complete run, or the folder
            cannot be written.
    """
    results = select_or_fail(load_results(store, selection), selection or {})
    runs = results_on_captures(results)
    systems = sorted({r.system for r in runs if r.is_complete and r.predicts_alone})
    if against and against not in systems:
        raise InputError(
            f"against={against}: no complete run of this system is stored; "
            f"{suggest_names(against, systems)}"
        )
    revisions = load_clean_runs(store, selection) if with_history else []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
        with hold_path(folder) as scratch:
            scratch.mkdir()
            published = load_published() if numbers is None else numbers
            report = Report(results, scratch, budgets or {}, published, against, revisions)
            if with_history and not report.histories:
                warn("warning: history=yes: no system has complete runs of several revisions")
            written = report.write(paper_columns)
            (folder / "figures").mkdir(exist_ok=True)
            for name in written:
                os.replace(scratch / name, folder / name)
        for figure in (folder / "figures").glob("[0-9]*-*.*"):
            if figure.relative_to(folder) not in written:  # of an earlier report
                figure.unlink()
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e
    return [folder / name for name in written]


class Report:
    """The values from which sections and files of one report are made, each computed once.

    Args:
        results: selected results of all kinds.
        folder: empty folder for all files.
        budgets: largest or smallest amount of each cost.
        numbers: published numbers.
        against: system that tests compare with; empty for the best one.
        revisions: runs of all git revisions, for the history.
    """

    def __init__(
        self,
        results: Sequence[Result],
        folder: Path,
        budgets: Mapping[str, float],
        numbers: pd.DataFrame,
        against: str = "",
        revisions: Sequence[Result] = (),
    ) -> None:
        self.results, self.runs = results, results_on_captures(results)
        self.folder, self.figures = folder, folder / "figures"
        self.figures.mkdir()
        self.groups = group_results(self.runs)
        self.largest_groups, self.omitted_groups = split_largest_groups(self.groups)
        self.summaries = summarise_groups(
            self.largest_groups, results, budgets, numbers, against, self.figures
        )
        self.others = [
            Summary(name, self.groups[name], *compare_systems(self.groups[name], against), against)
            for name in self.omitted_groups
        ]
        for i, other in enumerate(self.others, len(self.summaries) + 1):
            file = f"{i}-{slugify(other.name)}"
            draw_group_figures(other.results, other.subjects, other.name, self.figures, file)
        every = [*self.summaries, *self.others]
        tests = {group.name: (group.subjects, group.rows) for group in every}
        self.rows = score_rows(self.groups, against, tests, numbers)
        self.rankings = over_corpora.rank_over_corpora(self.groups)
        self.numbers = numbers
        self.published = compare_with_published(self.runs, numbers)
        self.revisions = revisions

    @cached_property
    def histories(self) -> dict[str, pd.DataFrame]:
        """Stored revisions and steps of each group with several revisions."""
        groups = group_results(self.revisions)
        tables = {name: history.find_steps(runs) for name, runs in groups.items()}
        return {name: table for name, table in tables.items() if len(table)}

    @cached_property
    def views(self) -> list[tuple[Any, list[Result]]]:
        """Views that apply to a result, also those of protocols, with these results."""
        used = {r["protocol_name"] for r in self.results} & registered_parts("protocols").keys()
        protocols = (load_part("protocols", name) for name in sorted(used))
        places = dict.fromkeys(getattr(protocol, "view", "") for protocol in protocols)
        views = [*load_views().values(), *(import_object(place)() for place in places if place)]
        applied = ((view, [r for r in self.results if view.applies_to(r)]) for view in views)
        return [(view, results) for view, results in applied if results]

    def write(self, paper_columns: Sequence[str]) -> list[Path]:
        """Write all files; their paths relative to the folder, the page last."""
        averaged = average_seeds(self.rows, self.runs)
        papers = make_papers(averaged, paper_columns)
        tables = self.csv_tables() | ({"paper": papers_table(papers)} if papers else {})
        for name, table in tables.items():
            headings = UNITS if name == "comparison" else {}
            write_sheet(table.rename(columns=headings), self.folder / f"{name}.csv")
        texts = {}
        if self.runs:
            texts = {"comparison.tex": comparison_latex(averaged)}
            texts["paper.tex"] = papers_latex(papers)
        values = {name: make_section(self) for name, make_section in SECTIONS.items()}
        title = f"Which system to choose: {', '.join(values['head']['corpora'])}"
        texts["comparison.md"] = render_markdown("report.jinja", title=title, **values)
        texts["index.html"] = render_page("report.jinja", title, script="page.js", **values)
        for name, text in texts.items():
            (self.folder / name).write_text(text, encoding="utf-8")
        figures = sorted(path.relative_to(self.folder) for path in self.figures.iterdir())
        return [*figures, *(Path(f"{name}.csv") for name in tables), *map(Path, texts)]

    def csv_tables(self) -> dict[str, pd.DataFrame]:
        """The tables of the CSV files by name, with footnotes."""
        of_views: dict[str, pd.DataFrame] = {}
        for view, results in self.views:
            of_views |= view.csv_tables(results)
        every = [*self.summaries, *self.others]
        ranking_columns = pd.DataFrame(columns=[*over_corpora.COLUMNS, "group"])
        of_runs = {
            "comparison": comparison_table(self.rows),
            "published": self.published,
            "statistics": _concat_groups({group.name: group.rows for group in every}),
            "pairs": _concat_groups({group.name: group.pairs for group in every}),
            "ranking": _concat_groups(self.rankings, ranking_columns),
        }
        data = {name: str(runs[0]["data"]) for name, runs in self.groups.items()}
        for name, table in self.rankings.items():
            data |= {name: "haart"} if "haart_place" in table else {}
        people = {g.name: g.subjects.shape[1] for g in every if len(g.subjects)}
        tables = {name: table for name, table in of_views.items() if len(table)}
        tables |= {name: table for name, table in of_runs.items() if self.runs or len(table)}
        tables = {name: add_note_column(table, data, people) for name, table in tables.items()}
        tables["provenance"] = provenance_table(group_results(self.results))
        others = {"history": history.history_sheet(self.histories)}
        others["protocols"] = ledger.make_ledger(self.runs)
        return tables | {name: table for name, table in others.items() if len(table)}


def _concat_groups(
    tables: Mapping[str, pd.DataFrame], empty: pd.DataFrame | None = None
) -> pd.DataFrame:
    """Tables below each other, with the name of each in a column ``group``."""
    parts = [table.assign(group=name) for name, table in tables.items()]
    return pd.concat([pd.DataFrame() if empty is None else empty, *parts], ignore_index=True)


def summarise_groups(
    groups: Mapping[str, Sequence[Result]],
    results: Sequence[Result],
    budgets: Mapping[str, float],
    numbers: pd.DataFrame,
    against: str,
    folder: Path,
) -> list[Summary]:
    """A summary of each group, with its figures written into a folder."""
    alone = [r for r in results if r.predicts_alone]
    models = {r.system: str(r["model_name"]) for r in alone}
    labels, summaries, keys = tab_labels(groups), [], set[str]()
    for i, (name, runs) in enumerate(groups.items(), 1):
        summary, file = summarise_group(name, runs, alone, budgets, against), f"{i}-{slugify(name)}"
        protocol = str(runs[0]["protocol_name"])
        summary.label = labels[i - 1]
        summary.key = slugify(name, most=200) if protocol in keys else protocol
        keys.add(protocol)
        draw_charts(summary, models, budgets, numbers, folder, file)
        summary.pictures = draw_group_figures(runs, summary.subjects, name, folder, file)
        summary.page_data = page_data(summary, models)
        summaries.append(summary)
    return summaries


def draw_charts(
    summary: Summary,
    models: Mapping[str, str],
    budgets: Mapping[str, float],
    numbers: pd.DataFrame,
    folder: Path,
    file: str,
) -> None:
    """Draw accuracy against each cost of a group of several candidates."""
    if summary.choice is None or len(summary.choice.table) < 2 or not len(summary.subjects):
        return
    points = chart_points(summary, models, {*load_published()["system"]} - {""})
    omitted = len(summary.choice.table) - len(points)
    best = best_published(summary.results[0], numbers)
    for key in summary.costs:
        cost = all_costs()[key]
        chart = draw_cost_chart(summary.name, points, cost, budgets.get(key), omitted, best)
        if chart is not None:
            drawing, caption = chart
            picture = Picture(f"{file}-speed-{slugify(key)}", caption, folder)
            picture.path.write_text(drawing, encoding="utf-8")
            summary.charts.append({"label": cost.title, "picture": picture})
        if (figure := cost_figure(points, cost)) is not None:
            save_for_paper(figure, folder, f"{file}-speed-{slugify(key)}", summary.name)


def describe_runs(report: Report) -> dict[str, Any]:
    """The head of the page: numbers of runs and systems, and warnings."""
    shown = report.runs or report.results
    runs, systems = len(shown), len({r.system for r in shown})
    return {
        "corpora": sorted({r.context[0] for r in shown}),
        "counts": f"{format_count(runs, 'run')} of {format_count(systems, 'system')}",
        "synthetic": any(r["synthetic"] == "true" for r in report.results),
        "failed": sorted({r.system for r in report.runs if r["folds_failed"] > 0}),
        "stale": stale_sentences(report.results),
        "on_batch": sorted({r.system for r in report.runs if not r.predicts_alone}),
        "batch_note": BATCH_NOTE,
        "omitted": join_names([f"“{name}”" for name in report.omitted_groups]),
    }


def collect_exhibits(report: Report) -> dict[str, list[Exhibit]]:
    """Exhibits of views, people, corpora, protocols and revisions, by heading."""

    def exhibits() -> Iterator[Exhibit]:
        for view, results in report.views:
            yield from view.make_exhibits(results, report.figures)
        summary = next((group.people for group in report.summaries if group.people), "")
        for group in report.summaries:
            if "subjects" in group.pictures:
                yield Exhibit("People", group.pictures["subjects"], summary=summary)
        yield from over_corpora.ranking_exhibits(report.rankings)
        yield from ledger.ledger_exhibits(report.runs, report.published, report.figures)
        yield from history.history_exhibits(report.histories, report.figures)

    return group_by_heading(exhibits())


def missing_measurements(report: Report) -> list[tuple[str, str]]:
    """Commands that would measure what no result has, each with its summary."""
    measured = {view.key for view, _ in report.views}
    arguments = next((group.arguments for group in report.summaries if group.arguments), "")
    return [
        (format_command(name, repeated_arguments(arguments)), command.summary)
        for name, command in run_commands().items()
        if command.makes not in measured
    ]


def describe_published(report: Report) -> dict[str, Any]:
    """Published numbers beside ours."""
    beside = pd.concat(
        [report.published, own_systems(report.runs, report.numbers)], ignore_index=True
    )
    return published_section(beside) | {"fewest": few.FEWEST_FOR_INTERVAL}


def describe_rows(report: Report) -> dict[str, Any] | None:
    """All runs in one table; None without runs on captures."""
    order = [*report.largest_groups, *report.omitted_groups]
    return runs_section(report.rows, order) if report.runs else None


def describe_provenance(report: Report) -> dict[str, Any]:
    """Corpora, versions and commands of the runs."""
    table = provenance_table(group_results(report.results))
    return provenance_section(report.runs or report.results, table)


SECTIONS: dict[str, Callable[[Report], Any]] = {  # values of the template, in the order of the page
    "head": describe_runs,
    "groups": lambda report: report.summaries,
    "sections": collect_exhibits,
    "unmeasured": missing_measurements,
    "published": describe_published,
    "runs": describe_rows,
    "provenance": describe_provenance,
}
