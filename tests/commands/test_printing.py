"""What commands print: tables that fit, the best marked, what was found, and commands that can be typed."""

import io
import re
import shlex
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench.cli import main
from bench.commands import closing, printing
from bench.commands.run import evaluated_values
from bench.outcomes.comparable import BATCH, MARKED
from bench.plan.arguments import quoted
from tests.conftest import predictions, runs

SMALL = ["data=synth", "data.subjects=3", "data.variants=normal", "data.repetitions=1", "jobs=1"]


def drawn(rows, width, **options):
    text = io.StringIO()
    printing.grid(Console(file=text, width=width, force_terminal=False), "A title", rows, **options)
    return text.getvalue()


@given(
    st.lists(st.text("abc", min_size=1, max_size=12), min_size=1, max_size=14, unique=True),
    st.integers(1, 30),
    st.integers(40, 120),
)
def test_no_heading_is_lost_without_a_word_and_no_line_is_too_long(names, longest, width):
    spare = [f"{name}{place}" for place, name in enumerate(names)]
    rows = [{"system": "s" * longest} | {name: "1" * longest for name in spare}]
    said = drawn(rows, width, left=("system",), spare=spare)
    table, _, rest = said.partition("columns left out: ")
    assert all(len(line) <= width for line in said.splitlines())
    for name in spare:
        assert (name in table) != (name in rest), name
    whole = (
        1 + sum(3 + max(len(name), longest) for name in spare) + 3 + min(max(longest, len("system")), printing.WORDS)
    )
    assert bool(rest) == (whole > width)


def test_columns_go_in_the_order_in_which_they_are_spared_and_no_sooner_than_needed():
    rows = [{"system": "x", "a": "1" * 20, "b": "2" * 20, "c": "3" * 20, "empty": "-"}]
    assert "columns left out: b;" in drawn(rows, 70, spare=["empty", "b", "a"])
    assert "columns left out: b, a;" in drawn(rows, 40, spare=["empty", "b", "a"])
    said = drawn(rows, 80, spare=["empty", "b", "a"])
    assert "left out" not in said and "empty" not in said  # a column of dashes has nothing to show
    said = " ".join(drawn(rows, 40, spare=["b", "a"]).split())
    needed = int(re.search(r"a terminal (\d+) wide", said)[1])
    assert "left out" not in drawn(rows, needed, spare=["b", "a"])
    assert "left out" in drawn(rows, needed - 1, spare=["b", "a"])


def test_a_name_that_is_markup_or_long_is_all_there():
    name = "svm[C=8.0,kernel=[bold]rbf] " + "x" * 60
    said = drawn([{"system": name, "n": "1"}], 50, left=("system",))
    inner = "".join(line.split("│")[1].strip() for line in said.splitlines() if line.startswith("│"))
    assert inner.replace(" ", "") == name.replace(" ", "")


ONE = """
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin


class One(ClassifierMixin, BaseEstimator):
    def fit(self, X, y):
        self.classes_ = np.unique(y)
        return self

    def predict(self, X):
        return np.repeat(self.classes_[:1], len(X))
"""


def test_a_system_that_says_one_label_only_is_not_named_without_a_word(tmp_path, capsys):
    (tmp_path / "one.py").write_text(ONE)
    assert main(["run", *SMALL, f"model={tmp_path / 'one.py'}:One"]) == 0
    said = capsys.readouterr()
    assert said.out.count("one and the same label") == 1 and "One in 3 of 3 folds" in said.out
    assert "But" in said.out and "one label in 3 of 3 folds" in said.out
    assert main(["run", *SMALL, "model=bayes,lda", "features=jung28"]) == 0
    said = capsys.readouterr()
    assert "same label" not in said.out and "But" not in said.out


def next_commands(said):
    """Commands that a command said to type next, and of each its words."""
    lines = said.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("next: "))
    return [shlex.split(line.removeprefix("next: "))[1:] for line in lines[start:] if line.lstrip("next: ")]


def test_run_marks_the_best_says_so_and_what_it_says_to_type_can_be_typed(capsys):
    assert main(["run", *SMALL, "model=bayes,lda,tree", "features=jung28"]) == 0
    said = capsys.readouterr().out
    store, found = runs("cell")
    shares = {}
    for run in found:  # pooled over captures, counted here by hand
        table = predictions(store, run)
        chances = table[[c for c in table if c.startswith("p_")]]
        labels = chances.columns[chances.to_numpy().argmax(axis=1)].str[2:]
        shares[run.data.tags["system"]] = 100 * (labels == table["true"]).mean()
    top = max(shares.values())
    for system, share in shares.items():
        (row,) = [line for line in said.splitlines() if line.startswith(f"│ {system}")]
        assert ("(best)" in row) == (share == top) and f"{share:.1f} [" in row
    assert f"{top:.1f} % of 42 synthetic captures (95 % interval" in said and "over 3 subjects)" in said
    assert all(len(line) <= 100 for line in said.splitlines() if line[:1] in "┏┃┡│└")
    commands = next_commands(said)
    assert commands == [["choose", "data=synth", "protocol=loso"]]
    assert main(commands[0]) == 0
    said = capsys.readouterr().out
    fit, shipped = next_commands(said)
    assert fit[0] == "fit" and "out=chosen" in fit and shipped == ["export", "chosen", "out=chosen_c"]
    assert main([*fit, "stopping=no"]) == 0
    predict, *export = next_commands(capsys.readouterr().out)
    assert main(shipped) == 0
    assert predict == ["predict", "chosen", "new.csv"]
    for command in export:
        assert main(command) == 0


