"""The table of other budgets against ``bench choose`` with each of them."""

import json

import pandas as pd

from bench.amounts import UNITS
from bench.arguments import parse
from bench.commands.choose import chosen
from bench.measures import costs
from bench.options import keys
from bench.outcomes.choice import named
from reports.budgets import NOTHING, budget_tables, by_budget
from reports.candidates import considered
from tests.reports.store import keep
from tests.results import HAART, evaluated, made_up, streamed

LABEL = {"protocol_label": "LOSO (8 subjects)"}


def replayed(system):
    """A result of ``bench stream`` with three instants, of which the second is the best."""
    numbers = {"decide_ms_p50": 1.0, "flash_bytes": 1500.0, "ram_bytes": 900.0}
    table = pd.concat([made_up(8, skill=s, seed=i).assign(instant=i) for i, s in ((2, 0.3), (5, 0.9), (8, 0.8))])
    tables = {"predictions": table, "instants": pd.DataFrame({"ms": [10.0, 25.0, 40.0]})}
    return streamed(system, tables=tables, metrics=numbers, **LABEL)


def typed(budgets):
    """The choice of the command with some budgets."""
    words = [f"{c.budget}={most:.12g}{c.unit if c.unit in UNITS else ''}" for c, most in budgets.items()]
    return chosen(parse(["data=haart", "protocol=loso", *words], keys("choose"))).choice


def test_every_step_is_the_choice_of_bench_choose(store, monkeypatch):
    results = {"cell": [], "stream": [replayed("rf")]}
    for i, (system, skill) in enumerate((("svm", 0.4), ("rf", 0.6), ("cnn", 0.95))):
        arguments = json.dumps({"data": "haart", "protocol": "loso", "model": system})
        about = {"touchbench.command": "run", "touchbench.arguments": arguments} | HAART | LABEL
        results["cell"].append(evaluated(system, made_up(8, skill=skill, seed=i), cost=4.0**i, **about))
    for each in results.values():
        for r in each:
            keep(store, r)
    for budgets in ({}, {"flash": 20.0}):
        answer = considered("g", results["cell"], results, budgets)
        table = by_budget([answer], results)
        assert {*table["cost"]} == {"flash", "ram", "predict", "decision", "worst_person"}
        assert sum(table["choice"].str.startswith("rf (first ")) > 1  # of bench stream
        for row in table.itertuples():
            choice = typed({costs()[k]: v for k, v in (budgets | {row.cost: row.least * (1 + 1e-8)}).items()})
            best = choice.table.loc[choice.chosen]
            assert (row.choice, row.accuracy, row.flash) == (named(best), best["accuracy"], best["flash"]), row
        below = table.groupby("cost")["least"].min()
        for cost in below.index.drop("decision"):  # a replay has no later instant that could take more of these
            assert budgets or typed({costs()[cost]: below[cost] * 0.99}).chosen is None
    ((_, shown),) = budget_tables(table)
    assert shown.texts[0]["budget"] == "from 4 kB on" and shown.groups[0] == "flash"
    units = {noun: cells["budget"].split()[2] for noun, cells in zip(shown.groups, shown.texts, strict=True)}
    expected = {"flash": "kB", "RAM": "kB", "computing time": "ms", "decision time": "ms"}
    assert units == expected | {"error of the worst person": "%"}
    monkeypatch.setattr("reports.budgets.steps", lambda *_: [(2.5, -1)])
    table = by_budget([answer], results)
    assert {*table["choice"]} == {NOTHING} and table[["accuracy", "flash"]].isna().all(axis=None)
    ((_, shown),) = budget_tables(table)
    assert [*shown.texts[0].values()] == ["from 2.5 kB on", NOTHING, "-", "-"]
