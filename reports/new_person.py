"""Accuracy against captures of a new person, from runs of ``protocol=personal``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.comparable import notes_on
from bench.measures import Measure, Row, text
from bench.outcomes.runs import subject_accuracy
from bench.paired import interval
from bench.reports.contexts import scarce
from bench.reports.figures import MARKERS, bars, new_figure, save
from bench.reports.part import Part, Section
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table, rows_of

WITHOUT = "no labels"  # where half of the person's captures are known without them
SAME = ("data", "corpus_digest", "subset", "target", "protocol_name", "protocol.source", "protocol.classes")
DRAWN = ["protocol.draws", "protocol.weight"]  # which matter where there are shots
SHOWN = 5  # systems of a figure
COLUMNS = (
    text("system"),
    text("known", "shots"),
    Measure("accuracy", ends="accuracy"),
    Measure("gain", form="+.1f", ends="gain"),
    text("worse"),
    text("enough"),
)

PEOPLE = "People"  # heading
CAPTION = (
    "{}: accuracy in percent, mean over people with its 95 % t-interval, for each number of shots. gain: paired "
    "difference to no shots, in points. worse: subjects with lower accuracy, and their loss in points. enough: the "
    "fewest shots within one standard error of the best number of shots."
)
Curves = tuple[str, dict[str, pd.DataFrame]]  # a set of comparable runs in words, and the curve of each system


def curves_of(results: Sequence[Result]) -> list[Curves]:
    """The curves of systems that have at least two calibrations, for each set of comparable results; the best first.

    Args:
        results: results of ``bench run``.
    """
    personal = [r for r in results if r["protocol_name"] in ("personal", "transfer") and r.complete]
    sets = []
    for part in comparable(personal):
        first = part[-1]
        data, subset, _ = first.context
        skin = f" on another skin than {first['protocol.source']}" if first["protocol_name"] == "transfer" else ""
        draws = f", {first['protocol.draws']} draws" if first["protocol.shots"] != "0" else ""
        context = f"{data}{'' if subset == 'all' else f', {subset}'}, a new person{skin}{draws}"
        by_system: dict[str, list[Result]] = {}
        for r in part:
            by_system.setdefault(r.system, []).append(r)
        curves = {system: curve_of(members) for system, members in by_system.items()}
        long = [system for system in curves if len(curves[system]) > 1]
        if best := sorted(long, key=lambda s: -curves[s]["accuracy"].max()):
            sets.append((context, {system: curves[system] for system in best}))
    return sets


def new_person_section(results: Sequence[Result], folder: Path) -> Section | None:
    """A figure and a table for each set of comparable runs with captures of a new person.

    Args:
        results: results of these runs.
        folder: destination folder of figures.
    """
    parts = []
    for i, (context, curves) in enumerate(curves_of(results), 1):
        left = max(len(curves) - SHOWN, 0)
        (caption,) = sentences("bench.reports", "sentences", "shots", without=WITHOUT, left=left)
        figure = drawn(dict([*curves.items()][:SHOWN]), context)
        picture = save(figure, folder, f"0-newcomer-{i}", context, caption)
        parts.append(Part(picture, table_of(curves, context.split(",")[0]), CAPTION.format(context), scarce(results)))
    return Section(PEOPLE, parts) if parts else None


def gained(results: Sequence[Result]) -> tuple[str, str] | None:
    """A sentence on the gain of the most accurate system from captures of a new person."""
    for context, by_system in curves_of(results):
        system, curve = next(iter(by_system.items()))
        row = curve[curve["known"] != WITHOUT].iloc[-1]
        if np.isfinite(row.get("gain", np.nan)):
            gain = Measure("gain", form="+.1f", ends="gain").of(row)
            told = {"context": context, "known": row["known"], "system": system, "gain": gain}
            return PEOPLE, sentences("bench.reports", "sentences", "gained", **told)[0]
    return None


def comparable(results: Sequence[Result]) -> list[list[Result]]:
    """Results on the same captures whose shots are drawn alike, each with those without shots, which come first."""
    sets: dict[tuple, list[Result]] = {}
    for r in results:
        sets.setdefault(tuple(str(r.get(name)) for name in (*SAME, "protocol.seed")), []).append(r)
    parts = []
    for part in sets.values():
        alike: dict[tuple, list[Result]] = {}
        for r in part:
            if r["protocol.shots"] != "0":
                alike.setdefault(tuple(str(r.get(name)) for name in DRAWN), []).append(r)
        without = [r for r in part if r["protocol.shots"] == "0"]
        parts += [without + members for members in alike.values()] or [part]
    return parts


def curve_of(results: Sequence[Result]) -> pd.DataFrame:
    """A row per calibration of a system, seeds averaged: accuracies of people, gains, who loses.

    Args:
        results: results of one system.
    """
    by_known: dict[str, dict[str, Result]] = {}
    for r in results:
        seeds = by_known.setdefault(known_of(r), {})
        seeds.pop(r["seed"], None)  # the newest is the last one
        seeds[r["seed"]] = r
    people: dict[str, pd.Series] = {}
    for known, newest in by_known.items():
        accuracies = [pd.Series(subject_accuracy(r)) for r in newest.values()]
        if any(map(len, accuracies)):  # else its table is gone from the store
            people[known] = pd.concat(accuracies, axis=1).mean(axis=1)
    wide = pd.DataFrame(people).dropna()
    if wide.empty:
        return pd.DataFrame()
    order = sorted(wide, key=_position)
    nothing = wide["0"] if "0" in wide else None
    rows = []
    for known in order:
        low, high = interval(wide[known].to_numpy())
        row: dict[str, object] = {"known": known, "accuracy": wide[known].mean(), "low": low, "high": high}
        if nothing is not None and known != "0":
            gain = wide[known] - nothing
            low, high = interval(gain.to_numpy())
            worse = gain[gain < 0].sort_values()
            row |= {"gain": gain.mean(), "gain_low": low, "gain_high": high}
            row |= {"worse": ", ".join(f"{who} ({points:.1f})" for who, points in worse.items()) or "nobody"}
        rows.append(row)
    curve = pd.DataFrame(rows)
    curve.attrs["enough"] = enough(wide[[k for k in order if k != WITHOUT]])
    return curve


def known_of(run: Result) -> str:
    """The calibration of a run: a number of shots, or captures without labels."""
    return WITHOUT if run["protocol.unlabelled"] == "True" else str(int(run["protocol.shots"]))


def enough(people: pd.DataFrame) -> str:
    """The fewest shots whose mean loss to the best is within its standard error over people [people, shots].

    Nothing where no number of shots was run.
    """
    if people.empty:
        return ""
    best = people.mean().idxmax()
    for known in people:
        lost = people[best] - people[known]
        if lost.mean() <= lost.std(ddof=1) / np.sqrt(len(lost)):
            return str(known)
    return str(best)


def table_of(curves: dict[str, pd.DataFrame], data: str) -> Table:
    """All curves on a corpus, a row per system and calibration."""
    rows: list[Row] = []
    for system, curve in curves.items():
        for i, row in enumerate(rows_of(curve.rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))):
            rows.append(row | {"system": system, "enough": "" if i else curve.attrs["enough"]})
    return Table(COLUMNS, rows, remarks=[notes_on(str(row["system"]), data) for row in rows])


def drawn(curves: dict[str, pd.DataFrame], context: str) -> Figure:
    """Accuracy against calibration captures, a line per system; hollow marks for unlabelled ones."""
    ticks = sorted({k for curve in curves.values() for k in curve["known"]}, key=_position)
    figure, axes = new_figure((8.5, 4.2), margins=(0.7, 2.6, 0.6, 0.65))
    axis = axes[0][0]
    for i, (system, curve) in enumerate(curves.items()):
        x = np.array([ticks.index(k) for k in curve["known"]]) + 0.06 * (i - (len(curves) - 1) / 2)
        labelled, look = (curve["known"] != WITHOUT).to_numpy(), {"color": f"C{i}", "marker": MARKERS[i], "ms": 5}
        ends = bars(curve["accuracy"], curve["low"], curve["high"])
        axis.errorbar(x, curve["accuracy"], yerr=ends, fmt="none", ecolor=f"C{i}", elinewidth=1, alpha=0.5)
        axis.plot(x[labelled], curve["accuracy"][labelled], label=fill(system, 34), **look)
        axis.plot(x[~labelled], curve["accuracy"][~labelled], mfc="w", ls="", **look)
    axis.set_xticks(range(len(ticks)), ticks)
    axis.set(xlabel="labelled captures of each class of the person", ylabel="accuracy, %")
    axis.set_title(fill(context, 72))
    axis.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.01, 1))
    return figure


def _position(known: str) -> float:
    """Captures without labels stand between none and one."""
    return 0.5 if known == WITHOUT else float(known)
