"""The report as a whole: ``bench report`` rebuilds it from MLflow and the files beside this one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.outcomes import statistics
from bench.outcomes.comparable import MARKED, depends_on_batch
from bench.outcomes.runs import independent, of_kinds, rows_of, tracked, with_groups
from bench.outcomes.store import Store
from bench.scratch import owner, sweep
from reports import fault_curves as behaviour
from reports import published_tables as recomputed
from reports.candidates import Considered, chart_data, considered
from reports.comparison import comparison, published, shown
from reports.figures import Picture
from reports.latex import latex
from reports.layout import Block, Briefs, Chart, Heading, Table, Text, footnotes, markdown, page
from reports.new_person import curves_of, newcomer_blocks
from reports.numbers import listed, notes_on
from reports.papers import published_blocks, recomputed_blocks
from reports.provenance import provenance, software
from reports.reproduction import against
from reports.run_groups import GROUPS, group_of, largest_groups
from reports.spreadsheet import write_sheet
from reports.summary import EARLY, FAULTS, PEOPLE, STATISTICS, briefs

ROWS = 300  # of a table on the page; the CSV files hold all


def write_report(store: Store, folder: Path, budgets: Mapping[str, float] | None = None) -> list[Path]:
    """Write ``index.html``, ``comparison.md``, ``comparison.tex``, a CSV file for each table, figures as PNG and SVG.

    Args:
        store: where the runs are.
        folder: where they go; it is created.
        budgets: the most of each cost that a system to choose may take, in the units of `bench.costs.COSTS`.

    Returns:
        The files written.

    Raises:
        InputError: the store holds no scored run, or the folder cannot be written.
    """
    runs, papers = with_groups(tracked(store)), published()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder, ".")
        with tempfile.TemporaryDirectory(prefix=f".{owner()}", dir=folder) as beside:
            written = _write(store, Path(beside), runs, papers, budgets or {})
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
    store: Store, folder: Path, runs: pd.DataFrame, papers: pd.DataFrame, budgets: Mapping[str, float]
) -> list[Path]:
    """Write a report into an empty folder; its files, the page last, relative to the folder."""
    (folder / "figures").mkdir()
    blocks, tables = assemble(store, runs, papers, folder / "figures", budgets)
    for name, table in tables.items():
        write_sheet(table, folder / f"{name}.csv")
    (folder / "comparison.md").write_text(markdown(blocks, folder), encoding="utf-8")
    (folder / "comparison.tex").write_text(latex(tables["comparison"]), encoding="utf-8")
    (folder / "index.html").write_text(page(blocks, blocks[0].text), encoding="utf-8")
    pictures = [picture for b in blocks for picture in ([b] if isinstance(b, Picture) else getattr(b, "pictures", []))]
    drawn = sorted(path.relative_to(folder) for picture in pictures for path in picture.paths)
    tables_and_text = [*(f"{name}.csv" for name in tables), "comparison.md", "comparison.tex", "index.html"]
    return [*drawn, *map(Path, tables_and_text)]


def assemble(
    store: Store, runs: pd.DataFrame, papers: pd.DataFrame, folder: Path, budgets: Mapping[str, float]
) -> tuple[list[Block], dict[str, pd.DataFrame]]:
    """All blocks of the report in order, and the tables that go into CSV files; figures are drawn into ``folder``."""
    others = of_kinds(store, ("stress", "stream", "chip"))
    largest, left_out = largest_groups(runs)
    groups = {
        g: group_of(store, part, others.get("chip"), papers, folder, i)
        for i, (g, part) in enumerate(largest.items(), 1)
    }
    kinds = {kind: independent(found) for kind, found in (others | {"cell": runs}).items()}
    choices = [considered(store, g, runs, budgets, kinds) for g in largest]
    curves = curves_of(store, runs)
    beside = against(papers, runs, store)
    table = comparison(store, runs, papers)

    blocks: list[Block] = [Heading(f"Which recogniser to take: {_corpora(runs)}", 1), *warnings(runs)]
    blocks += [Heading("Verdict"), *(c.answer() if isinstance(c, Considered) else c for c in choices)]
    if left_out:
        which = listed([f"“{name}”" for name in left_out])
        blocks.append(Text(f"The {GROUPS} largest groups of runs have a verdict here; without one: {which}."))
    if drawn := [c for c in choices if isinstance(c, Considered)]:
        models = dict(zip(runs["system"], runs["model_name"], strict=True))
        chart = chart_data(drawn, models, papers)
        pictures = [picture for group in groups.values() for picture in group.speed]
        blocks += [Heading("Accuracy and cost"), Text(COST), Chart(chart, pictures)]
    blocks += [Heading("Runs"), *run_blocks(table, [*largest, *left_out], len(runs), runs["system"].nunique())]
    if said := briefs(store, groups, curves):
        blocks += [Heading("In a sentence each"), Briefs(said)]
    blocks += [Heading("Published numbers"), *published_blocks(beside)]
    for title, found in {
        EARLY: behaviour.stream_blocks(store, folder),
        FAULTS: behaviour.stress_blocks(store, folder),
        PEOPLE: [*newcomer_blocks(curves, folder), *(b for group in groups.values() for b in group.people)],
        STATISTICS: [b for name, group in groups.items() if group.compared for b in _titled(name, group.compared)],
        "Gestures": [b for name, group in groups.items() if group.details for b in _titled(name, group.details)],
        "Published numbers, recomputed": recomputed_blocks(papers),
    }.items():
        blocks += [Heading(title), *found] if found else []
    from_runs = provenance(pd.concat([runs, *map(with_groups, others.values())], ignore_index=True))
    blocks += [Heading("Provenance"), *provenance_blocks(runs, from_runs)]
    rows = [group.rows.assign(group=name) for name, group in groups.items()]
    pairs = [group.pairs.assign(group=name) for name, group in groups.items()]
    return blocks, {
        "comparison": table,
        "published": beside,
        "recomputed": recomputed.recomputed(papers),
        "statistics": pd.concat(rows, ignore_index=True),
        "pairs": pd.concat(pairs, ignore_index=True),
        "provenance": from_runs,
    }


COST = (
    "Every way in which a tracked system labels is a mark: whole captures, in Python or as C, or what it has seen of "
    "them within a budget of time. Accuracy is the mean over subjects with its 95 % t-interval; seeds are averaged. "
    "Times depend on the machine that is named under provenance."
)


def _titled(title: str, blocks: list[Block]) -> list[Block]:
    return [Heading(title, 3), *blocks]


def _corpora(runs: pd.DataFrame) -> str:
    return ", ".join(sorted(set(runs["data"] + np.where(runs["synthetic"] == "true", " (synthetic)", ""))))


def warnings(runs: pd.DataFrame) -> list[Block]:
    """What must be known before any number is read."""
    blocks: list[Block] = []
    if (runs["synthetic"] == "true").any():
        blocks.append(
            Text(
                "Rows and figures marked (synthetic) come from generated captures and say nothing about people.",
                warning=True,
            )
        )
    if len(failed := runs[runs["folds_failed"] > 0]):
        systems = ", ".join(sorted(set(failed["system"])))
        blocks.append(
            Text(f"Runs with failed folds are scored on the others and compared with nothing: {systems}.", warning=True)
        )
    if marked := sorted({str(run["system"]) for run in rows_of(runs) if depends_on_batch(run)}):
        blocks.append(Text(f"{MARKED}: {', '.join(marked)}.", warning=True))
    return blocks


def run_blocks(table: pd.DataFrame, order: list[str], runs: int, systems: int) -> list[Block]:
    """Every tracked run and unit, as far as the page has room.

    Args:
        table: as `reports.comparison.comparison` makes it.
        order: of the groups.
        runs: number of them.
        systems: number of them.
    """
    said = Text(
        f"{runs} tracked runs of {systems} systems. Numbers are compared only where data, subset, protocol and unit "
        "agree: the rows under one heading of the table. Every interval is over subjects: people differ more than "
        "captures of one person do."
    )
    caption = (
        "Accuracy is pooled over the tested captures (or windows), its interval a bootstrap over subjects. p Holm is "
        "of the paired Wilcoxon test against the best system, as under statistics; - where there is no test. Flash "
        "counts learnt numbers, RAM the numbers in memory for one decision. Predict is one whole capture from raw "
        "frames to label on one thread, feature extraction included; decision is the median touch that must be "
        "observed plus computing time on that machine; the verdict's budget counts touch alone. Fit is the mean of a "
        "fold without feature extraction. n is the number of tested subjects."
    )
    if (table["source"] == "reference").any():
        caption += " Rows marked (reference) come with touchbench: costs that only runs tell are missing."
    table = table.sort_values("group", key=lambda names: names.map(order.index), kind="stable")
    together = table["group"] + table["unit"].map({"capture": ", whole captures", "window": ", single windows"})
    kept = table
    if len(table) > ROWS:
        each = max(1, ROWS // together.nunique())
        kept = table.groupby(together, sort=False).head(each)
        caption += f" The first {each} rows of each group; all {len(table)} are in comparison.csv."
    marks, notes = footnotes([notes_on(r.system, r.data) for r in kept.itertuples()])
    few = [g for g in order if (table.loc[table["group"] == g, "subjects"] < statistics.FEW_SUBJECTS).any()]
    warning = f"Fewer than {statistics.FEW_SUBJECTS} test subjects, so that intervals are hardly worth anything: "
    return [
        said,
        *([Text(warning + "; ".join(few) + ".", warning=True)] if few else []),
        Table(shown(kept), caption, groups=list(together[kept.index]), marks=marks, notes=notes),
    ]


def provenance_blocks(runs: pd.DataFrame, table: pd.DataFrame) -> list[Block]:
    """Corpora, versions, and the command of every run."""
    kept = table.iloc[:ROWS]
    caption = "The command that rebuilds each row, and what it ran on."
    if len(table) > len(kept):
        caption += f" The first {len(kept)} of {len(table)}; all are in provenance.csv."
    corpora = runs.groupby(["data", "synthetic", "corpus_digest"], sort=True).size().reset_index(name="runs")
    corpora["data"] += np.where(corpora.pop("synthetic") == "true", " (synthetic)", "")
    return [
        Text("This report is made by bench report from the MLflow store and the files in reports/ alone."),
        Table(corpora.astype(str), "Corpora by content."),
        Table(software(runs).astype(str), "Versions that runs were made with."),
        Table(kept.astype(str), caption, code=("command",)),
    ]
