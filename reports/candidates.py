"""The choice of ``bench choose``, and every candidate as a mark of the page's chart."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bench.arguments import typed
from bench.costs import COSTS, ROBUST
from bench.errors import InputError
from bench.outcomes import statistics
from bench.outcomes.candidates import STRESS, Candidates, Faults, candidates
from bench.outcomes.choice import Choice, decide, named, sentences
from bench.comparable import COMPARABLE, Row
from bench.outcomes.expected import expectation, expected
from bench.outcomes.store import Store
from bench.scene_file import EVERY
from reports.speed import front

BY = "flash"  # the cost that is to be low, unless bench choose is told another
MOST = 40  # candidates that the chart draws, besides those of a front
WORDS = {
    "flash": "kB of flash (learnt and stored numbers; in C, linked code)",
    "ram": "kB of RAM during one decision",
    "predict": "ms to compute a label (p50, one thread)",
    "decision": "ms of touch before the label",
    "cycles": "thousand instructions of the costliest frame in C",
    "fault_loss": "points lost under faults (mean of all faults and severities)",
    "worst_fault": "points lost under the worst fault",
    "worst_person": "% of captures wrong for the worst person",
    "worst_tenth": "% of captures wrong for the worst tenth of people",
}


@dataclass(frozen=True)
class Answer:
    """The verdict of the page: a sentence, its reasons, and the command that gives the same; empty without one."""

    title: str
    lines: list[str]
    command: str = ""


@dataclass(frozen=True)
class Considered(Answer):
    """An answer with the candidates of a group of runs.

    Attributes:
        choice: result of `bench.outcomes.choice.decide`.
        among: candidates.
        budgets: the most of each cost.
        faults: circumstances over which losses are taken.
    """

    choice: Choice = field(kw_only=True)
    among: Candidates = field(kw_only=True)
    budgets: Mapping[str, float] = field(kw_only=True)
    faults: Faults | None = field(kw_only=True)

    @property
    def costs(self) -> list[str]:
        """Costs that are known of a candidate, or have a budget; a tenth of ten people is the worst person."""
        table = self.choice.table
        known = {c for c in COSTS if (table[c] > 0).any()} | {c for c in ROBUST if table[c].notna().any()}
        if table["worst_tenth"].equals(table["worst_person"]):
            known -= {"worst_tenth"}
        return [c for c in COSTS | ROBUST if c in known | {*self.budgets}]


def considered(
    store: Store,
    group: str,
    runs: pd.DataFrame,
    budgets: Mapping[str, float],
    runs_of: Mapping[str, pd.DataFrame] | None = None,
) -> Answer:
    """The choice among the systems of a group, or the reason why there is none.

    Args:
        store: store of the runs.
        group: description of the group.
        runs: all that are tracked, as `bench.outcomes.runs.with_groups` makes them.
        budgets: the most of each cost, in the units of `bench.costs.COSTS`.
        runs_of: `bench.outcomes.runs.tracked` by kind, if already read.
    """
    first = runs[runs["group"] == group].iloc[0].to_dict()
    stressed = STRESS in (runs_of or {}) or any("fault" in cost for cost in budgets)
    faults = Faults(EVERY) if stressed else None
    try:
        asked = {name: [first[name]] for name in COMPARABLE}
        every = candidates(store, asked, budgets.get("decision"), faults=faults, runs_of=runs_of)
    except InputError as e:
        return Answer(group, [f"Nothing can be chosen here: {e}."])
    choice = decide(every.table, every.subjects, BY, dict(budgets), None)
    one = None if choice.chosen is None else expected(every.people, choice.chosen, BY, dict(budgets), None)
    lines = sentences(choice, BY, None, every.subjects.shape[1], every.mixed)
    lines += [*expectation(one, every, choice.chosen), *every.notes]
    systems = every.table["system"].unique()
    if len(systems) == 1:
        lines.insert(0, f"Only {systems[0]} has a run here, so there is no other system to compare.")
    words = _command(every.table, first, runs)
    command = " ".join([words, *(f"max_{k}={v:g}{COSTS.get(k, '')}" for k, v in budgets.items())]) if words else ""
    return Considered(group, lines, command, choice=choice, among=every, budgets=budgets, faults=faults)


def _command(table: pd.DataFrame, first: Row, runs: pd.DataFrame) -> str:
    """The command that chooses among the candidates of a group; empty where its words mean other runs, too."""
    # Of the first candidate whose run was typed; those made from Python with objects have none.
    arguments = next((json.loads(text) for text in table["arguments"] if text), {})
    protocol = {k: v for k, v in arguments.items() if k.split(".")[0] == "protocol"}
    named_by = ["data", "subset", "target", "protocol_name", *(k for k in protocol if "." in k)]
    same = runs[(runs[named_by] == pd.Series({k: first[k] for k in named_by})).all(axis=1)]
    if not arguments or len(same[[*COMPARABLE, "protocol"]].drop_duplicates()) > 1:
        return ""
    words = {"data": arguments["data"], "where": first["subset"], "target": first["target"]}
    return typed("choose", words | protocol)


def chart_data(answers: list[Considered], models: Mapping[str, str], papers: pd.DataFrame) -> dict[str, object]:
    """The data of the page's interactive chart, as plain values.

    Args:
        answers: the candidates of each group.
        models: name of the model of each system.
        papers: `reports.comparison.published`, to mark published systems.
    """
    published = set(papers["system"]) - {""}
    costs = [c for c in COSTS | ROBUST if any(c in each.costs for each in answers)]
    groups = []
    for each in answers:
        kept = drawn(each.choice)
        points = []
        for i, row in zip(kept.index, kept.to_dict("records"), strict=True):
            system = row["system"]
            kind = "published" if system in published else "changed" if models[system] in published else "other"
            low, high = statistics.interval(each.among.subjects.loc[i].to_numpy(dtype=float))
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
        groups.append({"name": each.title, "budgets": budgets, "left": left, "points": points})
    return {"costs": [WORDS[c] for c in costs], "linear": [c in ROBUST for c in costs], "groups": groups}


def drawn(choice: Choice) -> pd.DataFrame:
    """The most accurate candidates, with all that are on a front or chosen."""
    table = choice.table
    accuracy = table["accuracy"].to_numpy()
    best = {i for c in COSTS | ROBUST for i in table.index[front(table[c].to_numpy(dtype=float), accuracy)]}
    best |= {choice.chosen, *table.sort_values("accuracy", ascending=False).index[:MOST]}
    return table[table.index.isin(best)]


def _number(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None
