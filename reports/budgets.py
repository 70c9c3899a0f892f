"""The choice for every budget of each cost, as a table of the page and a CSV file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.outcomes.candidates import Candidates, candidates
from bench.outcomes.choice import ALL_COSTS, NOUNS, amount, named
from bench.outcomes.comparable import COMPARABLE
from bench.outcomes.runs import rows_of
from bench.outcomes.steps import steps
from bench.outcomes.store import Store
from reports.candidates import BY, Considered
from reports.layout import Table
from reports.numbers import number

COLUMNS = ["group", "cost", "unit", "least", "choice", "accuracy", BY]
NOTHING = "nothing fits"


def by_budget(store: Store, answers: list[Considered], runs_of: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """A row for each step of the choice, by group and cost; groups with a single candidate have none.

    Args:
        store: store of the runs.
        answers: candidates of each group.
        runs_of: `bench.outcomes.runs.tracked` by kind.
    """
    found = []
    for answer in answers:
        for cost in answer.costs if len(answer.among.table) > 1 else []:
            among = _replayed(store, answer, runs_of) if cost == "decision" and "stream" in runs_of else answer.among
            rows = rows_of(among.table.round({"accuracy": 9}))  # as bench choose prints it
            replays = [
                str(runs[0]["run_id"]) if row["kind"] == "stream" else ""
                for runs, row in zip(among.runs, rows, strict=True)
            ]
            for least, i in steps(among.people, BY, cost, answer.budgets, replays):
                choice = (named(rows[i]), rows[i]["accuracy"], rows[i][BY]) if i >= 0 else (NOTHING, np.nan, np.nan)
                found.append((answer.title, cost, ALL_COSTS[cost], least, *choice))
    return pd.DataFrame(found, columns=COLUMNS)


def _replayed(store: Store, answer: Considered, runs_of: Mapping[str, pd.DataFrame]) -> Candidates:
    """The candidates of an answer and every instant of each replay; without these if their tables are missing."""
    asked = {name: [answer.among.first[name]] for name in COMPARABLE}
    try:
        return candidates(store, asked, np.inf, faults=answer.faults, runs_of=runs_of)
    except InputError:
        return answer.among


def budget_tables(table: pd.DataFrame) -> list[tuple[str, Table]]:
    """Each group and its steps as text.

    Args:
        table: table of `by_budget`.
    """
    made = []
    for group, rows in table.groupby("group", sort=False):
        text = {
            "budget": [f"from {amount(r.cost, r.least)} on" for r in rows.itertuples()],
            "choice": rows["choice"],
            "accuracy %": rows["accuracy"].map(number),
            NOUNS[BY]: [amount(BY, v) for v in rows[BY]],
        }
        made.append((str(group), Table(pd.DataFrame(text), groups=[NOUNS[cost] for cost in rows["cost"]])))
    return made
