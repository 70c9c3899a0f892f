"""The tables of stored runs: scores beside published numbers; command, versions and machine of each."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import pandas as pd

from bench.grammar.described import definitions
from bench.reading import statistics
from bench.reading.frame import by_subject, names
from bench.reports.contexts import busy
from bench.values import few
from bench.values.columns import run_columns, unit_headings
from bench.values.measures import Cost, Measure, Row, text
from bench.values.result import Result, notes_on, seed_number
from bench.values.table import Table, of_text, rows_of

SAME = [
    "data",
    "subset_key",
    "target_key",
    "protocol_key",
    "system",
]  # of published.csv, and without _key of a run
# Metrics' prefix: what a row labels, how its windows are combined, and the units of published numbers beside it.
SCORED = {
    "": ("capture", "mean probability", ("capture", "subject mean")),
    "vote_": ("capture", "majority vote", ("capture vote",)),
    "window_": ("window", "", ("window", "window macro precision", "window macro recall")),
}
UNITS = unit_headings(m for m in run_columns("csv") if not isinstance(m, Cost))  # of comparison.csv
UNITS |= {end: f"{end} %" for end in ("low", "high")}
CONTEXT = ["data", "subset", "protocol", "group"]
TESTED = ("difference", "p_holm")
WHOLE = {"capture": "whole captures", "window": "single windows"}  # units in headings
ON_PAGE = [replace(m, heading=f"{m.name} [95 %]") if m.ends else m for m in run_columns("page")]
ROWS = 60  # of a table on the page; the CSV files hold all
MACHINE = ("git", "cpu", "threads")
Tested = tuple[pd.DataFrame, pd.DataFrame]  # accuracies of subjects, and statistics of the systems


@cache
def published() -> pd.DataFrame:
    """The numbers of the papers, one row each; ``*_key`` columns are in the words that runs are tracked with."""
    with (files("bench.reports") / "published.csv").open() as f:
        return pd.read_csv(f, dtype={"system": str}, keep_default_na=True).fillna(
            {"system": "", "nearest_key": ""}
        )


def scored(
    groups: Mapping[str, Sequence[Result]],
    against: str = "",
    before: Mapping[str, Tested] | None = None,
) -> list[Row]:
    """A row per run and way to score it, best first within each data, subset, protocol and unit.

    ``difference`` and ``p_holm`` compare the system with ``against``, or with the best of its group; a system on
    windows with its captures by mean probability. ``before`` has accuracies of subjects and statistics of groups that
    are known before.
    """
    rows: list[Row] = []
    for group, results in groups.items():
        tests = _tests(results, against, (before or {}).get(group))
        first = dict(zip(CONTEXT, (*results[0].context, group), strict=True))
        for name, r in zip(names(results), results, strict=True):
            for row in views(r):
                tested = row["combined"] != "majority vote" and row["unit"] == "capture"
                rows.append(
                    {**row, **first, "name": name} | (tests.get(r.system, {}) if tested else {})
                )
    best: dict[tuple, float] = {}
    for row in rows:
        key = (*context_of(row), row["system"])
        best[key] = max(best.get(key, 0), row["accuracy"])
    placed = lambda row: -best[*context_of(row), row["system"]]  # noqa: E731
    return sorted(
        rows, key=lambda r: (*context_of(r), placed(r), r["system"], seed_number(r["seed"]))
    )


def context_of(row: Row) -> tuple[str, ...]:
    """What rows of one table share."""
    return tuple(row[name] for name in (*CONTEXT, "unit"))


def comparison(rows: Sequence[Row]) -> pd.DataFrame:
    """The rows of `scored` for a CSV file: accuracies, SDs and F1 in percent.

    ``accuracy`` is the mean over subjects with its t-interval, ``pooled_accuracy`` is over captures.
    """
    stored = [
        Measure(m.source) if isinstance(m, Cost) and m.source else m for m in run_columns("csv")
    ]
    table = Table([text("name"), text("system"), *stored], rows).frame()
    table = table.rename(columns={"accuracy_low": "low", "accuracy_high": "high"})
    table = table.reindex(
        columns=[*dict.fromkeys(["name", "system", "accuracy", "low", "high", *table])]
    )
    return table.astype(dict.fromkeys(TESTED, float))  # also where nothing is tested


def _tests(
    results: Sequence[Result], against: str, tested: Tested | None
) -> dict[str, dict[str, object]]:
    """By system, its difference from the compared one; empty where nothing can be compared."""
    subjects, rows = tested or (by_subject([r for r in results if r.alone])[0], None)
    if len(subjects) < 2 or subjects.shape[1] < 2:
        return {}
    if rows is None:
        rows = statistics.against_best(statistics.kept_of(subjects, against), against=against)
    against = statistics.base_of(subjects, against)
    return {
        str(row["system"]): {k: row[k] for k in TESTED} | {"against": against}
        for row in rows_of(rows)
    }


def views(result: Result) -> Iterator[Row]:
    """The ways to score a run: its captures, by mean probability or vote, and its windows.

    Yields:
        The numbers of the run, those of the unit by their plain names.
    """
    for prefix, (unit, combined, units) in SCORED.items():
        if f"{prefix}accuracy" not in result:
            continue
        windowed = result.get("windows", 0) > 0
        scored = {
            k.removeprefix(prefix): v
            for k, v in result.metrics.items()
            if prefix and k.startswith(prefix)
        }
        yield {
            **result.metrics,
            **scored,
            "system": result.system,
            "unit": unit,
            "combined": (windowed and combined) or None,
            "seed": result["seed"],
            # One decision a capture is its vote.
            "published": _published(result, units if windowed else (*units, "capture vote")),
            "folds": result.folds,
            "run_id": result["run_id"],
            "note": " ".join(notes_on(result.system, str(result["data"]))),
        }


@cache
def _numbers() -> dict[tuple, list]:
    """Published numbers by what they are of."""
    return {key: list(part.itertuples()) for key, part in published().groupby(SAME)}


def _published(result: Result, units: Sequence[str]) -> str | None:
    """Published numbers that may stand beside a row, each with its unit and id.

    Systems that depend on the batch or use conditions have none: their marked names match no published system.
    """
    if result["synthetic"] == "true":
        return None
    same = _numbers().get((*(result[k.removesuffix("_key")] for k in SAME[:-1]), result.system), [])
    return (
        "; ".join(f"{r.accuracy:g} ({r.unit_key}, {r.id})" for r in same if r.unit_key in units)
        or None
    )


def runs_section(rows: Sequence[Row], order: list[str]) -> dict[str, Any]:
    """Every tracked run and unit, as far as the page has room, and the groups with few subjects."""
    rows = sorted(rows, key=lambda row: order.index(row["group"]))
    heads = pd.Series([f"{row['group']}, {WHOLE[row['unit']]}" for row in rows])
    each = max(1, ROWS // heads.nunique()) if len(rows) > ROWS else len(rows)
    heads = heads.groupby(heads, sort=False).head(each)
    kept = [rows[i] for i in heads.index]
    remarks = [notes_on(row["system"], str(row["data"])) + busy(row) for row in kept]
    scarce = {
        row["group"]: int(row["subjects"]) for row in rows[::-1] if row["subjects"] < few.INTERVAL
    }
    return {
        "table": Table([text("name", "system"), *ON_PAGE], kept, remarks=remarks, groups=[*heads]),
        "few": [f"{group}. {few.too_few(scarce[group])}" for group in order if group in scarce],
        "definitions": definitions(row["system"] for row in kept),
        "all": len(rows),
        "each": each,
    }


def command(result: Result) -> str:
    """The command line that makes a run, as it was tracked; ``-`` for a run of Python objects."""
    arguments = result.get("touchbench.arguments")
    if arguments is None:
        return "-"
    words = [f"{key}={value}" for key, value in json.loads(arguments).items()]
    return shlex.join(["bench", result["touchbench.command"], *words])


def provenance(groups: Mapping[str, Sequence[Result]]) -> pd.DataFrame:
    """Origin of each run, a row each, oldest first: its name, command, corpus, revision, machine and MLflow id."""
    rows = []
    for group, r in sorted(
        ((g, r) for g, results in groups.items() for r in results), key=lambda p: p[1]["started"]
    ):
        git, cpu, threads = (r.get(name) or "-" for name in MACHINE)
        about = {"group": group, "system": r.system, "seed": r["seed"], "command": command(r)}
        about |= {
            "corpus digest": r["corpus_digest"][:16],
            "git": git,
            "CPU, threads": f"{cpu}, {threads}",
        }
        rows.append(about | {"run": r["run_id"]})
    return pd.DataFrame(rows)


def software(results: Sequence[Result]) -> pd.DataFrame:
    """Versions that the runs were made with, the most frequent first."""
    versions = [{k: v for k, v in r.about.items() if k.startswith("version.")} for r in results]
    table = pd.DataFrame(versions).fillna("-")
    counted = table[sorted(table)].value_counts().reset_index(name="runs")
    return counted.rename(columns=lambda c: c.removeprefix("version."))


def provenance_section(results: Sequence[Result], table: pd.DataFrame) -> dict[str, Any]:
    """Corpora, versions, and the command of every run."""
    counted = Counter((r["data"], r["synthetic"], r["corpus_digest"]) for r in results)
    rows = [
        (data + " (synthetic)" * (s == "true"), digest, n)
        for (data, s, digest), n in sorted(counted.items())
    ]
    return {
        "corpora": of_text(
            pd.DataFrame(rows, columns=("data", "corpus_digest", "runs")).astype(str)
        ),
        "versions": of_text(software(results).astype(str)),
        "commands": of_text(table.iloc[:ROWS], code=("command",)),
        "all": len(table),
    }
