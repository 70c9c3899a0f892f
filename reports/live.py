"""Numbers of a group of runs for the script of the page, which sorts, filters, compares and downloads them.

All is text as tables show it, but for the accuracies of subjects and the correctly classified captures, from which the
script computes the paired test of two systems. It stands in columns and is compressed, as browsers can unpack it.
"""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from bench.reports.comparison import views
from bench.reports.summary import Summary, family
from bench.values import scores
from bench.values.columns import run_columns
from bench.values.measures import Measure, costs, known, percent, three
from bench.values.result import Result, seed_number

ELSEWHERE = {
    "accuracy",
    "difference",
    "p_holm",
}  # columns of runs that the table of systems has otherwise
LABELS = 500_000  # captures of all systems that the page has room for
DIGITS = 5  # of percent; the script takes differences as equal that are nearer than 1e-4


def packed(summary: Summary, models: Mapping[str, str]) -> str:
    """The table of a group with all measures, seeds, subjects and captures; empty without a table."""
    table, among = summary.table, summary.among
    if table is None or among is None:
        return ""
    runs: dict[str, list[Result]] = {}
    for r in sorted(summary.results, key=lambda r: seed_number(r["seed"])):
        if r.complete and r.alone:
            runs.setdefault(r.system, []).append(r)
    others = [summary.column(name) for name in summary.costs if name not in summary.leading]
    others += [m for m in run_columns("page") if m.key not in {*ELSEWHERE, *summary.costs}]
    by_name: dict[str, Measure] = {}
    for measure in (replace(table.columns[0], read="name"), *table.columns[1:], *others):
        by_name.setdefault(measure.name, measure)
    kept = [*by_name.values()]
    seeds = {system: [next(views(r)) for r in each] for system, each in runs.items()}
    rows = []
    for row in table.rows:
        about = _mean(seeds[row["system"]]) if row["plain"] and row["system"] in runs else {}
        rows.append({**about, "subject_sd": among.subjects.loc[row["id"]].std() / 100, **row})
    texts = replace(table, columns=kept, rows=rows).texts
    below, labelled = [_of_seed(m) for m in kept if m.name in texts[0]], _labels(summary, runs)
    shown = {m.name for m in table.columns}
    cheap = {summary.column(name).name for name in summary.costs if costs()[name].better == "low"}
    each = [seeds.get(row["system"], []) if row["plain"] else [] for row in rows]
    folded = [
        [measure.of(one) for measure in below] for part in each if len(part) > 1 for one in part
    ]
    heads = [
        {"name": m.name, "key": m.key, "shown": m.name in shown} for m in kept if m.name in texts[0]
    ]
    heads = [head | {"up": m.left or m.name in cheap} for head, m in zip(heads, below, strict=True)]
    data = {"key": summary.key, "people": [*map(str, among.subjects)], "columns": heads}
    data |= {name: labelled[name] for name in ("gestures", "captures", "true")}
    data |= {
        "name": [row["name"] for row in rows],
        "family": [family(models[row["system"]]) for row in rows],
    }
    data |= {"chosen": [*table.bold], "marks": [line["marks"] for line in table.lines]}
    data |= {"cells": _turned(row.values() for row in texts), "seeds": _turned(folded)}
    data |= {"counts": [len(part) if len(part) > 1 else 0 for part in each]}
    scores = among.subjects.loc[[row["id"] for row in rows]].round(DIGITS)
    data |= {"scores": [[None if v != v else v for v in scores[person]] for person in scores]}
    data |= {
        "hits": [labelled["hits"].get(row["system"], "") if row["plain"] else "" for row in rows]
    }
    return b64encode(
        gzip.compress(json.dumps(data, separators=(",", ":")).encode(), mtime=0)
    ).decode()


def _turned(rows: Iterable[Iterable[str]]) -> list[tuple[str, ...]]:
    """Columns of some rows: numbers of one kind together take less room when compressed."""
    return [*zip(*rows, strict=True)]


def _of_seed(measure: Measure) -> Measure:
    """The column in the row of one seed; places, differences and tests are of means over seeds."""
    if measure.key == "system":
        return replace(measure, read=lambda row: f"seed {row['seed']}")
    if measure.key == "accuracy":
        return percent(measure.key, measure.heading, ends=measure.ends)
    if measure.key in ("rank", "difference", "test"):
        return replace(measure, read=lambda row: None)
    return (
        replace(costs()[measure.key], heading=measure.name, form=three)
        if measure.key in costs()
        else measure
    )


def _mean(seeds: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means of the numbers of some seeds, and texts that they share."""
    means = {}
    for name in dict.fromkeys(name for one in seeds for name in one):
        values = [value for one in seeds if (value := known(one.get(name))) is not None]
        if values and not any(isinstance(value, str) for value in values):
            means[name] = sum(values) / len(values)
        elif len({*values}) == 1:
            means[name] = values[0]
    return means


def _labels(summary: Summary, runs: Mapping[str, Sequence[Result]]) -> dict[str, Any]:
    """True gestures of the captures, and which of them the lowest seed of each system labels correctly."""
    found: dict[str, Any] = {"gestures": [], "captures": [], "true": []}
    hits: dict[str, str] = {}
    for system in [s for s in summary.subjects.index if s in runs]:
        if len(found["captures"]) * (len(hits) + 1) > LABELS:
            break
        tables, classes = runs[system][0].tables, found["gestures"]
        columns = tables.columns(
            "predictions", ["capture", *(scores.PREFIX + name for name in classes)]
        )
        if columns is None:
            continue
        captures, *proba = columns
        if hits and len(np.unique(captures)) == len(
            captures
        ):  # a prediction each, as of most systems
            labels, order = (
                scores.most_probable(np.column_stack(proba), classes),
                np.argsort(captures),
            )
            captures, labels = captures[order], labels[order]
        else:
            predictions = tables["predictions"]
            table = scores.captures(predictions).drop_duplicates("capture").sort_values("capture")
            captures, labels = (table[name].to_numpy() for name in ("capture", "predicted"))
        if not hits:
            found = {
                "gestures": scores.classes_of(predictions),
                "captures": captures,
                "true": table["true"].to_numpy(),
            }
        if np.array_equal(captures, found["captures"]):
            hits[system] = "".join(np.where(labels == found["true"], "1", "0"))
    found["true"] = pd.Index(found["gestures"]).get_indexer(pd.Index(found["true"])).tolist()
    return {**found, "captures": np.diff(found["captures"], prepend=0).tolist(), "hits": hits}
