"""Numbers of a group of runs for the script of the page, which sorts, filters and compares them.

All is text as tables show it, except accuracies of subjects, correctly classified captures and
tests of pairs. The numbers are stored by columns and compressed; browsers can unpack them.
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

from bench.reports.comparison import mean_of_rows, score_variants
from bench.reports.sections import runs_of_systems
from bench.reports.summary import Summary, cost_column, model_family
from bench.values import scores
from bench.values.columns import run_columns
from bench.values.measures import (
    Measure,
    all_costs,
    format_three_digits,
    percent_measure,
    value_or_none,
)
from bench.values.result import Result
from bench.values.table import Table

# Columns of runs that the table of systems computes in another way.
REPLACED = {"accuracy", "difference", "p_holm"}
LABELS = 500_000  # captures of all systems that the page has room for
DIGITS = 5  # of percent; the script ignores differences below 1e-4


def page_data(summary: Summary, models: Mapping[str, str]) -> str:
    """The table of a group with all measures, seeds, subjects, captures; empty without a table."""
    if summary.table is None or summary.choice is None:
        return ""
    table, subjects = summary.table, summary.choice.candidates.subjects
    runs = runs_of_systems(summary.results)
    seed_rows = {system: [next(score_variants(r)) for r in each] for system, each in runs.items()}
    rows, seeds = [], []
    for row in table.rows:
        of_system = seed_rows.get(row["system"], []) if row["tested"] else []
        spread = {"subject_sd": subjects.loc[row["id"]].std() / 100}
        rows.append({**mean_of_rows(of_system), **spread, **row})
        seeds.append(of_system if len(of_system) > 1 else [])
    columns = _all_columns(summary, table)
    texts = replace(table, columns=columns, rows=rows).texts
    columns = [measure for measure in columns if measure.name in texts[0]]
    seed_columns = [_seed_measure(measure) for measure in columns]
    seed_texts = [
        [measure.as_text(row) for measure in seed_columns]
        for of_system in seeds
        for row in of_system
    ]
    labels = _capture_labels(summary, runs)
    accuracies = subjects.loc[[row["id"] for row in rows]].round(DIGITS)
    data = {
        "key": summary.key,
        "people": [*map(str, subjects)],
        "columns": _describe_columns(summary, columns, {m.name for m in table.columns}),
        "gestures": labels["gestures"],
        "captures": labels["captures"],
        "true": labels["true"],
        "name": [row["name"] for row in rows],
        "family": [model_family(models[row["system"]]) for row in rows],
        "chosen": [*table.bold],
        "marks": [line["marks"] for line in table.template_rows],
        "cells": _columns_of_rows(row.values() for row in texts),
        "seeds": _columns_of_rows(seed_texts),
        "counts": [*map(len, seeds)],
        "scores": [_without_nan(accuracies[person]) for person in accuracies],
        "hits": [labels["hits"].get(row["system"], "") if row["tested"] else "" for row in rows],
        "pairs": _pairs(summary, rows),
    }
    text = json.dumps(data, separators=(",", ":"))
    return b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _all_columns(summary: Summary, table: Table) -> list[Measure]:
    """The columns of the table, then all other costs and measures of runs."""
    costs = [cost_column(name) for name in summary.costs if name not in summary.leading_costs]
    others = [m for m in run_columns("page") if m.key not in {*REPLACED, *summary.costs}]
    system = replace(table.columns[0], source="name")
    by_name: dict[str, Measure] = {}
    for measure in (system, *table.columns[1:], *costs, *others):
        by_name.setdefault(measure.name, measure)
    return [*by_name.values()]


def _describe_columns(
    summary: Summary, columns: Sequence[Measure], shown: set[str]
) -> list[dict[str, Any]]:
    """Name and key of each column, whether it is shown at first and sorts upwards."""
    cheap = {cost_column(name).name for name in summary.costs if all_costs()[name].better == "low"}
    return [
        {"name": m.name, "key": m.key, "shown": m.name in shown, "up": m.is_text or m.name in cheap}
        for m in columns
    ]


def _pairs(summary: Summary, rows: Sequence[Mapping[str, Any]]) -> list[list[float | None]]:
    """Tests of systems: numbers of two rows, ends of the interval of their difference, p."""
    place = {row["system"]: i for i, row in enumerate(rows) if row["tested"]}
    pairs = []
    for row in summary.pairs.itertuples():
        if row.system in place and row.other in place:
            numbers = _without_nan([row.low, row.high, row.p])
            pairs.append([place[row.system], place[row.other], *numbers])
    return pairs


def _without_nan(values: Iterable[float]) -> list[float | None]:
    """Numbers with None for NaN, which JSON does not have."""
    return [value_or_none(value) for value in values]


def _columns_of_rows(rows: Iterable[Iterable[str]]) -> list[tuple[str, ...]]:
    """Columns of some rows: numbers of one kind together compress better."""
    return [*zip(*rows, strict=True)]


def _seed_measure(measure: Measure) -> Measure:
    """The column in the row of one seed; ranks, differences and tests are of means over seeds."""
    if measure.key == "system":
        return replace(measure, source=lambda row: f"seed {row['seed']}")
    if measure.key == "accuracy":
        return percent_measure(measure.key, measure.heading, ends=measure.ends)
    if measure.key in ("rank", "difference", "test"):
        return replace(measure, source=lambda row: None)
    if measure.key in all_costs():
        cost = all_costs()[measure.key]
        return replace(cost, heading=measure.name, form=format_three_digits)
    return measure


def _capture_labels(summary: Summary, runs: Mapping[str, Sequence[Result]]) -> dict[str, Any]:
    """True gestures of the captures, and which the lowest seed of each system labels correctly."""
    classes: list[str] = []
    captures = true = np.array([])
    hits: dict[str, str] = {}
    for system in [s for s in summary.subjects.index if s in runs]:
        if len(captures) * (len(hits) + 1) > LABELS:
            break
        tables = runs[system][0].tables
        names = ["capture", *(scores.PREFIX + name for name in classes)]
        columns = tables.read_columns("predictions", names)
        if columns is None:
            continue
        order, *proba = columns
        if hits and len(np.unique(order)) == len(order):  # one prediction a capture: most systems
            labels = scores.most_probable_labels(np.column_stack(proba), classes)
            labels, order = labels[np.argsort(order)], np.sort(order)
        else:
            predictions = tables["predictions"]
            table = scores.label_captures(predictions).drop_duplicates("capture")
            table = table.sort_values("capture")
            order, labels = table["capture"].to_numpy(), table["predicted"].to_numpy()
        if not hits:
            classes = scores.classes_of(predictions)
            captures, true = order, table["true"].to_numpy()
        if np.array_equal(order, captures):
            hits[system] = "".join(np.where(labels == true, "1", "0"))
    return {
        "gestures": classes,
        "captures": np.diff(captures, prepend=0).tolist(),  # compresses better than the numbers
        "true": pd.Index(classes).get_indexer(pd.Index(true)).tolist(),
        "hits": hits,
    }
