"""The report as a whole: ``bench report`` rebuilds it from MLflow and the files beside this one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from bench.errors import InputError, nearest
from bench.grammar.options import makers
from bench.ground.progress import warn
from bench.ground.registry import imported, load, names, views
from bench.ground.scratch import owner, sweep
from bench.ground.words import typed
from bench.reading.candidates import repeated
from bench.reading.frame import grouped
from bench.reading.runs import every_result, every_run, of_captures, wanted
from bench.reports import history, ledger, over_corpora
from bench.reports.bundle import Bundle
from bench.reports.chart import cost_chart, marks
from bench.reports.comparison import (
    UNITS,
    comparison,
    provenance,
    provenance_section,
    published,
    runs_section,
    scored,
)
from bench.reports.contexts import Part, Section, listed, noted
from bench.reports.details import pictures
from bench.reports.figures import Picture
from bench.reports.latex import latex, papers, sheet, side_by_side
from bench.reports.layout import markdown, page, slug
from bench.reports.live import packed
from bench.reports.papers import against as beside_papers
from bench.reports.papers import best_published, published_section, yours
from bench.reports.summary import Summary, labels, largest_groups, summary_of
from bench.store.client import Store
from bench.values import few
from bench.values.measures import costs
from bench.values.result import MARKED, Result, Row, several
from bench.values.table import write_sheet


def write_report(
    store: Store | Bundle,
    folder: Path,
    budgets: Mapping[str, float] | None = None,
    against: str = "",
    asked: Mapping[str, Iterable[object]] | None = None,
    paper: Sequence[str] = ("accuracy",),
    over_revisions: bool = False,
) -> list[Path]:
    """Write ``index.html``, ``comparison.md``, LaTeX tables, a CSV file for each table, figures as SVG.

    Tests compare with the system ``against``, in each group that has it, else with the best one. ``asked`` selects
    runs as `bench.reading.runs.selected` does, ``paper`` columns of ``paper.tex`` and ``paper.csv``.
    ``over_revisions`` adds each system over git revisions.
    """
    results = wanted(every_result(store, asked), asked or {})
    runs = of_captures(results)
    systems = sorted({r.system for r in runs if r.complete and r.alone})
    if against and against not in systems:
        raise InputError(
            f"against={against}: no complete run of this system is stored; {nearest(against, systems)}"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder, ".")
        with tempfile.TemporaryDirectory(prefix=f".{owner()}", dir=folder) as beside:
            revisions = every_run(store, asked) if over_revisions else None
            written = _write(Path(beside), runs, results, budgets or {}, against, paper, revisions)
            (folder / "figures").mkdir(exist_ok=True)
            for name in (
                written
            ):  # a report that is stopped while it is made leaves the earlier one as it was
                os.replace(Path(beside) / name, folder / name)
        for old in (folder / "figures").glob("[0-9]*-*.[ps][nv]g"):
            if old.relative_to(folder) not in written:  # of an earlier report
                old.unlink()
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e
    return [folder / name for name in written]


def _write(
    folder: Path,
    runs: list[Result],
    results: list[Result],
    budgets: Mapping[str, float],
    against: str,
    paper: Sequence[str],
    revisions: Sequence[Result] | None,
) -> list[Path]:
    """Write a report into an empty folder; its files, the page last, relative to the folder."""
    figures = folder / "figures"
    figures.mkdir()
    groups = grouped(runs)
    largest, left_out = largest_groups(groups)
    summaries = summarised(largest, results, budgets, against, figures)
    ranked = over_corpora.rankings(groups)
    rows = scored(
        groups, against, {group.name: (group.subjects, group.rows) for group in summaries}
    )
    tables = csv_tables(groups, results, summaries, ranked, rows)
    over_revisions, tables["history"] = history.section(revisions or [], figures)
    if revisions is not None and over_revisions is None:
        warn("warning: history=yes: no system has complete runs of several revisions")
    under_protocols, of_protocols = ledger.section(runs, tables["published"], figures)
    made = papers(runs, paper)
    shown_runs = runs or results
    values = {
        "title": f"Which system to choose: {', '.join(sorted({r.context[0] for r in shown_runs}))}",
        "counts": f"{several(len(shown_runs), 'run')} of {several(len({r.system for r in shown_runs}), 'system')}",
        "synthetic": any(r["synthetic"] == "true" for r in results),
        "failed": sorted({r.system for r in runs if r["folds_failed"] > 0}),
        "on_batch": sorted({r.system for r in runs if not r.alone}),
        "marked": MARKED,
        "groups": summaries,
        "left_out": listed([f"“{name}”" for name in left_out]) if left_out else "",
        "sections": [
            *sections(summaries, results, ranked, figures),
            *under_protocols,
            *filter(None, [over_revisions]),
        ],
        "unmeasured": unmeasured(
            results, next((group.arguments for group in summaries if group.arguments), "")
        ),
        "published": published_section(
            pd.concat([tables["published"], yours(runs)], ignore_index=True)
        ),
        "few": few.INTERVAL,
        "runs": runs_section(rows, [*largest, *left_out]) if runs else None,
        "provenance": provenance_section(shown_runs, tables["provenance"]),
    }
    tables = {
        name: table for name, table in tables.items() if (runs and name != "history") or len(table)
    }
    tables |= {"paper": sheet(made)} if made else {}
    tables |= {"protocols": of_protocols} if len(of_protocols) else {}
    for name, table in tables.items():
        write_sheet(
            table.rename(columns=UNITS) if name == "comparison" else table, folder / f"{name}.csv"
        )
    texts = {"comparison.tex": latex(rows), "paper.tex": side_by_side(made)} if runs else {}
    texts["comparison.md"] = markdown("report.jinja", **values)
    texts["index.html"] = page("report.jinja", script="page.js", **values)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    drawn = sorted(path.relative_to(folder) for path in figures.iterdir())
    return [*drawn, *(Path(f"{name}.csv") for name in tables), *map(Path, texts)]


def summarised(
    groups: Mapping[str, Sequence[Result]],
    results: Sequence[Result],
    budgets: Mapping[str, float],
    against: str,
    folder: Path,
) -> list[Summary]:
    """A summary of each group, its figures written into a folder."""
    alone = [r for r in results if r.alone]
    models = {r.system: str(r["model_name"]) for r in alone}
    known = {*published()["system"]} - {""}
    protocols = [str(members[0]["protocol_name"]) for members in groups.values()]
    made = []
    for i, (label, (name, members)) in enumerate(
        zip(labels(groups), groups.items(), strict=True), 1
    ):
        group, file = summary_of(name, members, alone, budgets, against), f"{i}-{slug(name)}"
        group.label, group.key = label, protocols[i - 1]
        if group.key in protocols[: i - 1]:
            group.key = slug(name, most=200)
        if group.among is not None and len(group.subjects) and len(group.among.table) > 1:
            points = marks(group, models, known)
            left = len(group.among.table) - len(points)
            best = best_published(members[0])
            for key in group.costs:
                if chart := cost_chart(name, points, costs()[key], budgets.get(key), left, best):
                    picture = Picture(f"{file}-speed-{slug(key)}", chart[1], folder)
                    picture.path.write_text(chart[0], encoding="utf-8")
                    group.charts.append({"label": costs()[key].title, "picture": picture})
        group.pictures = pictures(members, group.subjects, name, folder, file)
        group.live = packed(group, models)
        made.append(group)
    return made


def csv_tables(
    groups: Mapping[str, Sequence[Result]],
    results: Sequence[Result],
    summaries: Sequence[Summary],
    ranked: Mapping[str, pd.DataFrame],
    rows: Sequence[Row],
) -> dict[str, pd.DataFrame]:
    """The tables of the CSV files by name, with footnotes."""

    def together(tables: Mapping[str, pd.DataFrame], columns: Sequence[str] = ()) -> pd.DataFrame:
        parts = [table.assign(group=name) for name, table in tables.items()]
        return pd.concat([pd.DataFrame(columns=columns or None), *parts], ignore_index=True)

    of_views = {
        name: table
        for view, members in shown(results)
        for name, table in view.sheets(members).items()
    }
    tables = {name: table for name, table in of_views.items() if len(table)} | {
        "comparison": comparison(rows),
        "published": beside_papers([r for members in groups.values() for r in members]),
        "statistics": together({group.name: group.rows for group in summaries}),
        "pairs": together({group.name: group.pairs for group in summaries}),
        "ranking": together(ranked, [*over_corpora.COLUMNS, "group"]),
    }
    data_of = {name: str(members[0]["data"]) for name, members in groups.items()}
    data_of |= {title: "haart" for title, table in ranked.items() if "haart_place" in table}
    people_of = {group.name: group.subjects.shape[1] for group in summaries if len(group.subjects)}
    tables = {name: noted(table, data_of, people_of) for name, table in tables.items()}
    return tables | {"provenance": provenance(grouped(results))}


def shown(results: Sequence[Result]) -> Iterator[tuple[Any, list[Result]]]:
    """Views that there is a result of, with these results: of captures, studies, circumstances, and of protocols."""
    for view in (*views().values(), *_of_protocols(results)):
        if members := [r for r in results if view.holds(r)]:
            yield view, members


def _of_protocols(results: Sequence[Result]) -> list[Any]:
    """What protocols show of their runs; few do."""
    used = sorted({r["protocol_name"] for r in results} & names("protocols").keys())
    places = dict.fromkeys(getattr(load("protocols", name), "view", "") for name in used)
    return [imported(place)() for place in places if place]


def sections(
    summaries: Sequence[Summary],
    results: Sequence[Result],
    ranked: Mapping[str, pd.DataFrame],
    folder: Path,
) -> list[Section]:
    """The sections of circumstances, of people and of several corpora; those of one heading are one."""
    made = [view.section(members, folder) for view, members in shown(results)]
    if people := [
        Part(picture=group.pictures["subjects"])
        for group in summaries
        if "subjects" in group.pictures
    ]:
        made.append(
            Section(
                "People", people, next((group.people for group in summaries if group.people), "")
            )
        )
    joined: dict[str, Section] = {}
    for section in [*filter(None, made), *filter(None, [over_corpora.section(ranked)])]:
        before = joined.get(section.heading, Section(section.heading))
        parts, line = [*before.parts, *section.parts], f"{section.line} {before.line}".strip()
        joined[section.heading] = replace(section, parts=parts, line=line)
    return [*joined.values()]


def unmeasured(results: Sequence[Result], arguments: str) -> list[tuple[str, str]]:
    """Commands that would measure what no result has, each with its summary."""
    held = {view.key for view, _ in shown(results)}
    words = repeated(arguments)
    return [
        (typed(name, words), one.summary) for name, one in makers().items() if one.makes not in held
    ]
