"""Reactions and costs against loops and sums by hand."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.errors import InputError
from bench.outcomes.reactions import Reactions, by_decision
from tests.reports.store import made_up

ROBOT = Reactions({"calm": ("pat", "rub")}, costs={"tap": {"calm": 4.0}, "nothing": {"tap": 2.0}}, silence=0.6)


def test_probabilities_of_a_group_are_summed_and_the_cheapest_reaction_is_taken():
    proba = pd.DataFrame([[0.3, 0.3, 0.4], [0.5, 0.45, 0.05], [0.4, 0.4, 0.2]], columns=["pat", "rub", "tap"])
    assert Reactions({"calm": ("pat", "rub")}).decided(proba).tolist() == ["calm"] * 3
    assert Reactions().decided(proba).tolist() == ["tap", "pat", "pat"]  # a tie goes to the first
    # calm costs 4 p(tap): 1.6, 0.2, 0.8; tap costs p(calm): 0.6, 0.95, 0.8; nothing costs 0.6.
    assert ROBOT.decided(proba).tolist() == ["tap", "calm", "nothing"]


def test_scores_are_100_less_the_mean_cost_of_each_subject():
    rows = [("a", "tap", "pat"), ("a", "tap", "tap"), ("a", "rub", "pat"), ("b", "pat", "unknown"), ("b", "pat", "tap")]
    labelled = pd.DataFrame(rows, columns=["subject", "true", "predicted"])
    assert ROBOT.scores(labelled).to_dict() == pytest.approx({"a": 100 - 400 / 3, "b": 100 - 160 / 2})
    ignoring = Reactions({"calm": ("pat", "rub")}, ignored=True)
    assert ignoring.scores(labelled).to_dict() == pytest.approx({"a": 200 / 3, "b": 0})
    assert Reactions({"nothing": ("tap",)}).scores(labelled)["b"] == 0 and not Reactions({"a": ("pat",)}).plain


def test_a_gesture_called_nothing_is_not_silence():
    """A missed touch (an empty label) would be right."""
    labelled = pd.DataFrame({"subject": "a", "true": ["nothing", "pat"], "predicted": ["", "pat"]})
    with pytest.raises(InputError, match="nothing: this is also a gesture that is not listed; list it"):
        Reactions(silence=0.5).scores(labelled)
    assert Reactions({"still": ("nothing",)}, silence=0.5).scores(labelled)["a"] == 75
    assert Reactions({"nothing": ("nothing",)}).scores(labelled)["a"] == 100


@given(st.integers(0, 10**6), st.sampled_from([Reactions(), ROBOT, Reactions({"x": ("rub", "tap")}, ignored=True)]))
def test_decisions_equal_a_loop_over_all_reactions(seed, robot):
    table = made_up(subjects=2, per_class=1, seed=seed)
    costs, reaction_of = robot.cost_table(["pat", "rub", "tap"]), robot.of(["pat", "rub", "tap"])
    for row, taken in zip(table.to_dict("records"), by_decision(table, robot)["taken"], strict=True):
        expected = {
            said: sum(row[f"p_{g}"] * costs.loc[reaction_of[g], said] for g in ("pat", "rub", "tap")) for said in costs
        }
        assert expected[taken] == pytest.approx(min(expected.values()), abs=1e-9)


@pytest.mark.parametrize(
    ("robot", "fact"),
    [
        (Reactions({"calm": ("path",)}), "calm: there is no gesture path; did you mean pat"),
        (Reactions(costs={"tap": {"petting": 2.0}}), "no reaction petting"),
    ],
)
def test_names_that_do_not_exist_are_refused(robot, fact):
    with pytest.raises(InputError, match=fact):
        robot.decided(pd.DataFrame(np.ones((1, 3)) / 3, columns=["pat", "rub", "tap"]))
