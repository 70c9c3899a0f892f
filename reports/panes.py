"""What the page shows first of each group of runs: the answer, a chart of each cost, and all systems by accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from bench import few
from bench.comparable import MIXED, notes_on
from bench.measures import Measure, costs, known, text, three
from bench.outcomes.choice import named
from bench.outcomes.statistics import interval
from bench.reports.candidates import Answer, Considered
from bench.reports.figures import Picture
from bench.reports.run_groups import Group
from bench.result import Result
from bench.table import Table, rows_of

COSTS = 3  # of the answer and of the table; the chart has all
SENTENCES = 2  # of the answer; the others are closed


class Chart(NamedTuple):
    """The chart of a cost, and the name of the cost."""

    label: str
    picture: Picture


@dataclass(frozen=True)
class Pane:
    """A group of runs on the page.

    Attributes:
        label: protocol, or captures and protocol where these differ between groups.
        about: words on whether the tested people are new.
        answer: the choice.
        table: its systems, most accurate first; None without candidates.
        charts: a chart for each cost.
    """

    label: str
    about: str
    answer: Answer
    table: Table | None = None
    charts: list[Chart] = field(default_factory=list)

    @property
    def chosen(self) -> dict[str, str]:
        """The chosen system: ``name``, ``accuracy``, ``interval`` and ``costs``; empty if none is."""
        answer = self.answer
        if not isinstance(answer, Considered) or answer.choice.chosen is None:
            return {}
        row, people = (t.loc[answer.choice.chosen] for t in (answer.choice.table, answer.among.subjects))
        low, high = np.clip(interval(people.to_numpy(float)), 0, 100)
        n, amounts = len(people), {costs()[name]: row[name] for name in leading(answer)}
        return {
            "name": named(row),
            "accuracy": f"{row['accuracy']:.1f} %",
            "interval": few.too_few(n) if np.isnan(low) else f"95 % CI {low:.1f} to {high:.1f}, {n} subjects",
            "costs": ", ".join(f"{cost.amount(a)} {cost.words}" for cost, a in amounts.items() if known(a) is not None),
        }

    @property
    def sentences(self) -> list[str]:
        """The reason of the choice."""
        lines = self.answer.lines[1 : 1 + SENTENCES]
        return [*lines, MIXED] if MIXED in self.answer.lines and MIXED not in lines else lines

    @property
    def more(self) -> list[str]:
        """All that is known of the choice besides."""
        return [line for line in self.answer.lines[1:] if line not in self.sentences]


def leading(answer: Considered) -> list[str]:
    """The costs that the answer and the table have: those with a budget, then the first ones."""
    return sorted(answer.costs, key=lambda name: name not in answer.budgets)[:COSTS]


def labels(groups: Mapping[str, Sequence[Result]]) -> list[str]:
    """The names of tabs: protocols, if these tell the groups apart; else the groups."""
    protocols = [results[0].context[2] for results in groups.values()]
    alike = len({results[0].context[:2] for results in groups.values()}) == 1 and len({*protocols}) == len(protocols)
    return protocols if alike else [*groups]


def systems(answer: Considered, group: Group, data: str) -> Table:
    """The systems on whole captures, and the chosen candidate, most accurate first.

    ``difference`` is the accuracy less that of the compared system, in points, and ``test`` says where the test of the
    statistics does not show one.

    Args:
        answer: candidates of a group.
        group: its statistics.
        data: name of the corpus, for footnotes.
    """
    table, chosen = answer.choice.table, answer.choice.chosen
    table = table[(table["unit"] == "capture") | (table.index == chosen)]
    table = table.sort_values("accuracy", ascending=False, kind="stable")
    ends = np.array([interval(row) for row in answer.among.subjects.loc[table.index].to_numpy(float)]).clip(0, 100)
    least = group.subjects.loc[group.base].mean()
    plain = (table["unit"] == "capture").tolist()
    p_of = dict(zip(group.rows["system"], group.rows["p_holm"], strict=True))
    rows = [
        row
        | {
            "name": named(row) + " (chosen)" * (i == chosen),
            "accuracy_low": low,
            "accuracy_high": high,
            "difference": np.nan if is_plain and row["system"] == group.base else row["accuracy"] - least,
            "test": _test(row["system"], p_of, group) if is_plain else "not tested",
        }
        for i, row, (low, high), is_plain in zip(table.index, rows_of(table), ends, plain, strict=True)
    ]
    measures = [
        text("name", "system"),
        Measure("accuracy", "accuracy % [95 %]", ends="accuracy"),
        Measure("difference", form="+.1f"),
        text("test"),
        *(
            Measure(name, costs()[name].heading or f"{name} {costs()[name].unit}".strip(), form=three)
            for name in leading(answer)
        ),
    ]
    bold = np.flatnonzero(table.index == chosen).tolist()
    remarks = [notes_on(str(row["system"]), data) for row in rows]
    return Table(measures, rows, bold=bold, remarks=remarks, drawn="accuracy")


def _test(system: str, p_of: Mapping[str, float], group: Group) -> str:
    """A word where the difference of a system from the compared one is not shown; empty where it is."""
    if system == group.base:
        return ""
    if group.few:
        return "too few subjects"
    p = known(p_of.get(system))
    return "not tested" if p is None else "not significant" * (p >= 0.05)
