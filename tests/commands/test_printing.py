"""What commands print: tables that fit, the best marked, and commands that can be typed."""

import shlex

import pytest

from bench.cli import main
from bench.commands import printing
from bench.registry import views
from bench.words import quoted
from tests.conftest import SMALL, predictions, runs
from tests.results import evaluated, result, with_hits


def next_commands(text):
    """Commands that a command printed to type next, and of each its words."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("next: "))
    return [shlex.split(line.removeprefix("next: "))[1:] for line in lines[start:] if line.lstrip("next: ")]


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


def test_run_marks_the_best_and_warns_of_one_label_and_what_it_prints_next_can_be_typed(tmp_path, capsys):
    (tmp_path / "one.py").write_text(ONE)
    assert main(["run", *SMALL, "model=bayes,lda,one.py:One", "features=jung28"]) == 0
    text = capsys.readouterr().out
    (warning,) = [line for line in text.splitlines() if line.startswith("warning: ")]
    assert "One in 3 of 3 folds" in warning and "lda" not in warning
    store, found = runs("cell")
    shares = {}
    for run in found:  # mean over subjects, counted here by hand
        table = predictions(store, run)
        chances = table[[c for c in table if c.startswith("p_")]]
        labels = chances.columns[chances.to_numpy().argmax(axis=1)].str[2:]
        shares[run.data.tags["system"]] = 100 * (labels == table["true"]).groupby(table["subject"]).mean().mean()
    top = max(shares.values())
    for system, share in shares.items():
        (row,) = [line for line in text.splitlines() if line.startswith(f"│ {system}")]
        assert ("(best)" in row) == (share == top) and f" {share:.1f} " in row
    assert "3 subjects: too few for an interval" in text
    commands = next_commands(text)
    assert commands == [["choose", "data=synth", "where=all", "protocol=loso"]]
    assert main([*commands[0], "model=bayes,lda"]) == 0
    (fit,) = next_commands(capsys.readouterr().out)
    assert fit[0] == "fit" and "out=chosen" in fit
    assert main([*fit, "stopping=no"]) == 0
    assert next_commands(capsys.readouterr().out) == [["predict", "chosen", "new.csv"]]


def test_rows_are_sorted_by_accuracy_within_captures_and_protocol():
    hits = {"worse": 10, "better": 18, "middle": 14}
    runs = [
        evaluated(name, with_hits([n] * 3), protocol=p, protocol_label=p)
        for p in ("LOSO", "kfold")
        for name, n in hits.items()
    ]
    failed = result("none", metrics={"folds": 0}, failed=3, protocol_label="LOSO")
    table = printing.runs_table([failed, *runs], views()["run"])
    names = [row["system"].removesuffix(" (best)") for row in table.texts]
    assert names == ["better", "middle", "worse", "none", "better", "middle", "worse"]


VALUES = r"""a == 'it"s'; x == '$HOME'; plain; a == '`ls`'; x == 'a!b'"""


@pytest.mark.parametrize("value", VALUES.split("; "))
def test_a_value_is_quoted_so_that_a_shell_hands_it_over(value):
    assert shlex.split(f"where={quoted(value)}") == [f"where={value}"]
