"""Which system to take, as ``bench choose`` says it, and every candidate as a mark of the page's chart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.outcomes import statistics
from bench.outcomes.advice import compared_on, typed
from bench.outcomes.choice import SAID, Choice, amount, candidates, decide, sentences
from bench.outcomes.comparable import COMPARABLE, facts_of
from bench.outcomes.store import Store
from bench.quantities import COSTS
from reports.layout import Answer
from reports.speed import front

BY = "flash"  # the cost that is to be low, unless bench choose is told another
MOST = 40  # candidates that the chart draws, besides those of a front
WORDS = {
    "flash": "kB of flash: learnt numbers; of C all that is linked",
    "ram": "kB of RAM during one decision",
    "predict": "ms to compute a label (p50, one thread)",
    "decision": "ms until the label: touch observed and computing",
    "cycles": "thousand instructions of the costliest frame as C",
}


@dataclass(frozen=True)
class Considered:
    """The candidates of a group of runs, and what was chosen.

    Attributes:
        group: in words.
        choice: as `bench.outcomes.choice.decide` made it.
        subjects: accuracies in percent [candidates, subjects].
        budgets: the most of each cost.
        mixed: whether captures of one subject are on both sides.
    """

    group: str
    choice: Choice
    subjects: pd.DataFrame
    budgets: Mapping[str, float]
    mixed: bool

    def answer(self) -> Answer:
        """The verdict with its reasons, and the command that says the same."""
        table, choice = self.choice.table, self.choice
        lines = sentences(choice, BY, None, self.subjects.shape[1])
        if len(table) == 1:
            row = table.iloc[0]
            lines = [
                f"Only {named(row)} is tracked here: {row['accuracy']:.1f} %"
                + (f" with {BY} {amount(BY, row[BY])}" if np.isfinite(row[BY]) else "")
                + ". A choice needs another system.",
                *(lines[-len(choice.budgets) :] if choice.budgets else []),
            ]
        if self.mixed:
            lines.append("Captures of one subject are in training and test: nothing of this holds for a new person.")
        on = compared_on(table)
        asked = {f"max_{cost}": _typed(cost, most) for cost, most in self.budgets.items()}
        return Answer(self.group, lines, typed("choose", on | asked) if on else "")


def considered(store: Store, group: str, runs: pd.DataFrame, budgets: Mapping[str, float]) -> Considered | Answer:
    """What was chosen among the systems of a group, or why nothing can be.

    Args:
        store: where the runs are.
        group: in words.
        runs: of the group.
        budgets: the most of each cost, in the units of `bench.quantities.COSTS`.
    """
    first = runs.iloc[0].to_dict()
    try:
        table, _, subjects = candidates(store, {name: [first[name]] for name in COMPARABLE}, budgets.get("decision"))
    except InputError as e:
        return Answer(group, [f"Nothing can be chosen here: {e}."])
    choice = decide(table, subjects, BY, dict(budgets), None)
    return Considered(group, choice, subjects, budgets, facts_of(first).mixes_subjects)


def named(row: pd.Series | Mapping[str, object]) -> str:
    """A candidate: the system, and what it labels unless that is whole captures."""
    unit = str(row["unit"])
    return str(row["system"]) + ("" if unit == "capture" else f" ({SAID.get(unit, unit)})")


def _typed(cost: str, most: float) -> str:
    return f"{most:g}{COSTS[cost]}"


def chart_data(found: list[Considered], models: Mapping[str, str], papers: pd.DataFrame) -> dict[str, object]:
    """What the interactive chart of the page draws, as plain values.

    Args:
        found: the candidates of each group.
        models: name of the model of each system.
        papers: `reports.comparison.published`, to tell which systems are published ones.
    """
    published = set(papers["system"]) - {""}
    costs = [c for c in COSTS if any((each.choice.table[c] > 0).any() for each in found)]
    groups = []
    for each in found:
        kept = _drawn(each.choice)
        points = []
        for i, row in zip(kept.index, kept.to_dict("records"), strict=True):
            system = row["system"]
            model = models.get(system, "")
            kind = "published" if system in published else "changed" if model in published else "other"
            low, high = statistics.interval(each.subjects.loc[i].to_numpy(dtype=float))
            points.append(
                {
                    "name": named(row),
                    "kind": "chip" if row["kind"] == "chip" else kind,
                    "verdict": row["verdict"],
                    "chosen": i == each.choice.chosen,
                    "out": row["verdict"].startswith("ruled out"),
                    "y": [_number(v) for v in (row["accuracy"], max(low, 0), min(high, 100))],
                    "x": [_number(row[c]) for c in costs],
                }
            )
        budgets = [each.budgets.get(c) for c in costs]
        left = len(each.choice.table) - len(kept)
        groups.append({"name": each.group, "budgets": budgets, "left": left, "points": points})
    return {"costs": [WORDS[c] for c in costs], "groups": groups}


def _drawn(choice: Choice) -> pd.DataFrame:
    """The most accurate candidates, with all that are on a front or chosen."""
    table = choice.table
    accuracy = table["accuracy"].to_numpy()
    best = {i for c in COSTS for i in table.index[front(table[c].to_numpy(dtype=float), accuracy)]}
    best |= {choice.chosen, *table.sort_values("accuracy", ascending=False).index[:MOST]}
    return table[table.index.isin(best)]


def _number(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None