def test_a_system_that_depends_on_the_batch_is_marked_and_never_the_best(capsys):
    values = {"data": "synth", "data.subjects": 3, "data.variants": ("normal",), "data.repetitions": 1, "jobs": 1}
    outcomes = evaluated_values(values | {"model": ["bayes", "lda", "tree"], "features": "jung28"})
    top = max(outcomes, key=lambda outcome: outcome.metrics["accuracy"])
    top.tags[BATCH] = "true"
    assert printing.show(outcomes) == 0
    said = capsys.readouterr().out
    name = top.plan.cell.system()
    assert f"│ {name} † " in said and f"{name} † (best)" not in said and "(best)" in said
    assert MARKED in said.splitlines()


def test_one_run_is_told_to_be_compared_and_a_subset_is_named_where_there_are_several(capsys):
    assert main(["run", *SMALL[:4], "model=lda", "features=jung28", "where=gesture in ['pat', 'rub', 'tap']"]) == 0
    compare, choose = next_commands(capsys.readouterr().out)
    assert (
        compare[0] == "run"
        and compare[-4:] == ["model=lda", "features=touch", "model.window=1.0", "model.repair=stuck+dead"]
        and "where=gesture in ['pat', 'rub', 'tap']" in compare
    )
    assert main(choose) == 0
    assert main(["run", *SMALL, "model=lda,bayes", "features=jung28"]) == 0
    capsys.readouterr()
    assert main(["choose", "data=synth", "protocol=loso"]) == 2  # two subsets are tracked by now
    assert main(["run", *SMALL, "model=lda,bayes", "features=jung28"]) == 0
    (choose,) = next_commands(capsys.readouterr().out)
    assert main(choose) == 0


def test_stress_has_a_headline_one_table_and_its_next_command_trains_under_the_worst_fault(capsys):
    command = ["stress", *SMALL, "model=lda,bayes", "features=jung28", "faults=noise,shift"]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "points on average over 2 faults" in said.splitlines()[0]
    assert said.count("┏") == 1 and len(said.splitlines()) < 20 and "stress/stability.md" in said
    _, found = runs("stress")
    mean = {r.data.tags["system"]: sum(r.data.metrics[f"loss.{f}"] for f in ("noise", "shift")) / 2 for r in found}
    assert said.startswith(min(mean, key=mean.get))
    (again,) = next_commands(said)
    least = next(r for r in found if r.data.tags["system"] == min(mean, key=mean.get))
    worst = max(("noise", "shift"), key=lambda f: least.data.metrics[f"loss.{f}"])
    assert f"model.faults={worst}" in again and again[0] == "stress" and main(again) == 0
    assert next_commands(capsys.readouterr().out) == [["report"]]


def test_stream_says_what_deciding_early_costs_and_its_next_command_finds_a_system(capsys):
    assert main(["stream", *SMALL, "model=lda", "features=jung28"]) == 0
    said = capsys.readouterr().out
    _, (run,) = runs("stream")
    assert f"after {run.data.metrics['adaptive_ms']:.0f} ms of touch on average" in said
    assert main(["run", *SMALL, "model=lda", "features=jung28"]) == 0
    capsys.readouterr()
    (choose,) = next_commands(said)
    assert choose[0] == "choose" and main(choose) == 0


def test_stream_says_where_deciding_early_saves_nothing(monkeypatch, capsys):
    monkeypatch.setattr(closing, "_where", lambda one, outcomes: "")
    monkeypatch.setattr(closing, "_contexts", lambda outcomes: [outcomes])
    monkeypatch.setattr(closing, "_system", lambda one: "lda")
    monkeypatch.setattr(closing, "_typed", lambda one: {"start": "middle"})
    metrics = {"adaptive_accuracy": 0.8, "adaptive_ms": 8000.0, "mean_ms": 8000.0, "accuracy": 0.8}
    closing.streamed([SimpleNamespace(metrics=metrics)])
    said = capsys.readouterr().out
    assert said.startswith("lda: no saving found by deciding early; whole captures, 8000 ms, get 80.0 %")


def test_commands_inside_another_one_do_not_say_what_comes_next(capsys):
    with printing.led():
        printing.then("bench run")
    assert not capsys.readouterr().out
    printing.then("bench run")
    assert capsys.readouterr().out == "next: bench run\n"


@pytest.mark.parametrize(
    "value",
    [
        "variant == 'rough'",
        "a == 'it\"s'",
        "x == '$HOME'",
        "plain",
        "two words",
        "a == '`ls`'",
        "wow!",
        "x == 'a!b'",
        "\\",
    ],
)
def test_a_value_is_quoted_so_that_a_shell_hands_it_over(value):
    assert shlex.split(f"where={quoted(value)}") == [f"where={value}"]


def test_systems_prints_commands_that_can_be_pasted(capsys):
    assert main(["systems"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if line.strip().startswith("bench run")]
    assert len(lines) > 40 and not [line for line in lines if "'\"'\"'" in line]
    assert "bench run data=cost where=\"variant == 'rough'\" protocol=loso model=jung2014_bayes" in lines
    from bench.commands.run import KEYS
    from bench.plan.arguments import parse
    from bench.plan.cells import cells

    for line in lines:
        assert cells(parse(shlex.split(line)[2:], KEYS))
