"""Numbers of a group of runs for the script of the page, which sorts, filters, compares and downloads them.

All is text as tables show it, but for the accuracies of subjects and the correctly classified captures, from which the
script computes the paired test of two systems. It is compressed, as browsers can unpack it.
"""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from bench import scores
from bench.columns import run_columns
from bench.measures import Measure, costs, percent, three
from bench.reports.comparison import SAME, published, views
from bench.reports.summary import Summary, family
from bench.result import Result, seed_number

ELSEWHERE = {"accuracy", "difference", "p_holm"}  # columns of runs that the table of systems has otherwise
LABELS = 500_000  # captures of all systems that the page has room for


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
    numbers = {key: list(part.itertuples()) for key, part in published().groupby(SAME)}
    seeds = {system: [next(views(r, numbers)) for r in each] for system, each in runs.items()}
    rows = []
    for row in table.rows:
        about = _mean(seeds[row["system"]]) if row["plain"] and row["system"] in runs else {}
        rows.append({**about, "subject_sd": among.subjects.loc[row["id"]].std() / 100, **row})
    texts = replace(table, columns=kept, rows=rows).texts
    below, labelled = [_of_seed(m) for m in kept if m.name in texts[0]], _labels(summary, runs)
    shown = {m.name for m in table.columns}
    cheap = {summary.column(name).name for name in summary.costs if costs()[name].better == "low"}
    lines = []
    for i, (row, cells) in enumerate(zip(rows, texts, strict=True)):
        each = seeds.get(row["system"], []) if row["plain"] else []
        line = {"name": row["name"], "family": family(models[row["system"]]), "chosen": i in table.bold}
        line |= {"marks": table.lines[i]["marks"], "cells": [*cells.values()]}
        line |= {"bar": [round(end, 1) for end in table.bars[i]]}
        line |= {"seeds": [[m.of(one) for m in below] for one in each] if len(each) > 1 else []}
        line |= {"scores": [None if v != v else round(v, 8) for v in among.subjects.loc[row["id"]]]}
        lines.append(line | {"hits": labelled["hits"].get(row["system"], "") if row["plain"] else ""})
    heads = [{"name": m.name, "key": m.key, "shown": m.name in shown} for m in kept if m.name in texts[0]]
    heads = [head | {"up": m.left or m.name in cheap} for head, m in zip(heads, below, strict=True)]
    data = {"key": summary.key, "people": [*map(str, among.subjects)], "columns": heads, "rows": lines}
    data |= {name: labelled[name] for name in ("gestures", "captures", "true")}
    return b64encode(gzip.compress(json.dumps(data, separators=(",", ":")).encode(), mtime=0)).decode()


def _of_seed(measure: Measure) -> Measure:
    """The column in the row of one seed; places, differences and tests are of means over seeds."""
    if measure.key == "system":
        return replace(measure, read=lambda row: f"seed {row['seed']}")
    if measure.key == "accuracy":
        return percent(measure.key, measure.heading, ends=measure.ends)
    if measure.key in ("rank", "difference", "test"):
        return replace(measure, read=lambda row: None)
    return replace(costs()[measure.key], heading=measure.name, form=three) if measure.key in costs() else measure


def _mean(seeds: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means of the numbers of some seeds, and texts that they share."""
    table = pd.DataFrame(seeds)
    numbers = table.select_dtypes("number")
    same = {name: table[name].iloc[0] for name in table if name not in numbers and table[name].nunique() == 1}
    return {**numbers.mean().to_dict(), **same}


def _labels(summary: Summary, runs: Mapping[str, Sequence[Result]]) -> dict[str, Any]:
    """True gestures of the captures, and which of them the lowest seed of each system labels correctly."""
    found: dict[str, Any] = {"gestures": [], "captures": [], "true": []}
    hits: dict[str, str] = {}
    for system in [s for s in summary.subjects.index if s in runs]:
        if len(found["captures"]) * (len(hits) + 1) > LABELS:
            break
        predictions = runs[system][0].tables.get("predictions")
        if predictions is None:
            continue
        table = scores.captures(predictions).drop_duplicates("capture").sort_values("capture")
        captures = [int(i) for i in table["capture"]]
        if not hits:
            classes = scores.classes_of(predictions)
            found = {"gestures": classes, "captures": captures, "true": [classes.index(name) for name in table["true"]]}
        if captures == found["captures"]:
            hits[system] = "".join("01"[int(hit)] for hit in table["true"] == table["predicted"])
    return {**found, "hits": hits}
