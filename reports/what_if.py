"""The data of the page's what-if panels: a browser makes the choice again for other budgets and reactions."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd

from bench.costs import COSTS, ROBUST
from bench.outcomes.candidates import Candidates, candidates
from bench.outcomes.choice import ALL_COSTS, NOUNS, UNKNOWN, WORDS, named
from bench.comparable import COMPARABLE, Row
from bench.outcomes.reactions import mean_probabilities
from bench.outcomes.runs import NothingTracked, needed, rows_of
from bench.outcomes.store import Store
from reports.candidates import BY, Considered, drawn

MOST_TEXT = 1_500_000  # characters of probabilities on a page


def panels(
    store: Store, answers: list[Considered], runs_of: Mapping[str, pd.DataFrame], most: int = MOST_TEXT
) -> dict[str, dict[str, Any]]:
    """The panel of each answer with several candidates by its title, as plain values for ``whatif.js``.

    Args:
        store: store of the runs.
        answers: candidates of each group.
        runs_of: `bench.outcomes.runs.tracked` by kind.
        most: largest number of characters of probabilities on the page. Reactions cannot be changed in a group whose
            probabilities need more than is left.
    """
    made = {}
    for answer in answers:
        if len(answer.among.table) > 1:
            made[answer.title] = panel = _panel(store, answer, runs_of, most)
            most -= sum(len(text) for row in panel["rows"] for _, text in row["tables"])
    return made


def _panel(store: Store, answer: Considered, runs_of: Mapping[str, pd.DataFrame], most: int) -> dict[str, Any]:
    """The costs and scores of all candidates, and probabilities of those that the chart draws."""
    costs = [c for c in COSTS | ROBUST if c in {BY, *answer.costs}]
    subjects, kept = answer.among.subjects.columns, {*drawn(answer.choice).index}
    classes: list[str] = []
    captures: dict[tuple[int, ...], int] = {}
    rows, size, note = [], 0, ""
    for among, i, row in _ways(store, answer, runs_of):
        replay, tables = row["kind"] == "stream", []
        for run in among.runs[i] if i in kept and not replay and size <= most else []:
            classes, capture, text = _packed(pd.read_parquet(needed(store, run, "predictions.parquet")), subjects)
            tables.append([captures.setdefault(capture, len(captures)), text])
            size += len(text)
        rows.append(
            {
                "name": named(row),
                "costs": _numbers(row[c] for c in costs),
                "scores": _numbers(among.subjects.reindex(columns=subjects).to_numpy()[i]),
                "replay": f"{row['system']} {among.runs[i][0]['stream.hop_ms']}" if replay else None,
                "tables": tables,
            }
        )
    if size > most:
        classes, captures, rows = [], {}, [row | {"tables": []} for row in rows]
        note = (
            f"Reactions cannot be changed here: the probabilities of these systems need more than the {most / 1e6:.2g} "
            "MB left on this page. Give a scene to bench choose instead."
        )
    about = [{"key": c, "noun": NOUNS[c], "unit": ALL_COSTS[c], "unknown": UNKNOWN[c]} for c in costs]
    return {
        "costs": [each | {"budget": answer.budgets.get(each["key"])} for each in about],
        "words": WORDS[BY],
        "classes": classes,
        "captures": [*captures],
        "rows": rows,
        "note": note,
        "command": answer.words,
    }


def _ways(store: Store, answer: Considered, runs_of: Mapping[str, pd.DataFrame]) -> list[tuple[Candidates, int, Row]]:
    """Candidates, with every instant of a replay among them, in the order of `candidates`."""
    every = answer.among
    ways = [(every, i, row) for i, row in enumerate(rows_of(every.table)) if row["kind"] != "stream"]
    if "stream" in runs_of:
        kinds = {kind: runs_of[kind] for kind in ("stream", "chip") if kind in runs_of}
        with suppress(NothingTracked):
            every = candidates(store, {name: [every.first[name]] for name in COMPARABLE}, np.inf, runs_of=kinds)
            ways += [(every, i, row) for i, row in enumerate(rows_of(every.table)) if row["kind"] == "stream"]
    return sorted(ways, key=lambda way: (way[2]["system"], way[2]["kind"]))


def _packed(predictions: pd.DataFrame, subjects: pd.Index) -> tuple[list[str], tuple[int, ...], str]:
    """Classes, subject and class of each capture as one number, and mean probabilities in base64, not rounded."""
    about, mean = (each.sort_index() for each in mean_probabilities(predictions))
    classes = sorted(map(str, mean.columns))
    values = mean[classes].to_numpy()
    values = np.ascontiguousarray(values, "<f4" if values.dtype == np.float32 else "<f8")
    subject = subjects.get_indexer(pd.Index(about["subject"].astype(str)))
    capture = subject * len(classes) + pd.Index(classes).get_indexer(pd.Index(about["true"]))
    return classes, tuple(capture.tolist()), base64.b64encode(values.tobytes()).decode()


def _numbers(values: Iterable[float]) -> list[float | None]:
    """Numbers with all their digits, None for unknown ones."""
    return [float(v) if np.isfinite(v) else None for v in values]
