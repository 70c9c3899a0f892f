"""The table of other budgets against ``bench choose`` with each of them."""

import json
import tempfile
from pathlib import Path

import pandas as pd

from bench.arguments import parse
from bench.commands.choose import KEYS, chosen
from bench.costs import COSTS
from bench.outcomes.choice import named
from bench.outcomes.runs import independent, tracked, with_groups
from reports.budgets import budget_tables, by_budget
from reports.candidates import considered
from tests.reports.store import made_up, other_run, tracked_run

FACTS = {"mixes_subjects": "false", "test_over_train": "", "official_split": ""}


def replayed(store, system, **about):
    """A run of ``bench stream`` with three instants, of which the second is the best."""
    costs = {"accuracy": 0.7, "decide_ms_p50": 1.0, "flash_bytes": 1500.0, "ram_bytes": 900.0}
    params = {"cpu": "one", "protocol": "loso", "model": system, "stream.start": "onset", "stream.hop_ms": "None"}
    run = other_run(store, "stream", system, costs, params, **about)
    table = pd.concat([made_up(8, skill=s, seed=i).assign(instant=i) for i, s in ((2, 0.3), (5, 0.9), (8, 0.8))])
    with tempfile.TemporaryDirectory() as folder:
        table.to_parquet(Path(folder) / "predictions.parquet", index=False)
        pd.DataFrame({"ms": [10.0, 25.0, 40.0]}).to_csv(Path(folder) / "instants.csv", index=False)
        store.keep(run, Path(folder))


def test_every_step_is_the_choice_of_bench_choose(store):
    for i, (system, skill) in enumerate((("svm", 0.4), ("rf", 0.6), ("cnn", 0.95))):
        arguments = json.dumps({"data": "haart", "protocol": "loso", "model": system})
        about = FACTS | {"data": "haart", "synthetic": "false", "corpus_digest": "d"}
        about |= {"touchbench.command": "run", "touchbench.arguments": arguments}
        label = {"protocol_label": "LOSO (8 subjects)"}
        tracked_run(store, system, made_up(8, skill=skill, seed=i), cost=4.0**i, **about, **label)
    replayed(store, "rf", **FACTS, **label)
    runs_of = {kind: independent(tracked(store, kind)) for kind in ("cell", "stream")}
    runs = with_groups(tracked(store))
    for budgets in ({}, {"flash": 20.0}):
        answer = considered(store, runs["group"].iloc[0], runs, budgets, runs_of)
        table = by_budget(store, [answer], runs_of)
        assert {*table["cost"]} == {"flash", "ram", "predict", "decision", "worst_person"}
        assert sum(table["choice"].str.startswith("rf (first ")) > 1  # of bench stream
        for row in table.itertuples():
            given = budgets | {row.cost: row.least * (1 + 1e-8)}
            words = [f"max_{cost}={most:.12g}{COSTS.get(cost, '')}" for cost, most in given.items()]
            found = chosen(parse(["data=haart", "protocol=loso", *words], KEYS))
            best = found.choice.table.loc[found.choice.chosen]
            assert (row.choice, row.accuracy, row.flash) == (named(best), best["accuracy"], best["flash"]), words
        below = table.groupby("cost")["least"].min()
        for cost in below.index.drop("decision"):  # a replay has no later instant that could take more of these
            words = [f"max_{cost}={below[cost] * 0.99:.12g}{COSTS.get(cost, '')}"]
            assert budgets or chosen(parse(["data=haart", "protocol=loso", *words], KEYS)).choice.chosen is None
    ((_, shown),) = budget_tables(table)
    assert shown.frame["budget"][0] == "from 4 kB on" and shown.groups[0] == "flash"
