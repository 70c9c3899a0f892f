"""The choice for every budget of each cost, as a table of the page and a CSV file."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

import numpy as np
import pandas as pd

from bench.candidate import EARLY, Wish
from bench.comparable import COMPARABLE
from bench.errors import InputError
from bench.measures import Measure, Row, costs, known, text
from bench.outcomes.candidates import PLAIN, Candidates, candidates
from bench.outcomes.choice import named
from bench.outcomes.steps import steps
from bench.reports.candidates import BY, Considered
from bench.result import Result
from bench.table import Table, rows_of

COLUMNS = ["group", "cost", "unit", "least", "choice", "accuracy", BY]
NOTHING = "nothing fits"


def by_budget(answers: Sequence[Considered], results: Sequence[Result]) -> pd.DataFrame:
    """A row for each step of the choice, by group and cost; groups with a single candidate have none.

    Args:
        answers: candidates of each group.
        results: results of all kinds.
    """
    found = []
    for answer in answers:
        for cost in answer.costs if len(answer.among.table) > 1 else []:
            among = _at_any_time(answer, results) if cost == "decision" else answer.among
            rows = rows_of(among.table.round({"accuracy": 9}))  # as bench choose prints it
            replays = [
                str(runs[0]["run_id"]) if row["mark"] == EARLY else ""
                for runs, row in zip(among.runs, rows, strict=True)
            ]
            for least, i in steps(among.people, BY, cost, answer.budgets, replays):
                choice = (named(rows[i]), rows[i]["accuracy"], rows[i][BY]) if i >= 0 else (NOTHING, np.nan, np.nan)
                found.append((answer.title, cost, costs()[cost].unit, least, *choice))
    return pd.DataFrame(found, columns=COLUMNS)


def _at_any_time(answer: Considered, results: Sequence[Result]) -> Candidates:
    """The candidates of an answer and every instant of each replay; without these if their tables are missing."""
    asked = {name: [answer.among.first[name]] for name in COMPARABLE}
    try:
        return candidates(results, asked, Wish(PLAIN, np.inf), losses=answer.losses)
    except InputError:
        return answer.among


def budget_tables(table: pd.DataFrame) -> list[tuple[str, Table]]:
    """Each group and its steps.

    Args:
        table: table of `by_budget`.
    """
    by = costs()[BY]
    table = table.assign(looser=table.groupby(["group", "cost"], sort=False)["least"].shift(-1))
    columns = [
        text("budget", read=_reach),
        text("choice"),
        Measure("accuracy", "accuracy %"),
        Measure(BY, by.noun, lambda row: by.amount(row[BY])),
    ]
    return [
        (
            str(group),
            Table(
                columns,
                rows_of(rows),
                groups=[costs()[name].noun for name in rows["cost"]],
                remarks=[[note] if note else [] for note in rows.get("note", [""] * len(rows))],
            ),
        )
        for group, rows in table.groupby("group", sort=False)
    ]


def _reach(row: Row) -> str:
    """The budgets of a step in words; a budget as it is printed gives the choice of its row.

    Amounts are rounded to the looser side, with as many digits as keep them apart from the next step.
    """
    cost, least, looser = costs()[row["cost"]], row["least"], known(row["looser"])
    exact = Decimal(f"{least:.12g}")  # without the noise of floats, which counts as no excess
    for digits in range(max(3, len(f"{least:.0f}")), 13):
        rounded = Context(digits, ROUND_CEILING if cost.better == "low" else ROUND_FLOOR).plus(exact)
        if looser is None or cost.burden(float(rounded)) < cost.burden(looser):
            break
    return cost.reach(f"{rounded.normalize():f} {cost.unit}".rstrip())
