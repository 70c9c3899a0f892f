"""The choice of ``bench choose``, and its candidates as marks of the page's chart."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bench.candidate import Losses, Wish
from bench.comparable import COMPARABLE, notes_on
from bench.errors import InputError
from bench.measures import costs, costs_of
from bench.outcomes import statistics
from bench.outcomes.candidates import PLAIN, Candidates, candidates
from bench.outcomes.choice import Choice, decide, expectation, expected, named, reasons
from bench.pareto import staircase
from bench.registry import circumstance_views
from bench.reports.speed import LOOKS
from bench.result import Result
from bench.scene_file import EVERY
from bench.table import rows_of
from bench.words import typed

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
        losses: faults over which losses are taken.
    """

    choice: Choice = field(kw_only=True)
    among: Candidates = field(kw_only=True)
    budgets: Mapping[str, float] = field(kw_only=True)
    losses: Losses | None = field(kw_only=True)

    @property
    def costs(self) -> list[str]:
        """Costs that are known of a candidate, or have a budget; a tenth of ten people is the worst person."""
        table = self.choice.table
        shared = costs_of(recordings=False)
        known = {name for name in shared if (table[name].notna() if shared[name].linear else table[name] > 0).any()}
        if table["worst_tenth"].equals(table["worst_person"]):
            known -= {"worst_tenth"}
        return [name for name in shared if name in known | {*self.budgets}]


def considered(
    group: str,
    results: Sequence[Result],
    every: Sequence[Result],
    budgets: Mapping[str, float],
) -> Answer:
    """The choice among the systems of a group, or the reason why there is none.

    Args:
        group: captures and protocol in words.
        results: results of the group.
        every: results of all kinds.
        budgets: budget of each cost.
    """
    first = results[0]
    lossy = [c for c in circumstance_views() if any(cost.losses for cost in c.costs)]
    lost = any(c.holds(r) for r in every for c in lossy) or any(costs()[name].losses for name in budgets)
    losses = Losses(EVERY) if lost else None
    try:
        asked = {name: [first[name]] for name in COMPARABLE}
        among = candidates(every, asked, Wish(PLAIN, budgets.get("decision")), losses=losses)
    except InputError as e:
        return Answer(group, [f"Nothing can be chosen here: {e}."])
    choice = decide(among.table, among.subjects, BY, dict(budgets), None)
    others = expected(among, choice.chosen, BY, budgets, None)
    lines = reasons(choice, BY, None, among.subjects.shape[1], among.mixed)
    lines += [*expectation(others, among, choice.chosen), *among.notes]
    systems = among.table["system"].unique()
    lines += dict.fromkeys(note for system in systems for note in notes_on(str(system), str(first["data"])))
    if len(systems) == 1:
        lines.insert(1, f"Only {systems[0]} has a run here, so there is no other system to compare.")
    words = _command(among.table, first, every)
    limits = [costs()[name].argument(value) for name, value in budgets.items()]
    command = " ".join([words, *limits]) if words else ""
    return Considered(group, lines, command, choice=choice, among=among, budgets=budgets, losses=losses)


def _command(table: pd.DataFrame, first: Result, results: Sequence[Result]) -> str:
    """The command that chooses among the candidates of a group; empty where its words mean other runs, too."""
    # Of the first candidate whose run was typed; those made from Python with objects have none.
    arguments = next((json.loads(text) for text in table["arguments"] if text), {})
    protocol = {k: v for k, v in arguments.items() if k.split(".")[0] == "protocol"}
    named_by = ["data", "subset", "target", "protocol_name", *(k for k in protocol if "." in k)]
    same = [r for r in results if all(r.get(name) == first.get(name) for name in named_by)]
    if not arguments or len({tuple(str(r.get(name)) for name in (*COMPARABLE, "protocol")) for r in same}) > 1:
        return ""
    target = {"target": first["target"]} if first["target"] != "gesture" else {}
    return typed("choose", {"data": arguments["data"], "where": first["subset"]} | target | protocol)


def marks(answer: Considered, models: Mapping[str, str], published: Collection[str]) -> pd.DataFrame:
    """The candidates that the chart draws: ``name``, ``kind``, ``verdict``, ``chosen``, ``out``, and their numbers.

    ``kind`` is the mark of a candidate where it has one, such as ``C``, else ``published``, ``changed`` (a
    published system with other parameters) or ``other``.
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
        row["mark"]
        if row["mark"] in LOOKS
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
    best = {i for name in costs_of(recordings=False) for i in table.index[staircase(accuracy, _burden(table, name))]}
    best |= {choice.chosen, *table.sort_values("accuracy", ascending=False).index[:MOST]}
    return table[table.index.isin(best)]


def _burden(table: pd.DataFrame, name: str) -> np.ndarray:
    return costs()[name].burden(table[name].to_numpy(dtype=float))
