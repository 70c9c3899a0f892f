"""The verdict of the page: that of ``bench choose``, and what the chart draws of it."""

import numpy as np
import pytest

from bench.cli import main
from bench.outcomes.runs import tracked, with_groups
from bench.outcomes.statistics import interval
from reports.candidates import Considered, chart_data, considered
from reports.comparison import published
from reports.layout import Answer
from reports.page import write_report
from tests.reports.store import made_up, tracked_run


def typed(model, **more):
    given = {"data": "synth", "protocol": "loso", "model": model} | more
    return {"touchbench.command": "run", "touchbench.arguments": str(given).replace("'", '"')}


@pytest.fixture
def runs(store):
    for i, system in enumerate(("svm", "rf", "ta2015_rf[trees=9]")):
        tracked_run(store, system, made_up(8, skill=0.3 + 0.25 * i, seed=i), cost=10.0**i, **typed(system))
    return with_groups(tracked(store))


def test_the_page_says_what_bench_choose_says(store, runs, capsys, tmp_path):
    """Costs are 4, 40 and 400 kB; the last is far more accurate, so that only a budget makes another the choice."""
    for budget, system in (({}, "ta2015_rf[trees=9]"), ({"flash": 100.0}, "rf"), ({"flash": 10.0}, "svm")):
        found = considered(store, runs["group"].iloc[0], runs, budget)
        assert found.choice.table["system"][found.choice.chosen] == system
        lines = found.answer().lines
        assert lines[0].startswith(f"Choose {system}: ")
        words = [f"max_flash={v:g}kB" for v in budget.values()]
        assert found.answer().command == " ".join(["bench choose data=synth protocol=loso", *words])
        assert main(["choose", "data=synth", "protocol=loso", *words]) == 0
        printed = capsys.readouterr().out
        assert all(line in printed for line in lines)
        write_report(store, tmp_path, budget)
        assert f"Choose {system}" in (tmp_path / "index.html").read_text()


def test_marks_of_the_chart(store, runs):
    found = considered(store, runs["group"].iloc[0], runs, {"flash": 100.0})
    data = chart_data([found], dict(zip(runs["system"], runs["model_name"], strict=True)), published())
    (group,) = data["groups"]
    flash = [c.startswith("kB of flash") for c in data["costs"]].index(True)
    assert group["budgets"][flash] == 100 and sum(b is not None for b in group["budgets"]) == 1
    marks = {p["name"]: p for p in group["points"]}
    assert {n: (p["chosen"], p["out"], p["kind"], p["x"][flash]) for n, p in marks.items()} == {
        "svm": (False, False, "other", 4.0),
        "rf": (True, False, "other", 40.0),
        "ta2015_rf[trees=9]": (False, True, "changed", 400.0),
    }
    index = found.choice.table.index[found.choice.table["system"] == "rf"][0]
    own = found.subjects.loc[index].to_numpy()
    assert marks["rf"]["y"] == pytest.approx([own.mean(), *np.clip(interval(own), 0, 100)], rel=1e-4)


def test_no_command_where_its_words_mean_others_too(store, runs):
    group = runs["group"].iloc[0]
    tracked_run(store, "svm", made_up(8), subset="variant == 'rough'", **typed("svm", where="variant == 'rough'"))
    found = considered(store, group, with_groups(tracked(store)), {})
    assert found.answer().command == "bench choose data=synth where=all protocol=loso"
    tracked_run(store, "svm", made_up(8), corpus_digest="e" * 64, **typed("svm"))
    both = with_groups(tracked(store))
    for name in set(both["group"]):
        if "corpus" in name and "rough" not in name:
            assert considered(store, name, both, {}).answer().command == ""


def test_one_system_is_no_choice_and_a_lost_table_is_said(store):
    run = tracked_run(store, "svm", made_up(8, windows=2))
    runs = with_groups(tracked(store))
    found = considered(store, runs["group"].iloc[0], runs, {})
    assert isinstance(found, Considered) and found.answer().lines[0].startswith("Only svm is tracked here")
    store.path(run, runs["artifacts"].iloc[0], "predictions.parquet").unlink()
    lost = considered(store, runs["group"].iloc[0], runs, {})
    assert isinstance(lost, Answer) and "predictions.parquet of svm" in lost.lines[0]


def test_of_many_candidates_the_chart_keeps_the_best_and_those_on_a_front(store):
    for i in range(45):
        tracked_run(store, f"s{i}", made_up(3, skill=0.2 + 0.015 * i, seed=i), cost=1.0 + i)
    runs = with_groups(tracked(store))
    found = considered(store, runs["group"].iloc[0], runs, {})
    (group,) = chart_data([found], {}, published())["groups"]
    table = found.choice.table.sort_values("flash")
    front = table[table["accuracy"] > table["accuracy"].cummax().shift(fill_value=-1)]["system"]
    names = {p["name"] for p in group["points"]}
    assert set(front) <= names and 40 <= len(names) < 45 and group["left"] == 45 - len(names)
