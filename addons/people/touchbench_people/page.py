"""Accuracy against captures of a new person, from runs of ``protocol=personal`` and ``protocol=transfer``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bench.reports.contexts import Part, Section, scarce
from bench.values.intervals import interval
from bench.values.measures import Measure, Row, text
from bench.values.result import Result, notes_on
from bench.values.sentences import sentences
from bench.values.table import Table, rows_of

WITHOUT = "no labels"  # where half of the person's captures are known without them
SAME = (
    "data",
    "corpus_digest",
    "subset",
    "target",
    "protocol_name",
    "protocol.source",
    "protocol.classes",
)
DRAWN = ("protocol.draws", "protocol.weight")  # which matter where there are shots
PEOPLE = "People"  # heading
COLUMNS = (
    text("system"),
    text("known", "shots"),
    Measure("accuracy", ends="accuracy"),
    Measure("gain", form="+.1f", ends="gain"),
    text("worse"),
)
CAPTION = (
    "{}: accuracy in percent, mean over people with its 95 % t-interval, for each number of shots. gain: paired "
    "difference to no shots, in points. worse: subjects with lower accuracy, and their loss in points."
)
Curves = tuple[
    str, dict[str, pd.DataFrame]
]  # a set of comparable runs in words, and the curve of each system


class NewPerson:
    """What the report shows of runs of these protocols."""

    key = "people"

    def holds(self, result: Result) -> bool:
        """Whether a run is of one of them."""
        return "protocol.shots" in result

    def section(self, results: Sequence[Result], folder: Path) -> Section | None:
        """The section of the page."""
        return new_person_section(results)

    def sheets(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """No CSV file."""
        return {}


def curves_of(results: Sequence[Result]) -> list[Curves]:
    """The curves of systems with at least two calibrations, for each set of comparable results; the best first."""
    personal = [r for r in results if r["protocol_name"] in ("personal", "transfer") and r.complete]
    sets = []
    for part in comparable(personal):
        first = part[-1]
        data, subset, _ = first.context
        skin = (
            f" on another skin than {first['protocol.source']}"
            if first["protocol_name"] == "transfer"
            else ""
        )
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


def new_person_section(results: Sequence[Result]) -> Section | None:
    """A table for each set of comparable runs with captures of a new person."""
    parts = []
    for context, curves in curves_of(results):
        rows: list[Row] = []
        for system, curve in curves.items():
            named = curve.rename(columns={"low": "accuracy_low", "high": "accuracy_high"})
            rows += [row | {"system": system} for row in rows_of(named)]
        remarks = [notes_on(str(row["system"]), context.split(",")[0]) for row in rows]
        parts.append(
            Part(
                None,
                Table(COLUMNS, rows, remarks=remarks),
                CAPTION.format(context),
                scarce(results),
            )
        )
    return Section(PEOPLE, parts, gained(results)) if parts else None


def gained(results: Sequence[Result]) -> str:
    """A sentence on the gain of the most accurate system from captures of a new person; empty without any."""
    for context, by_system in curves_of(results):
        system, curve = next(iter(by_system.items()))
        row = curve[curve["known"] != WITHOUT].iloc[-1]
        if np.isfinite(row.get("gain", np.nan)):
            gain = Measure("gain", form="+.1f", ends="gain").of(row)
            told = {"context": context, "known": row["known"], "system": system, "gain": gain}
            return sentences("touchbench_people", "people", "gained", **told)[0]
    return ""


def comparable(results: Sequence[Result]) -> list[list[Result]]:
    """Results on the same captures whose shots are drawn alike, each with those without shots, which come first."""
    sets: dict[tuple, list[Result]] = {}
    for r in results:
        sets.setdefault(tuple(str(r.get(name)) for name in (*SAME, "protocol.seed")), []).append(r)
    parts = []
    for part in sets.values():
        alike: dict[tuple, list[Result]] = {}
        for r in (r for r in part if r["protocol.shots"] != "0"):
            alike.setdefault(tuple(str(r.get(name)) for name in DRAWN), []).append(r)
        without = [r for r in part if r["protocol.shots"] == "0"]
        parts += [without + members for members in alike.values()] or [part]
    return parts


def curve_of(results: Sequence[Result]) -> pd.DataFrame:
    """A row per calibration of a system, seeds averaged: accuracies of people, gains, who loses."""
    by_known: dict[str, dict[str, Result]] = {}
    for r in results:
        known = WITHOUT if r["protocol.unlabelled"] == "True" else str(int(r["protocol.shots"]))
        seeds = by_known.setdefault(known, {})
        seeds.pop(r["seed"], None)  # the newest is the last one
        seeds[r["seed"]] = r
    people: dict[str, pd.Series] = {}
    for known, newest in by_known.items():
        accuracies = [pd.Series(r.people, dtype=float) for r in newest.values()]
        if any(map(len, accuracies)):  # else its table is gone from the store
            people[known] = pd.concat(accuracies, axis=1).mean(axis=1)
    wide = pd.DataFrame(people).dropna()
    rows = []
    for known in sorted(
        wide if len(wide) else (), key=lambda known: 0.5 if known == WITHOUT else float(known)
    ):
        low, high = interval(wide[known].to_numpy())
        row: dict[str, object] = {
            "known": known,
            "accuracy": wide[known].mean(),
            "low": low,
            "high": high,
        }
        if "0" in wide and known != "0":
            gain = wide[known] - wide["0"]
            low, high = interval(gain.to_numpy())
            worse = gain[gain < 0].sort_values()
            row |= {"gain": gain.mean(), "gain_low": low, "gain_high": high}
            row |= {
                "worse": ", ".join(f"{who} ({points:.1f})" for who, points in worse.items())
                or "nobody"
            }
        rows.append(row)
    return pd.DataFrame(rows)
