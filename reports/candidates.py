"""The choice of ``bench choose``, and its candidates as marks of the page's chart."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bench.arguments import typed
from bench.costs import COSTS, ROBUST
from bench.errors import InputError
from bench.outcomes import statistics
from bench.outcomes.candidates import STRESS, Candidates, Faults, candidates
from bench.outcomes.choice import Choice, decide, named, sentences
from bench.outcomes.comparable import COMPARABLE, Row
from bench.outcomes.expected import expectation, expected
from bench.outcomes.runs import rows_of
from bench.outcomes.store import Store
from bench.scene_file import EVERY
from reports.speed import front

BY = "flash"  # the cost that is to be low, unless bench choose is told another
MOST = 40  # candidates that the chart draws, besides those of a front


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


def marks(answer: Considered, models: Mapping[str, str], published: Collection[str]) -> pd.DataFrame:
    """The candidates that the chart draws: ``name``, ``kind``, ``verdict``, ``chosen``, ``out``, and their numbers.

    ``kind`` is ``published``, ``changed`` (a published system with other parameters), ``chip`` (in C) or ``other``.
    ``out`` is True for candidates that a budget rules out. The numbers are ``accuracy`` with its interval (``low``,
    ``high``), and a column for each cost.

    Args:
        answer: candidates of a group.
        models: name of the model of each system.
        published: systems with published numbers.
    """
    rows = drawn(answer.choice)
    subjects = answer.among.subjects.loc[rows.index].to_numpy(dtype=float)
    bounds = np.array([statistics.interval(row) for row in subjects]).clip(0, 100)
    kinds = [
        "chip"
        if row["kind"] == "chip"
        else "published"
        if row["system"] in published
        else "changed"
        if models[row["system"]] in published
        else "other"
        for row in rows_of(rows)
    ]
    made = {"name": [named(row) for row in rows_of(rows)], "kind": kinds, "verdict": rows["verdict"]}
    made |= {"chosen": rows.index == answer.choice.chosen, "out": rows["verdict"].str.startswith("ruled out")}
    made |= {"accuracy": rows["accuracy"], "low": bounds[:, 0], "high": bounds[:, 1]}
    return pd.DataFrame(made | {cost: rows[cost] for cost in answer.costs}, index=rows.index)


def drawn(choice: Choice) -> pd.DataFrame:
    """The most accurate candidates, with all that are on a front or chosen."""
    table = choice.table
    accuracy = table["accuracy"].to_numpy()
    best = {i for c in COSTS | ROBUST for i in table.index[front(table[c].to_numpy(dtype=float), accuracy)]}
    best |= {choice.chosen, *table.sort_values("accuracy", ascending=False).index[:MOST]}
    return table[table.index.isin(best)]
