"""The ledger: systems under every protocol; published numbers without the points of theirs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.ground.typed import format_command
from bench.reading import statistics
from bench.reading.frame import accuracy_by_subject
from bench.reports.comparison import ROWS, load_published
from bench.reports.curves import draw_curves
from bench.reports.figures import save_figure
from bench.reports.notes import few_subjects_notes
from bench.reports.sections import SYSTEMS, Exhibit
from bench.values.measures import CODE, Measure, format_p_value, text_measure
from bench.values.result import COMPARISON_TAGS, Result, footnotes_of_system
from bench.values.sentences import render_sentences
from bench.values.table import Table, rows_of_frame

BASE = "loso"  # protocol that points are over
USUAL = ("windows", "kfold", "within", BASE)  # protocols of a complete ledger
COLUMNS = (
    text_measure("protocol"),
    Measure("accuracy", "accuracy % [95 %]", ends="accuracy"),
    Measure("points", "points over LOSO [95 %]", form="+.1f", ends="points"),
    Measure("p", "p Wilcoxon", form=format_p_value, spare=1),
    text_measure("place"),
    Measure("subjects", form=".0f"),
)
PUBLISHED_COLUMNS = (
    text_measure("number"),
    Measure("printed", "printed %", form="g"),
    text_measure("says", "protocol in the paper"),
    text_measure("nearest", "nearest of ours"),
    Measure("points", "points of the protocol [95 %]", form="+.1f", ends="points"),
    Measure("less", "printed less points"),
)
NAMES = (  # columns of `make_ledger`
    "data subset system protocol key mixes_subjects accuracy accuracy_low accuracy_high "
    "points points_low points_high p place subjects"
).split()
HEADING = "What a protocol adds"
SUMMARY = "the same systems under several protocols"
# By protocol: a run, and accuracy in percent [systems, subjects].
Accuracies = dict[str, tuple[Result, pd.DataFrame]]


def runs_by_captures(results: Sequence[Result]) -> list[list[Result]]:
    """Complete runs on the same captures under several protocols, a list for each captures."""

    def captures(result: Result) -> tuple[str, ...]:
        return tuple(str(result.get(name, "")) for name in ("synthetic", *COMPARISON_TAGS[:-1]))

    usable = sorted((r for r in results if r.is_complete and r.predicts_alone), key=captures)
    sets = [[*runs] for _, runs in groupby(usable, captures)]
    return [runs for runs in sets if len({r["protocol_label"] for r in runs}) > 1]


def accuracies_by_protocol(results: Sequence[Result]) -> Accuracies:
    """The first run under each protocol and accuracies of subjects, the highest mean first."""
    runs: dict[str, list[Result]] = {}
    for r in results:
        runs.setdefault(str(r["protocol_label"]), []).append(r)
    tables = {label: (each[0], accuracy_by_subject(each)[0]) for label, each in runs.items()}
    stored = [item for item in tables.items() if item[1][1].size]  # the store may lack a table
    return dict(sorted(stored, key=lambda item: -item[1][1].to_numpy(float).mean()))


def gains_over_base(table: pd.DataFrame, base: pd.DataFrame) -> pd.DataFrame:
    """Points over the base, of the systems and subjects of both [systems, subjects]."""
    systems = table.index.intersection(base.index)
    people = table.columns.intersection(base.columns)
    return (table.loc[systems, people] - base.loc[systems, people]).round(9)


def base_accuracies(accuracies: Accuracies) -> pd.DataFrame:
    """Accuracies under LOSO [systems, subjects]; empty if it was not run."""
    of_base = [table for run, table in accuracies.values() if run["protocol_name"] == BASE]
    return of_base[0] if of_base else pd.DataFrame()


def make_ledger(results: Sequence[Result]) -> pd.DataFrame:
    """Each system under each protocol, on captures with runs under two protocols or more.

    Returns:
        A row per captures, system and protocol, in percent: ``accuracy``, the mean over subjects
        with its 95 % t-interval (``accuracy_low``, ``accuracy_high``); ``points`` over LOSO, the
        mean paired difference over the subjects of both, with ``points_low``, ``points_high`` and
        ``p`` (two-sided Wilcoxon test); ``place`` of the system under this protocol; ``subjects``;
        ``mixes_subjects``. NaN where LOSO was not run.
    """
    parts = [_ledger_rows(accuracies_by_protocol(runs)) for runs in runs_by_captures(results)]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=NAMES)


def _ledger_rows(accuracies: Accuracies) -> pd.DataFrame:
    """The rows of one set of captures."""
    rows = []
    base = base_accuracies(accuracies)
    for label, (run, table) in accuracies.items():
        data, subset, _ = run.context
        points = gains_over_base(table, base)
        for place, (system, people) in enumerate(table.iterrows(), 1):
            low, high = np.clip(statistics.mean_interval(people.to_numpy(float)), 0, 100)
            row = {
                "data": data,
                "subset": subset,
                "protocol": label,
                "key": run["protocol"],
                "mixes_subjects": run.mixes_subjects,
                "system": system,
                "accuracy": people.mean(),
                "accuracy_low": low,
                "accuracy_high": high,
                "place": f"{place} of {len(table)}",
                "subjects": len(people),
            }
            if system in points.index and len(points.columns) and table is not base:
                test = statistics.paired_test(points.loc[system], 0 * points.loc[system])
                row |= {"points": test["difference"], "p": test["p"]}
                row |= {"points_low": test["low"], "points_high": test["high"]}
            rows.append(row)
    return pd.DataFrame(rows).reindex(columns=NAMES)


def published_on(data: str) -> pd.DataFrame:
    """Published numbers on a corpus, with the nearest of our protocols in ``key``."""
    papers = load_published()
    papers = papers[(papers["data"] == data) & papers["accuracy"].notna()]
    known = papers["protocol_key"] != "other"
    return papers.assign(key=papers["protocol_key"].where(known, papers["nearest_key"]))


def explain_published(data: str, accuracies: Accuracies) -> pd.DataFrame:
    """Published numbers on a corpus, a row each, with the points over LOSO of the nearest protocol.

    These are the mean of all systems that were run under both, with a 95 % t-interval over
    subjects: 0 for LOSO, NaN where the protocol of a number is unknown or was not run. No rows
    without runs under LOSO.
    """
    base, points_of = base_accuracies(accuracies), {BASE: (0.0, np.nan, np.nan)}
    if base.empty:
        return pd.DataFrame()
    for run, table in accuracies.values():
        gains = gains_over_base(table, base)
        if run["protocol_name"] != BASE and gains.size:
            people = gains.mean(axis=0).to_numpy(float)
            points = float(people.mean()), *statistics.mean_interval(people)
            points_of.setdefault(run["protocol_name"], points)
    rows = []
    for paper in published_on(data).itertuples():
        points, low, high = points_of.get(paper.key, (np.nan,) * 3)
        nearest = paper.key or "unknown"
        if paper.key and paper.protocol_key == "other":
            nearest += " (inferred)"
        if paper.key and paper.key not in points_of:
            nearest += ", not run"
        rows.append(
            {
                "id": paper.id,
                "number": f"{paper.reference}: {paper.classifier}",
                "printed": paper.accuracy,
                "says": paper.protocol,
                "nearest": nearest,
                "points": points,
                "less": paper.accuracy - points,
                "points_low": low,
                "points_high": high,
            }
        )
    return pd.DataFrame(rows)


def explained_share(printed: pd.Series, rest: pd.Series) -> float:
    """Share of the variance of some numbers that their rest lacks; NaN for fewer than three."""
    return 1 - float(rest.var() / printed.var()) if len(printed) > 2 else np.nan


def spread_sentences(numbers: pd.DataFrame, beside: pd.DataFrame, data: str) -> list[str]:
    """Sentences on the share of the spread that protocols, and runs of ours, explain."""
    known = numbers[numbers["points"].notna()]
    both = beside[(beside["data"] == data) & beside["ours"].notna()].drop_duplicates("id")
    errors = both["published"] - both["ours"]
    total = float(((both["published"] - both["published"].mean()) ** 2).sum())
    return render_sentences(
        *("bench.reports", "sentences", "explained"),
        known=known["printed"],
        share=explained_share(known["printed"], known["less"]),
        unknown=int((numbers["nearest"] == "unknown").sum()),
        not_run=int(numbers["nearest"].str.endswith("not run").sum()),
        ours=len(both) if len(both) > 2 else 0,
        own=1 - float((errors**2).sum()) / total if total else np.nan,
        off=float(errors.abs().mean()),
    )


def missing_commands(results: Sequence[Result]) -> list[str]:
    """Commands for the protocols that some system of a set lacks, one for equal arguments.

    The set needs the protocols of a complete ledger, of its other systems, and of published numbers
    on its captures.
    """
    by_arguments: dict[tuple[str, str], list[Result]] = {}
    for r in results:
        arguments = json.loads(r.get("touchbench.arguments") or "{}")
        others = {
            key: value
            for key, value in arguments.items()
            if key != "model" and not key.startswith("protocol")
        }
        if arguments:
            command = str(r["touchbench.command"]), json.dumps(others)
            by_arguments.setdefault(command, []).append(r)
    used = [str(r["protocol_name"]) for r in results]
    needed = dict.fromkeys(filter(None, [*USUAL, *used, *published_on(results[0]["data"])["key"]]))
    commands = []
    for (command, others), runs in by_arguments.items():
        models = dict.fromkeys(str(r["model_name"]) for r in runs)
        done = {(r["protocol_name"], r["model_name"]) for r in runs}
        protocols = [name for name in needed if any((name, model) not in done for model in models)]
        if protocols:
            words = json.loads(others)
            first = {"data": words.pop("data"), "protocol": ",".join(protocols)}
            commands.append(format_command(command, first | {"model": ",".join(models)} | words))
    return commands


def draw_slopes(rows: pd.DataFrame, title: str) -> Figure:
    """Accuracy under each protocol, a line per system; lines cross where the order changes."""
    protocols = rows.drop_duplicates("protocol")
    ordered = rows.sort_values("accuracy", ascending=False, kind="stable")
    systems = ordered["system"].unique()[:SYSTEMS]
    lines = []
    for i, system in enumerate(systems):
        of_system = rows[rows["system"] == system].set_index("protocol")
        curve = of_system.reindex(protocols["protocol"])  # NaN interrupts the line
        ends = curve[["accuracy", "accuracy_low", "accuracy_high"]] / 100
        ends = ends.set_axis(["accuracy", "low", "high"], axis=1)
        level = np.arange(len(protocols)) + 0.05 * (i - (len(systems) - 1) / 2)
        lines.append((i, system, ends.assign(level=level)))
    figure = draw_curves("", lines, title=title, inches=1.5 * len(protocols))
    ticks = []
    for row in protocols.itertuples():
        people = "subjects mixed" if row.mixes_subjects else "new subjects"
        ticks.append(f"{row.key}\n{'optimistic' if 'optimistic' in row.protocol else people}")
    figure.axes[0].set_xticks(range(len(ticks)), ticks)
    return figure


def ledger_exhibits(results: Sequence[Result], beside: pd.DataFrame, folder: Path) -> list[Exhibit]:
    """The section of the page; empty without captures that have runs under two protocols or more.

    Args:
        results: runs on captures.
        beside: published numbers beside ours (`bench.reports.papers.compare_with_published`).
        folder: folder for figures.
    """
    exhibits = []
    for i, runs in enumerate(runs_by_captures(results), 1):
        accuracies, (data, subset, _) = accuracies_by_protocol(runs), runs[0].context
        words = data + f", {subset}" * (subset != "all")
        rows = _ledger_rows(accuracies)
        exhibits.append(_protocols_exhibit(rows, words, folder, i, few_subjects_notes(runs)))
        if commands := missing_commands(runs):
            table = Table(
                [Measure("command", form=CODE)], [{"command": command} for command in commands]
            )
            exhibits.append(Exhibit(HEADING, table=table, caption=f"{words}: not run yet."))
        numbers = explain_published(runs[0]["data"], accuracies)
        if len(numbers) and runs[0]["synthetic"] != "true":
            caption = (
                "published numbers and the points over LOSO of their protocol for our systems."
            )
            table = Table(PUBLISHED_COLUMNS, rows_of_frame(numbers))
            sentences = spread_sentences(numbers, beside, runs[0]["data"])
            exhibits.append(Exhibit(HEADING, None, table, f"{words}: {caption}", sentences))
    return exhibits


def _protocols_exhibit(
    rows: pd.DataFrame, words: str, folder: Path, number: int, notes: list[str]
) -> Exhibit:
    """Figure, table and sentences on the ledger's rows of one set of captures."""
    count = rows["protocol"].nunique()
    under_all = rows[rows.groupby("system")["key"].transform("size") == count]
    best = under_all.loc[under_all.groupby("protocol", sort=False)["accuracy"].idxmax()]
    sentences = render_sentences(
        *("bench.reports", "sentences", "ledger"),
        best=dict(zip(best["key"], best["system"], strict=True)),
        systems=under_all["system"].nunique(),
        windows=rows["key"].str.startswith("windows").any(),
    )
    caption = f"{words}: accuracy under each protocol, mean over subjects"
    caption += " with 95 % t-intervals" * bool(rows["accuracy_low"].notna().any())
    figure = draw_slopes(rows, words)
    picture = save_figure(figure, folder, f"0-protocols-{number}", words, f"{caption}.")
    most_accurate = rows["system"].unique()[: max(1, ROWS // count)]  # under one protocol
    shown = rows[rows["system"].isin(most_accurate)].sort_values("system", kind="stable")
    footnotes = [footnotes_of_system(row.system, row.data) for row in shown.itertuples()]
    table = Table(COLUMNS, rows_of_frame(shown), remarks=footnotes, groups=[*shown["system"]])
    caption = f"{words}: systems under each protocol; "
    caption += "points are paired over the subjects of both protocols."
    caption += " protocols.csv has all systems." * (len(shown) < len(rows))
    return Exhibit(HEADING, picture, table, caption, [*sentences, *notes], SUMMARY)
