"""Systems over git revisions: which runs are points, and where a step is."""

from pathlib import Path

import numpy as np
import pandas as pd

from bench.cli import main
from bench.reports.history import history
from tests.reports.store import tracked_run
from tests.results import evaluated, with_hits


def run(git, right, cost=1.0, relative=2.0, **about):
    return evaluated("a", with_hits([right] * 5), cost=cost, metrics={"predict_relative": relative}, git=git, **about)


def test_a_step_is_where_the_gate_would_no_longer_report_the_same():
    runs = [run("a", 9), run("a", 14), run("b", 14, relative=3.9), run("c", 8), run("d+changes", 8, cost=1.09)]
    runs += [run("e", 8, cost=1.11), run("f", 8, 1.11, relative=4.1), run("x", 3, seed=1), run("x", 20, data="other")]
    table = history(runs)
    assert table["revision"].tolist() == ["a", "b", "c", "d+changes", "e", "f"]  # the newest of a; others have one
    wrong = table.set_index("revision")["step"].str.partition(":")[0].to_dict()
    assert wrong == {"a": "", "b": "", "c": "worse", "d+changes": "", "e": "larger", "f": "slower"}
    assert table["before"].tolist() == ["", "a", "b", "c", "d+changes", "e"]
    assert "30 of 100 labels changed" in table["step"][2] and "time x2.05" in table["step"][5]
    again = history([run("a", 9), run("b", 9), run("a", 9)])
    assert again["revision"].tolist() == ["b", "a"]  # the runs that count, in their order
    slow = history([run(git, 14, relative=relative) for git, relative in zip("abcd", (1, 1.5, 1.9, 2.5), strict=True)])
    assert slow["step"].str.partition(":")[0].tolist() == ["", "", "", "slower"]


def test_the_report_draws_each_revision_and_lists_steps(store, capsys):
    tracked_run(store, "a", with_hits([9] * 5), git="0" * 12)
    assert main(["report", "history=yes"]) == 0 and not Path("report/history.csv").exists()
    assert "no system has complete runs of several revisions" in capsys.readouterr().err
    for git, right in (("1" * 12, 14), ("2" * 12, 14), ("3" * 12 + "+changes", 8)):
        tracked_run(store, "a", with_hits([right] * 5), git=git)
    assert main(["report"]) == 0 and not Path("report/history.csv").exists()
    assert main(["report", "history=yes"]) == 0
    table = pd.read_csv("report/history.csv")
    np.testing.assert_allclose(table["accuracy %"], [45, 70, 70, 40])
    assert table["flash kB"].tolist() == [4, 4, 4, 4] and table["step"].notna().tolist() == [False, True, False, True]
    (drawing,) = Path("report/figures").glob("0-history-*.svg")
    assert "33333333+" in drawing.read_text() and "worse: pooled 70.0" in Path("report/index.html").read_text()
