"""Tables of stored runs: scores beside published numbers; command, versions and machine of each."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import pandas as pd

from bench.grammar.help import define_classifiers
from bench.reading import statistics
from bench.reading.frame import accuracy_by_subject, name_rows
from bench.reports.notes import busy_machine_notes
from bench.values import few, scores
from bench.values.columns import run_columns, unit_headings
from bench.values.intervals import mean_interval
from bench.values.measures import Cost, Measure, Row, text_measure, value_or_none
from bench.values.result import Result, footnotes_of_system, seed_number
from bench.values.table import Table, rows_of_frame, text_table

SETTING = ["data", "subset", "target", "protocol"]  # of a published number and of a run
# Prefix of metrics: what a row labels, how its windows are combined, and the units of published
# numbers beside it.
VARIANTS = {
    "": ("capture", "mean probability", ("capture", "subject mean")),
    "vote_": ("capture", "majority vote", ("capture vote",)),
    "window_": ("window", "", ("window", "window macro precision", "window macro recall")),
}
UNITS = unit_headings(m for m in run_columns("csv") if not isinstance(m, Cost))  # of comparison.csv
UNITS |= {end: f"{end} %" for end in ("low", "high")}
CONTEXT = ["data", "subset", "protocol", "group"]
TESTED = ("difference", "p_holm")
UNIT_WORDS = {"capture": "whole captures", "window": "single windows"}  # in headings
ON_PAGE = [replace(m, heading=f"{m.name} [95 %]") if m.ends else m for m in run_columns("page")]
ROWS = 60  # of a table on the page; the CSV files have all
MACHINE = ("git", "cpu", "threads")
Tests = tuple[pd.DataFrame, pd.DataFrame]  # accuracies of subjects, and statistics of the systems


@cache
def load_published() -> pd.DataFrame:
    """Load the numbers of the papers, a row each; columns ``*_key`` have the words of runs."""
    with (files("bench.reports") / "published.csv").open() as file:
        table = pd.read_csv(file, dtype={"system": str}, keep_default_na=True)
    return table.fillna({"system": "", "nearest_key": ""})


def setting_of_run(result: Result) -> tuple[str, ...]:
    """Data, subset, target and protocol of a run, as in the columns ``*_key`` of papers."""
    return tuple(str(result[name]) for name in SETTING)


def setting_of_paper(paper: Any) -> tuple[str, ...]:
    """The same of a row of `load_published`."""
    return (paper.data, paper.subset_key, paper.target_key, paper.protocol_key)


def score_rows(
    groups: Mapping[str, Sequence[Result]],
    against: str = "",
    tests: Mapping[str, Tests] | None = None,
    numbers: pd.DataFrame | None = None,
) -> list[Row]:
    """A row per run and variant of its score, best first within each set of comparable rows.

    ``difference`` and ``p_holm`` compare the system with ``against``, or with the best of its
    group; a system on windows is compared by mean probability of its captures. ``tests`` has those
    of groups that are already computed. ``published`` are ``numbers``, or those of the papers.
    """
    rows: list[dict[str, Any]] = []
    papers: dict[tuple, list] = {}  # by setting and system
    for paper in (load_published() if numbers is None else numbers).itertuples():
        papers.setdefault((*setting_of_paper(paper), paper.system), []).append(paper)
    for group, results in groups.items():
        differences = _differences_of_systems(results, against, (tests or {}).get(group))
        context = dict(zip(CONTEXT, (*results[0].context, group), strict=True))
        for name, r in zip(name_rows(results), results, strict=True):
            for variant in score_variants(r):
                row = {**variant, **context, "name": name}
                row["published"] = _published_words(r, row, papers)
                if row["combined"] != "majority vote" and row["unit"] == "capture":
                    row |= differences.get(r.system, {})
                rows.append(row)
    best: dict[tuple, float] = {}
    for row in rows:
        key = (*row_context(row), row["system"])
        best[key] = max(best.get(key, 0), row["accuracy"])

    def order(row: Row) -> tuple:
        context, system = row_context(row), row["system"]
        return *context, -best[*context, system], system, seed_number(row["seed"])

    return sorted(rows, key=order)


def protocol_precedence(results: Sequence[Result]) -> tuple[bool, bool, int]:
    """The place of a protocol beside others on the same captures: new persons first.

    Protocols without a draw and declared splits precede random ones; then come those that test
    most subjects.
    """
    is_mixed = any(r.mixes_subjects for r in results)
    is_drawn = any("protocol.seed" in r and r["official_split"] != "true" for r in results)
    return is_mixed, is_drawn, -int(max(r.get("subjects", 0) for r in results))


def average_seeds(rows: Sequence[Row], results: Sequence[Result]) -> list[Row]:
    """Average the seeds of each system in rows of `score_rows`, best first in each table.

    ``accuracy``, its interval and ``subject_sd`` are over subjects, of the mean over seeds of each.
    ``seeds`` is their number, ``seed_sd`` the SD over them, ``result`` a run of ``results``. A run
    with failed folds keeps its row.
    """
    runs = {r["run_id"]: r for r in results}
    systems: dict[tuple, list[Row]] = {}
    for row in rows:
        run = runs[row["run_id"]]
        part = "" if run.is_complete else row["run_id"]
        key = (*row_context(row), row["system"], row["combined"], part)
        systems.setdefault(key, []).append({**row, "result": run})
    averaged = [_average_rows(each) for each in systems.values()]
    return sorted(averaged, key=lambda row: (*row_context(row), -row["accuracy"]))


def _average_rows(rows: Sequence[Row]) -> Row:
    """One row for the seeds of a system."""
    if len(rows) == 1:
        return {**rows[0], "seeds": 1}
    mean, seeds = mean_of_rows(rows), [row["accuracy"] for row in rows]
    mean |= {"name": mean["system"], "result": rows[0]["result"]}
    people = pd.DataFrame(map(_accuracies_of_row, rows)).mean() / 100
    low, high = np.clip(mean_interval(people.to_numpy()), 0, 1)
    mean |= {"accuracy_low": low, "accuracy_high": high, "subject_sd": people.std(ddof=1)}
    return mean | {"seeds": len(rows), "seed_sd": pd.Series(seeds).std(ddof=1)}


def _accuracies_of_row(row: Row) -> dict[str, float]:
    """Accuracy on each subject in percent, in the unit of a row."""
    prefix = _prefix_of_row(row)
    if not prefix:
        return row["result"].accuracy_by_subject
    labelled = scores.label_by_prefix(row["result"].tables["predictions"], prefix)
    people = scores.accuracy_by_subject(labelled)
    return dict(zip(people["subject"], 100 * people["accuracy"], strict=True))


def _prefix_of_row(row: Row) -> str:
    """The prefix of the scores of a row, by which `VARIANTS` lists it."""
    of_unit = (row["unit"], row.get("combined") or "")
    return next((p for p, (*unit, _) in VARIANTS.items() if of_unit == (*unit,)), "")


def mean_of_rows(rows: Sequence[Row]) -> dict[str, Any]:
    """Means of the numbers of some rows, and texts that they share."""
    means = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [value for row in rows if (value := value_or_none(row.get(name))) is not None]
        if values and all(isinstance(value, int | float) for value in values):
            means[name] = sum(values) / len(values)
        elif len({*values}) == 1:
            means[name] = values[0]
    return means


def row_context(row: Row) -> tuple[str, ...]:
    """The values that rows of one table share."""
    return tuple(row[name] for name in (*CONTEXT, "unit"))


def comparison_table(rows: Sequence[Row]) -> pd.DataFrame:
    """The rows of `score_rows` for a CSV file: accuracies, SDs and F1 in percent.

    ``accuracy`` is the mean over subjects with its t-interval, ``pooled_accuracy`` is over
    captures.
    """
    columns = [text_measure("name"), text_measure("system")]
    for measure in run_columns("csv"):
        stored = isinstance(measure, Cost) and measure.source_name
        columns.append(Measure(measure.source_name) if stored else measure)
    table = Table(columns, rows).to_frame()
    table = table.rename(columns={"accuracy_low": "low", "accuracy_high": "high"})
    first = ["name", "system", "accuracy", "low", "high"]
    table = table.reindex(columns=[*dict.fromkeys([*first, *table])])
    return table.astype(dict.fromkeys(TESTED, float))  # also where nothing is tested


def _differences_of_systems(
    results: Sequence[Result], against: str, tests: Tests | None
) -> dict[str, dict[str, object]]:
    """Difference of each system from the compared one and its test; empty if there are too few."""
    if tests is None:
        subjects = accuracy_by_subject([r for r in results if r.predicts_alone])[0]
        rows = None
    else:
        subjects, rows = tests
    if len(subjects) < 2 or subjects.shape[1] < 2:
        return {}
    if rows is None:
        compared = statistics.compared_systems(subjects, against)
        rows = statistics.compare_with_base(compared, against=against)
    base = {"against": statistics.base_system(subjects, against)}
    return {
        str(row["system"]): {name: row[name] for name in TESTED} | base
        for row in rows_of_frame(rows)
    }


def score_variants(result: Result) -> Iterator[Row]:
    """The scores of a run: of its captures, by mean probability or vote, and of its windows.

    Yields:
        The numbers of the run, those of the unit without their prefix.
    """
    windowed = result.get("windows", 0) > 0
    for prefix, (unit, combined, _) in VARIANTS.items():
        if f"{prefix}accuracy" not in result:
            continue
        of_unit = {
            k.removeprefix(prefix): v for k, v in result.metrics.items() if k.startswith(prefix)
        }
        yield {
            **result.metrics,
            **of_unit,
            "system": result.system,
            "full_name": result.full_name,
            "unit": unit,
            "combined": (windowed and combined) or None,
            "seed": result["seed"],
            "folds": result.folds,
            "run_id": result["run_id"],
            "note": " ".join(footnotes_of_system(result.system, str(result["data"]))),
        }


def _published_words(result: Result, row: Row, papers: Mapping[tuple, Sequence[Any]]) -> str | None:
    """Published numbers of the system in the unit of a row, each with unit and id; None without.

    Systems that depend on the batch or use conditions have none: their marked names match no
    published system.
    """
    if result["synthetic"] == "true":
        return None
    *_, units = VARIANTS[_prefix_of_row(row)]
    if row["combined"] is None:  # one decision a capture is its vote
        units = (*units, "capture vote")
    of_system = [
        paper
        for name in dict.fromkeys([result.full_name, result.system])
        for paper in papers.get((*setting_of_run(result), name), [])
    ]
    words = [f"{p.accuracy:g} ({p.unit_key}, {p.id})" for p in of_system if p.unit_key in units]
    return "; ".join(words) or None


def runs_section(rows: Sequence[Row], order: list[str]) -> dict[str, Any]:
    """All runs and units for which the page has room, and the groups with few subjects."""
    rows = sorted(rows, key=lambda row: order.index(row["group"]))
    headings = pd.Series([f"{row['group']}, {UNIT_WORDS[row['unit']]}" for row in rows])
    each = max(1, ROWS // headings.nunique()) if len(rows) > ROWS else len(rows)
    headings = headings.groupby(headings, sort=False).head(each)
    shown = [rows[i] for i in headings.index]
    footnotes = [
        footnotes_of_system(row["system"], str(row["data"]))
        + short_name_notes(row)
        + busy_machine_notes(row)
        for row in shown
    ]
    columns = [text_measure("name", "system"), *ON_PAGE]
    subjects = {row["group"]: int(row["subjects"]) for row in rows[::-1]}
    few_subjects = [
        group
        for group in order
        if subjects.get(group, few.FEWEST_FOR_INTERVAL) < few.FEWEST_FOR_INTERVAL
    ]
    return {
        "table": Table(columns, shown, remarks=footnotes, groups=[*headings]),
        "few": [f"{group}. {few.too_few_sentence(subjects[group])}" for group in few_subjects],
        "definitions": define_classifiers(row["full_name"] for row in shown),
        "all": len(rows),
        "each": each,
    }


def short_name_notes(row: Row) -> list[str]:
    """A footnote on the short name of a system, if it has one."""
    full_name = row.get("full_name", row["system"])
    return [f"{row['system']}: {full_name}"] * (full_name != row["system"])


def command_line(result: Result) -> str:
    """The command line that makes a run, as it was tracked; ``-`` for a run of Python objects."""
    arguments = result.get("touchbench.arguments")
    if arguments is None:
        return "-"
    words = [f"{key}={value}" for key, value in json.loads(arguments).items()]
    return shlex.join(["bench", result["touchbench.command"], *words])


def provenance_table(groups: Mapping[str, Sequence[Result]]) -> pd.DataFrame:
    """Origin of each run, oldest first: its name, command, corpus, revision, machine and id."""
    runs = [(group, r) for group, results in groups.items() for r in results]
    rows = []
    for group, r in sorted(runs, key=lambda run: run[1]["started"]):
        git, cpu, threads = (r.get(name) or "-" for name in MACHINE)
        rows.append(
            {
                "group": group,
                "system": r.system,
                "seed": r["seed"],
                "command": command_line(r),
                "corpus digest": r["corpus_digest"][:16],
                "git": git,
                "CPU, threads": f"{cpu}, {threads}",
                "run": r["run_id"],
            }
        )
    return pd.DataFrame(rows)


def software_versions(results: Sequence[Result]) -> pd.DataFrame:
    """Versions that the runs were made with, the most frequent first."""
    begin = "version."
    table = pd.DataFrame([dict(r.attributes) for r in results]).filter(regex=rf"^{begin}")
    counts = table.fillna("-")[sorted(table)].value_counts().reset_index(name="runs")
    return counts.rename(columns=lambda name: name.removeprefix(begin))


def provenance_section(results: Sequence[Result], table: pd.DataFrame) -> dict[str, Any]:
    """Corpora, versions, and the command of every run."""
    counts = Counter((r.context[0], str(r["corpus_digest"])) for r in results)
    rows = [(data, digest, str(count)) for (data, digest), count in sorted(counts.items())]
    return {
        "corpora": text_table(pd.DataFrame(rows, columns=("data", "corpus_digest", "runs"))),
        "versions": text_table(software_versions(results).astype(str)),
        "commands": text_table(table.iloc[:ROWS], code=("command",)),
        "all": len(table),
    }
