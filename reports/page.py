"""The report as a whole: ``bench report`` rebuilds it from MLflow and the files beside this one."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from bench import few
from bench.comparable import MARKED, facts_of, notes_on, several
from bench.described import definitions
from bench.errors import InputError, nearest
from bench.measures import costs
from bench.outcomes.runs import every_result, grouped, of_captures, wanted
from bench.outcomes.store import Store
from bench.reports import over_corpora
from bench.reports.candidates import Answer, Considered, considered, marks
from bench.reports.comparison import comparison, published, shown
from bench.reports.figures import save
from bench.reports.latex import latex, side_by_side
from bench.reports.layout import markdown, page
from bench.reports.numbers import busy, listed, noted
from bench.reports.panes import Chart, Pane, labels, systems
from bench.reports.paper import papers, sheet
from bench.reports.papers import published_section
from bench.reports.part import Part, Section
from bench.reports.provenance import provenance, software
from bench.reports.reproduction import against as beside_papers
from bench.reports.run_groups import GROUPS, Group, group_of, largest_groups, slug
from bench.reports.sections import briefs as told
from bench.reports.sections import joined, sections, sheets, unmeasured
from bench.reports.speed import cost_chart
from bench.reports.summary import PEOPLE, briefs
from bench.result import Result
from bench.scratch import owner, sweep
from bench.table import of_text, rows_of, write_sheet

ROWS = 300  # of a table on the page; the CSV files hold all


def write_report(
    store: Store,
    folder: Path,
    budgets: Mapping[str, float] | None = None,
    against: str = "",
    asked: Mapping[str, Iterable[object]] | None = None,
    paper: Sequence[str] = ("accuracy",),
) -> list[Path]:
    """Write ``index.html``, ``comparison.md``, LaTeX tables, a CSV file for each table, figures as SVG.

    Args:
        store: store of the runs.
        folder: destination folder; it is created.
        budgets: budget of each cost (`bench.measures.costs`) of the system to choose.
        against: the system that tests compare with, in each group that has it; empty for the best one of each.
        asked: the runs to report, as `bench.outcomes.runs.selected` takes them; empty for all.
        paper: columns of ``paper.tex`` and ``paper.csv`` (`bench.reports.paper.columns_of`).

    Returns:
        The files written.

    Raises:
        InputError: no scored run is selected, or none of ``against``, or the folder cannot be written.
    """
    results = wanted(every_result(store), asked or {})
    runs = of_captures(results)
    systems = sorted({r.system for r in runs if r.complete and r.alone})
    if against and against not in systems:
        raise InputError(f"against={against}: no complete run of this system is stored; {nearest(against, systems)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder, ".")
        with tempfile.TemporaryDirectory(prefix=f".{owner()}", dir=folder) as beside:
            written = _write(Path(beside), runs, results, budgets or {}, against, paper)
            (folder / "figures").mkdir(exist_ok=True)
            for name in written:  # a report that is stopped while it is made leaves the earlier one as it was
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
) -> list[Path]:
    """Write a report into an empty folder; its files, the page last, relative to the folder."""
    (folder / "figures").mkdir()
    values, tables = assemble(runs, results, folder / "figures", budgets, against)
    tables = {name: table for name, table in tables.items() if runs or len(table)}
    made = papers(runs, paper)
    tables |= {"paper": sheet(made)} if made else {}
    for name, table in tables.items():
        write_sheet(table, folder / f"{name}.csv")
    (folder / "comparison.md").write_text(markdown("report.jinja", **values), encoding="utf-8")
    if runs:
        (folder / "comparison.tex").write_text(latex(tables["comparison"]), encoding="utf-8")
        (folder / "paper.tex").write_text(side_by_side(made), encoding="utf-8")
    (folder / "index.html").write_text(page("report.jinja", **values), encoding="utf-8")
    drawn = sorted(path.relative_to(folder) for path in (folder / "figures").iterdir())
    texts = [
        *(f"{name}.csv" for name in tables),
        *["comparison.tex", "paper.tex"][: 2 * bool(runs)],
        "comparison.md",
        "index.html",
    ]
    return [*drawn, *map(Path, texts)]


def assemble(
    runs: list[Result], results: list[Result], folder: Path, budgets: Mapping[str, float], against: str = ""
) -> tuple[dict[str, Any], dict[str, pd.DataFrame]]:
    """The variables of ``report.jinja``, by name, and the tables of the CSV files.

    Args:
        runs: results on captures, one for each system, seed, captures and protocol.
        results: results of all kinds.
        folder: destination folder of figures.
        budgets: budget of each cost.
        against: the system that tests compare with; empty for the best one of each group.
    """
    papers = published()
    alone = [r for r in results if r.alone]
    groups = grouped(runs)
    largest, left_out = largest_groups(groups)
    files = {name: f"{i}-{slug(name)}" for i, name in enumerate(largest, 1)}
    parts = {name: group_of(name, largest[name], folder, files[name], against) for name in largest}
    answers = [considered(name, largest[name], alone, budgets) for name in largest]
    models = {r.system: str(r["model_name"]) for r in alone}
    known = {*papers["system"]} - {""}
    ranked = over_corpora.rankings(groups)
    data_of = {name: str(members[0]["data"]) for name, members in groups.items()}
    data_of |= {title: "haart" for title, table in ranked.items() if "haart_place" in table}
    tables = {
        "comparison": comparison(groups, papers, against),
        "published": beside_papers(papers, runs),
        "statistics": pd.concat(
            [pd.DataFrame(), *(g.rows.assign(group=name) for name, g in parts.items())], ignore_index=True
        ),
        "pairs": pd.concat(
            [pd.DataFrame(), *(g.pairs.assign(group=name) for name, g in parts.items())], ignore_index=True
        ),
        "ranking": pd.concat(
            [
                pd.DataFrame(columns=[*over_corpora.COLUMNS, "group"]),
                *(table.assign(group=title) for title, table in ranked.items()),
            ]
        ),
    }
    people_of = {name: g.subjects.shape[1] for name, g in parts.items() if len(g.subjects)}
    tables = {name: noted(table, data_of, people_of) for name, table in (sheets(results) | tables).items()}
    tables["provenance"] = provenance(grouped(results))
    values = {
        "title": f"Which system to choose: {_corpora(runs or results)}",
        "synthetic": any(r["synthetic"] == "true" for r in results),
        "failed": sorted({r.system for r in runs if r["folds_failed"] > 0}),
        "on_batch": sorted({r.system for r in runs if not r.alone}),
        "marked": MARKED,
        "panes": [
            _pane(label, answer, members, parts[name], models, known, folder, files[name])
            for label, answer, (name, members) in zip(labels(largest), answers, largest.items(), strict=True)
        ],
        "largest": GROUPS,
        "left_out": listed([f"“{name}”" for name in left_out]) if left_out else "",
        "runs": runs_section(tables["comparison"], [*largest, *left_out]) if runs else None,
        "counts": counts(runs or results),
        "briefs": dict(briefs(told(results), parts)),
        "published": published_section(tables["published"]),
        "sections": joined([*sections(results, folder), *_people(parts)]),
        "unmeasured": unmeasured(results, _arguments(answers)),
        "groups": parts,
        "over": over_corpora.section(ranked),
        "few": few.INTERVAL,
        "provenance": provenance_section(runs or results, tables["provenance"]),
    }
    return values, tables


def counts(results: Sequence[Result]) -> str:
    """How many runs of how many systems there are."""
    return f"{several(len(results), 'run')} of {several(len({r.system for r in results}), 'system')}"


def _pane(
    label: str,
    answer: Answer,
    results: Sequence[Result],
    group: Group,
    models: Mapping[str, str],
    known: Collection[str],
    folder: Path,
    file: str,
) -> Pane:
    """What the page shows first of a group; its charts are written into a folder."""
    mixed = any(facts_of(r).mixes_subjects for r in results)
    about = "tests people of the training set" if mixed else "tests new people"
    if not isinstance(answer, Considered) or not len(group.subjects):
        return Pane(label, about, answer)
    charts, points = [], marks(answer, models, known)
    left = len(answer.among.table) - len(points)
    for name in answer.costs if len(answer.among.table) > 1 else []:
        if chart := cost_chart(answer.title, points, costs()[name], answer.budgets.get(name), left):
            picture = save(chart[0], folder, f"{file}-speed-{slug(name)}", answer.title, chart[1])
            charts.append(Chart(costs()[name].title, picture))
    return Pane(label, about, answer, systems(answer, group, str(results[0]["data"])), charts)


def _people(groups: Mapping[str, Group]) -> list[Section]:
    """The accuracy of each person, in each group."""
    drawn = [Part(picture=group.pictures["subjects"]) for group in groups.values() if "subjects" in group.pictures]
    return [Section(PEOPLE, drawn)] if drawn else []


def _arguments(answers: Sequence[Answer]) -> str:
    """Arguments of the run of the first chosen system; empty if it was not typed."""
    choices = [answer.choice for answer in answers if isinstance(answer, Considered)]
    return next((str(c.table.loc[c.chosen, "arguments"]) for c in choices if c.chosen is not None), "")


def _corpora(results: Sequence[Result]) -> str:
    return ", ".join(sorted({r.context[0] for r in results}))


def runs_section(table: pd.DataFrame, order: list[str]) -> dict[str, Any]:
    """Every tracked run and unit, as far as the page has room, and the groups with few subjects.

    Args:
        table: table of `bench.reports.comparison.comparison`.
        order: order of the groups.
    """
    table = table.sort_values("group", key=lambda names: names.map(order.index), kind="stable")
    together = table["group"] + table["unit"].map({"capture": ", whole captures", "window": ", single windows"})
    each = max(1, ROWS // together.nunique()) if len(table) > ROWS else len(table)
    kept = table.groupby(together, sort=False).head(each)
    remarks = [notes_on(str(row["system"]), str(row["data"])) + busy(row) for row in rows_of(kept)]
    scarce = table.loc[table["subjects"] < few.INTERVAL].drop_duplicates("group")
    return {
        "table": shown(kept, remarks, [*together[kept.index]]),
        "few": [f"{row.group}. {few.too_few(int(row.subjects))}" for row in scarce.itertuples()],
        "definitions": definitions(kept["system"]),
        "all": len(table),
        "each": each,
    }


def provenance_section(results: Sequence[Result], table: pd.DataFrame) -> dict[str, Any]:
    """Corpora, versions, and the command of every run."""
    counted = Counter((r["data"], r["synthetic"], r["corpus_digest"]) for r in results)
    names = ("data", "corpus_digest", "runs")
    rows = [(data + " (synthetic)" * (s == "true"), digest, n) for (data, s, digest), n in sorted(counted.items())]
    corpora = pd.DataFrame(rows, columns=names).astype(str)
    return {
        "corpora": of_text(corpora),
        "versions": of_text(software(results).astype(str)),
        "commands": of_text(table.iloc[:ROWS], code=("command",)),
        "all": len(table),
    }
