"""The table of other budgets against ``bench choose`` with each of them."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from bench.amounts import UNITS
from bench.arguments import parse
from bench.commands.choose import chosen
from bench.measures import Cost, costs
from bench.options import keys
from bench.outcomes.choice import named
from bench.reports.budgets import NOTHING, budget_tables, by_budget
from bench.reports.candidates import considered
from tests.reports.store import keep
from tests.results import HAART, evaluated, made_up, streamed

LABEL = {"protocol_label": "LOSO (8 subjects)"}


def replayed(system):
    """A result of ``bench stream`` with three instants, of which the second is the best."""
    numbers = {"replay_ms_p50": 1.0, "flash_bytes": 1500.0, "ram_bytes": 900.0}
    table = pd.concat([made_up(8, skill=s, seed=i).assign(instant=i) for i, s in ((2, 0.3), (5, 0.9), (8, 0.8))])
    tables = {"replay": table, "instants": pd.DataFrame({"ms": [10.0, 25.0, 40.0]})}
    return streamed(system, tables=tables, metrics=numbers, **LABEL)


def typed(budgets):
    """The choice of the command with some budgets."""
    words = [f"{c.budget}={most:.12g}{c.unit if c.unit in UNITS else ''}" for c, most in budgets.items()]
    return chosen(parse(["data=haart", "protocol=loso", *words], keys("choose"))).choice


def test_every_step_is_the_choice_of_bench_choose(store, monkeypatch):
    plain = []
    for i, (system, skill) in enumerate((("svm", 0.4), ("rf", 0.6), ("cnn", 0.95))):
        arguments = json.dumps({"data": "haart", "protocol": "loso", "model": system})
        about = {"touchbench.command": "run", "touchbench.arguments": arguments} | HAART | LABEL
        plain.append(evaluated(system, made_up(8, skill=skill, seed=i), cost=4.0**i, **about))
    results = [replayed("rf"), *plain]
    for r in results:
        keep(store, r)
    for budgets in ({}, {"flash": 20.0}):
        answer = considered("g", plain, results, budgets)
        table = by_budget([answer], results)
        assert {*table["cost"]} == {"flash", "ram", "predict", "decision", "worst_person"}
        assert sum(table["choice"].str.startswith("rf (first ")) > 1  # of bench stream
        for row in table.itertuples():
            slack = 1 + 1e-8 if costs()[row.cost].better == "low" else 1 - 1e-8
            choice = typed({costs()[k]: v for k, v in (budgets | {row.cost: row.least * slack}).items()})
            best = choice.table.loc[choice.chosen]
            assert (row.choice, row.accuracy, row.flash) == (named(best), best["accuracy"], best["flash"]), row
        for cost, least in table.groupby("cost")["least"]:
            low = costs()[cost].better == "low"
            beyond = 0.99 * least.min() if low else 1.01 * least.max()
            # A replay has no later instant that could take more of a cost, but of the time of a decision.
            assert budgets or cost == "decision" or typed({costs()[cost]: beyond}).chosen is None
    ((_, shown),) = budget_tables(table)
    assert shown.texts[0]["budget"] == "from 4 kB on" and shown.groups[0] == "flash"
    units = {
        noun: re.search(r"\d (\S+)", cells["budget"])[1] for noun, cells in zip(shown.groups, shown.texts, strict=True)
    }
    expected = {"flash": "kB", "RAM": "kB", "computing time": "ms", "decision time": "ms"}
    assert units == expected | {"accuracy of the worst person": "%"}
    monkeypatch.setattr("bench.reports.budgets.steps", lambda *_: [(2.5, -1)])
    table = by_budget([answer], results)
    assert {*table["choice"]} == {NOTHING} and table[["accuracy", "flash"]].isna().all(axis=None)
    ((_, shown),) = budget_tables(table)
    assert [*shown.texts[0].values()] == ["from 2.5 kB on", NOTHING, "-", "-"]


@pytest.mark.parametrize(
    ("better", "steps", "words"),
    [
        ("low", [27.41, 27.44, 27.46], ["from 27.41 h on", "from 27.44 h on", "from 27.5 h on"]),
        (
            "low",
            [0.1 + 0.2, 99.96, 100.4, 999.4],
            ["from 0.3 h on", "from 100 h on", "from 101 h on", "from 1000 h on"],
        ),
        ("high", [80.0, 40.06, 40.04], ["up to 80 h", "up to 40.06 h", "up to 40 h"]),
    ],
)
def test_a_printed_budget_gives_the_choice_of_its_step(monkeypatch, better, steps, words):
    cost = Cost("battery", unit="h", better=better)
    monkeypatch.setattr("bench.reports.budgets.costs", lambda: costs() | {"battery": cost})
    table = pd.DataFrame(
        {"group": "g", "cost": "battery", "least": steps, "choice": "s", "accuracy": 1.0, "flash": 1.0}
    )
    ((_, shown),) = budget_tables(table)
    assert [row["budget"] for row in shown.texts] == words
    typed_in = [cost.burden(float(re.search(r"[\d.]+", text)[0])) for text in words]
    turned = [cost.burden(least) for least in steps]
    for typed_amount, least, looser in zip(typed_in, turned, [*turned[1:], np.inf], strict=True):
        assert least - 1e-9 <= typed_amount < looser
