"""Stored revisions and steps."""

import numpy as np
import pytest

from bench.reports.history import draw_history, find_steps, history_exhibits, history_sheet
from bench.reports.page import write_report
from tests.reading.results import make_run, predictions_with_hits
from tests.reports.store import tracked_run


def run(git, right, cost=1.0, relative=2.0, **about):
    numbers = {"predict_relative": relative}
    return make_run(
        "a", predictions_with_hits([right] * 5), cost=cost, metrics=numbers, git=git, **about
    )


def alarms(table):
    return table["step"].str.partition(":")[0].tolist()


def test_a_step_is_where_the_gate_would_no_longer_report_the_same():
    runs = [run("a", 9), run("a", 14), run("b", 14, relative=3.9), run("c", 8)]
    runs += [run("d+changes", 8, cost=1.09), run("e", 8, cost=1.11)]
    runs += [run("f", 8, 1.11, relative=4.1), run("x", 3, seed=1), run("x", 20, data="other")]
    table = find_steps(runs)
    assert table["revision"].tolist() == ["a", "b", "c", "d+changes", "e", "f"]  # the newest of a
    assert alarms(table) == ["", "", "worse", "", "larger", "slower"]
    assert table["before"].tolist() == ["", "a", "b", "c", "d+changes", "e"]
    assert "30 of 100 labels changed" in table["step"][2] and "time x2.05" in table["step"][5]
    again = find_steps([run("a", 9), run("b", 9), run("a", 9)])
    assert again["revision"].tolist() == ["b", "a"]  # the runs that count, in their order
    times = zip("abcd", (1, 1.5, 1.9, 2.5), strict=True)
    slow = find_steps([run(git, 14, relative=relative) for git, relative in times])
    assert alarms(slow) == ["", "", "", "slower"]


def test_each_revision_is_drawn_and_steps_are_listed(tmp_path):
    tables = {"g": find_steps([run("0" * 12, 9), run("1" * 12, 14), run("3" * 12 + "+changes", 8)])}
    (exhibit,), sheet = history_exhibits(tables, tmp_path), history_sheet(tables)
    np.testing.assert_allclose(sheet["accuracy %"], [45, 70, 40])
    assert sheet["flash kB"].tolist() == [4] * 3 and len(exhibit.table.rows) == 2
    axes = draw_history(tables["g"]).axes
    assert any(label.get_text().startswith("33333333+") for label in axes[-1].get_xticklabels())


@pytest.mark.usefixtures("quick")
def test_a_report_without_several_revisions_warns(store, capsys, tmp_path):
    tracked_run(store, "a", predictions_with_hits([9] * 5), git="0" * 12)
    write_report(store, tmp_path, with_history=True)
    assert "no system has complete runs of several revisions" in capsys.readouterr().err
    assert not (tmp_path / "history.csv").exists()
