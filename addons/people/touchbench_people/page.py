"""Report section on captures of a new person, from ``protocol=personal`` and ``transfer``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bench.reports.notes import few_subjects_notes
from bench.reports.sections import Exhibit
from bench.values.intervals import mean_interval
from bench.values.measures import Measure, Row, text_measure
from bench.values.result import Result, footnotes_of_system
from bench.values.sentences import render_sentences
from bench.values.table import Table, rows_of_frame

UNLABELLED = "no labels"  # in place of shots: half of the person's captures, without labels
COMPARED_KEYS = (
    *("data", "corpus_digest", "subset", "target", "protocol_name"),
    *("protocol.source", "protocol.classes", "protocol.seed"),
)
DRAW_KEYS = ("protocol.draws", "protocol.weight")  # of runs with shots
HEADING = "People"
GAIN = Measure("gain", form="+.1f", ends="gain")
COLUMNS = (
    text_measure("system"),
    text_measure("known", "shots"),
    Measure("accuracy", ends="accuracy"),
    GAIN,
    text_measure("worse"),
)
CAPTION = (
    "{}: accuracy in percent, mean over people with its 95 % t-interval, for each number of shots. "
    "gain: paired difference to no shots, in points. worse: subjects with lower accuracy, and "
    "their loss in points."
)
# Name of a set of comparable runs, and the curve of each system.
Curves = tuple[str, dict[str, pd.DataFrame]]


class NewPerson:
    """View of runs of these protocols."""

    key = "people"

    def applies_to(self, result: Result) -> bool:
        """True if a run is of one of these protocols."""
        return "protocol.shots" in result

    def make_exhibits(self, results: Sequence[Result], folder: Path) -> list[Exhibit]:
        """Make a table for each set of comparable runs."""
        exhibits = []
        for context, curves in comparable_curves(results):
            rows: list[Row] = []
            for system, curve in curves.items():
                renamed = curve.rename(columns={"low": "accuracy_low", "high": "accuracy_high"})
                rows += [row | {"system": system} for row in rows_of_frame(renamed)]
            data = context.split(",")[0]
            remarks = [footnotes_of_system(str(row["system"]), data) for row in rows]
            table, caption = Table(COLUMNS, rows, remarks=remarks), CAPTION.format(context)
            notes, summary = few_subjects_notes(results), gain_sentence(results)
            exhibits.append(Exhibit(HEADING, None, table, caption, notes, summary))
        return exhibits

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Return no table: this section has no CSV file."""
        return {}


def comparable_curves(results: Sequence[Result]) -> list[Curves]:
    """Curves of each set of comparable results; systems with two calibrations, best first."""
    personal = [r for r in results if r["protocol_name"] in ("personal", "transfer")]
    curves = []
    for part in group_comparable_results([r for r in personal if r.is_complete]):
        by_system: dict[str, list[Result]] = {}
        for r in part:
            by_system.setdefault(r.system, []).append(r)
        of_systems = {system: accuracy_curve(members) for system, members in by_system.items()}
        systems = [system for system, curve in of_systems.items() if len(curve) > 1]
        systems.sort(key=lambda system: -of_systems[system]["accuracy"].max())
        if systems:
            curves.append((_context_words(part[-1]), {name: of_systems[name] for name in systems}))
    return curves


def _context_words(result: Result) -> str:
    """Captures and protocol of a result, in words."""
    data, subset, _ = result.context
    context = data if subset == "all" else f"{data}, {subset}"
    context += ", a new person"
    if result["protocol_name"] == "transfer":
        context += f" on another skin than {result['protocol.source']}"
    if result["protocol.shots"] != "0":
        context += f", {result['protocol.draws']} draws"
    return context


def gain_sentence(results: Sequence[Result]) -> str:
    """Sentence on the gain of the most accurate system from captures of a person, or ""."""
    for context, by_system in comparable_curves(results):
        system, curve = next(iter(by_system.items()))
        row = curve[curve["known"] != UNLABELLED].iloc[-1]
        if np.isfinite(row.get("gain", np.nan)):
            values = {"context": context, "known": row["known"], "system": system}
            values["gain"] = GAIN.as_text(row)
            return render_sentences("touchbench_people", "people", "gained", **values)[0]
    return ""


def group_comparable_results(results: Sequence[Result]) -> list[list[Result]]:
    """Group results on the same captures with shots drawn alike, after results without shots."""
    groups = []
    for part in _group_by(results, COMPARED_KEYS):
        without = [r for r in part if r["protocol.shots"] == "0"]
        with_shots = _group_by([r for r in part if r["protocol.shots"] != "0"], DRAW_KEYS)
        groups += [without + members for members in with_shots] or [part]
    return groups


def _group_by(results: Sequence[Result], names: Sequence[str]) -> list[list[Result]]:
    groups: dict[tuple, list[Result]] = {}
    for r in results:
        groups.setdefault(tuple(str(r.get(name)) for name in names), []).append(r)
    return list(groups.values())


def accuracy_curve(results: Sequence[Result]) -> pd.DataFrame:
    """A row per calibration of a system, seeds averaged: accuracy and gain, and who loses."""
    newest: dict[tuple[str, str], Result] = {}
    for r in results:
        known = UNLABELLED if r["protocol.unlabelled"] == "True" else str(int(r["protocol.shots"]))
        newest.pop((known, r["seed"]), None)  # the last one is the newest
        newest[known, r["seed"]] = r
    by_known: dict[str, list[pd.Series]] = {}
    for (known, _), r in newest.items():
        accuracies = pd.Series(r.accuracy_by_subject, dtype=float)
        if len(accuracies):  # otherwise its table is no longer in the store
            by_known.setdefault(known, []).append(accuracies)
    means = {known: pd.concat(part, axis=1).mean(axis=1) for known, part in by_known.items()}
    by_subject = pd.DataFrame(means).dropna()
    rows = []
    columns = by_subject.columns if len(by_subject) else []
    for known in sorted(columns, key=lambda name: 0.5 if name == UNLABELLED else float(name)):
        low, high = mean_interval(by_subject[known].to_numpy())
        row = {"known": known, "accuracy": by_subject[known].mean(), "low": low, "high": high}
        if "0" in by_subject and known != "0":
            gain = by_subject[known] - by_subject["0"]
            low, high = mean_interval(gain.to_numpy())
            row |= {"gain": gain.mean(), "gain_low": low, "gain_high": high}
            worse = gain[gain < 0].sort_values()
            losses = [f"{subject} ({points:.1f})" for subject, points in worse.items()]
            row["worse"] = ", ".join(losses) or "nobody"
        rows.append(row)
    return pd.DataFrame(rows)
