"""What commands print: tables that fit, the best marked, and commands that can be typed."""

import io
import re
import shlex

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench.arguments import quoted
from bench.cli import main
from bench.commands import printing
from bench.commands.run import evaluated_values
from bench.outcomes.comparable import BATCH, MARKED
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
    assert main(["run", *SMALL, "model=bayes,lda", "features=jung28"]) == 0
    said = capsys.readouterr()
    assert "same label" not in said.out


def next_commands(said):
    """Commands that a command said to type next, and of each its words."""
    lines = said.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("next: "))
    return [shlex.split(line.removeprefix("next: "))[1:] for line in lines[start:] if line.lstrip("next: ")]


def test_run_marks_the_best_and_what_it_says_to_type_can_be_typed(capsys):
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
    assert all(len(line) <= 100 for line in said.splitlines() if line[:1] in "┏┃┡│└")
    commands = next_commands(said)
    assert commands == [["choose"]]
    assert main(commands[0]) == 0
    said = capsys.readouterr().out
    (fit,) = next_commands(said)
    assert fit[0] == "fit" and "out=chosen" in fit
    assert main([*fit, "stopping=no"]) == 0
    predict, export = next_commands(capsys.readouterr().out)
    assert predict == ["predict", "chosen", "new.csv"] and export == ["export", "chosen", "out=in_c"]
    assert main(export) == 0


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
    from bench.arguments import parse
    from bench.commands.run import KEYS
    from bench.plan.cells import cells

    for line in lines:
        assert cells(parse(shlex.split(line)[2:], KEYS))
