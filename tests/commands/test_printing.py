"""What commands print: the best marked, warnings, and values that can be typed."""

import shlex

import pytest

from bench.commands import printing
from bench.registry import views
from bench.reports.views.captures import one_label
from bench.words import quoted
from tests.results import evaluated, result, with_hits


def test_a_run_with_one_label_in_a_fold_is_warned_of():
    right = with_hits([20, 15, 10])
    one = right.assign(**{f"p_{g}": float(g == "pat") for g in ("pat", "rub", "tap")})
    line = one_label([evaluated("lda", right), evaluated("One", one)])
    assert "One in 3 of 3 folds" in line and "lda" not in line and one_label([evaluated("lda", right)]) == ""


def test_rows_are_sorted_by_accuracy_within_captures_and_protocol():
    hits = {"worse": 10, "better": 18, "middle": 14}
    runs = [
        evaluated(name, with_hits([n] * 3), protocol=p, protocol_label=p)
        for p in ("LOSO", "kfold")
        for name, n in hits.items()
    ]
    failed = result("none", metrics={"folds": 0}, failed=3, protocol_label="LOSO")
    table = printing.runs_table([failed, *runs], views()["run"])
    names = [row["system"] for row in table.texts]
    assert names == ["better (best)", "middle", "worse", "none", "better (best)", "middle", "worse"]


VALUES = r"""a == 'it"s'; x == '$HOME'; plain; a == '`ls`'; x == 'a!b'"""


@pytest.mark.parametrize("value", VALUES.split("; "))
def test_a_value_is_quoted_so_that_a_shell_hands_it_over(value):
    assert shlex.split(f"where={quoted(value)}") == [f"where={value}"]
