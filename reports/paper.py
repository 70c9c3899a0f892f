"""The table of a paper: systems as rows, protocols side by side; `bench.reports.latex` writes it as LaTeX."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import mean
from typing import Any

import pandas as pd

from bench.comparable import MARK, MIXED, MIXED_MARK, facts_of, notes_on
from bench.errors import InputError, nearest
from bench.measures import Measure, percent, run_columns, text
from bench.outcomes.runs import by_subject
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table

SCORES = ("accuracy", "macro_f1")  # columns under each protocol
COSTS = {"fit": "fit_seconds", "predict": "predict_ms_p50", "flash": "flash"}  # columns of `run_columns`, of a system


@dataclass(frozen=True)
class Paper:
    """The systems on one corpus, subset and target.

    Attributes:
        data: corpus and subset in words.
        table: a row per system, the most accurate under the first protocol first; protocols for new people come first.
        best: for each column, the row of its most accurate system; None for columns without one.
        notes: sentences on what the numbers are.
    """

    data: tuple[str, str]
    table: Table
    best: list[int | None]
    notes: list[str]


def columns_of(value: object) -> list[str]:
    """The columns that ``paper=`` names: those of `SCORES` and `COSTS`.

    Raises:
        InputError: there is no such column, or no score is among them.
    """
    asked = [str(name) for name in (value.split(",") if isinstance(value, str) else value)]  # type: ignore[attr-defined]
    known = [*SCORES, *COSTS]
    for name in asked:
        if name not in known:
            raise InputError(f"paper={name}: {nearest(name, known)}")
    if not {*SCORES} & {*asked}:
        raise InputError(f"paper={','.join(asked)} has no score; add accuracy or macro_f1")
    return [name for name in known if name in asked]


def papers(runs: Sequence[Result], asked: Sequence[str]) -> list[Paper]:
    """A table for each corpus, subset and target: means over people of complete results; seeds are averaged.

    Args:
        runs: results on captures, one for each system, seed, captures and protocol.
        asked: columns, from `columns_of`.
    """
    corpora: dict[tuple[str, str, str], dict[str, list[Result]]] = {}
    for r in (r for r in runs if r.complete):
        data, subset, protocol = r.context
        corpora.setdefault((data, subset, str(r["corpus_digest"])), {}).setdefault(protocol, []).append(r)
    made = []
    for (data, subset, digest), protocols in corpora.items():
        several = len([key for key in corpora if key[:2] == (data, subset)]) > 1
        made.append(_paper((data + f" (corpus {digest[:8]})" * several, subset), protocols, asked))
    return made


def _paper(data: tuple[str, str], protocols: Mapping[str, list[Result]], asked: Sequence[str]) -> Paper:
    """The table of results on the same captures, by protocol."""
    people = {name: by_subject(results)[0] for name, results in protocols.items()}
    mixed = {name for name, results in protocols.items() if any(facts_of(r).mixes_subjects for r in results)}
    first, *others = sorted(protocols, key=lambda name: (name in mixed, -people[name].shape[1], name))
    brief = {name: re.split(r"[,(]", name)[0].strip() for name in protocols}
    heads = brief if len({*brief.values()}) == len(brief) else {name: name for name in protocols}
    heads = {name: head + f" {MIXED_MARK}" * (name in mixed) for name, head in heads.items()}
    costs = [measure for measure in run_columns() if measure.key in [COSTS[name] for name in asked if name in COSTS]]
    rows: dict[str, dict[str, Any]] = {}
    columns: list[Measure] = []
    best: list[int | None] = []
    for name in (first, *others):
        for system, scores in people[name].iterrows():
            seeds = [r for r in protocols[name] if r.system == system]
            row = rows.setdefault(str(system), {"system": str(system)})
            row |= {f"{heads[name]}: accuracy": scores.mean(), f"{heads[name]}: SD": scores.std(ddof=1)}
            row |= {f"{heads[name]}: macro_f1": mean(r["macro_f1"] for r in seeds)}
            if name == first:
                for key in (str(cost.read or cost.key) for cost in costs):
                    row[key] = mean(r.get(key, float("nan")) for r in seeds)
    table = [*rows.values()]  # by accuracy, as `by_subject` has them
    for words in (heads[name] for name in (first, *others)):
        compared = {i: row[f"{words}: accuracy"] for i, row in enumerate(table) if f"{words}: accuracy" in row}
        compared = {i: accuracy for i, accuracy in compared.items() if not table[i]["system"].endswith(MARK)}
        if "accuracy" in asked:
            keys = (f"{words}: accuracy", f"{words}: SD")
            columns.append(Measure(keys[0], words, keys, join=" ± "))
            best.append(max(compared, key=compared.__getitem__) if len(compared) > 1 else None)
        if "macro_f1" in asked:
            columns.append(percent(f"{words}: macro_f1", f"{words}, macro-F1"))
            best.append(None)
    notes = sentences(
        *("bench.reports", "sentences", "paper_notes"),
        synthetic="(synthetic)" in data[0],
        protocols=[first, *others],
        asked=asked,
        costs=heads[first] if costs else "",
        mixed=f"{MIXED_MARK} {MIXED}" if mixed else "",
        notes=[*dict.fromkeys(note.rstrip(".") for row in table for note in notes_on(row["system"], data[0]))],
    )
    return Paper(data, Table([text("system"), *columns, *costs], table), [None, *best, *([None] * len(costs))], notes)


def sheet(made: Sequence[Paper]) -> pd.DataFrame:
    """The numbers of all tables, for a CSV file."""
    parts = []
    for paper in made:
        mixed = [note for note in paper.notes if note.startswith(MIXED_MARK)]
        notes = [" ".join([*mixed, *notes_on(row["system"], paper.data[0])]) for row in paper.table.rows]
        parts.append(paper.table.frame().assign(data=paper.data[0], subset=paper.data[1], note=notes))
    every = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
    head = ["data", "subset", "system"]
    return every.reindex(columns=[*head, *every.columns.difference([*head, "note"], sort=False), "note"])
