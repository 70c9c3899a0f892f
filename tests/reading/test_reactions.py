"""Reactions, their costs and groups of gestures, against sums by hand and naive loops."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bench
from bench.errors import InputError
from bench.reading.groups import accuracy_by_grouping
from bench.reading.reactions import Reactions, points_lost, react_to_decisions
from tests.reading.results import (
    make_predictions,
    make_stress_run,
    predictions_with_hits,
    rows_of_case,
)
from tests.reports.store import tracked_run

ROBOT = Reactions(
    {"calm": ("pat", "rub")}, costs={"tap": {"calm": 4.0}, "nothing": {"tap": 2.0}}, silence=0.6
)


def test_probabilities_of_a_group_are_summed_and_the_cheapest_reaction_is_taken():
    proba = pd.DataFrame(
        [[0.3, 0.3, 0.4], [0.5, 0.45, 0.05], [0.4, 0.4, 0.2]], columns=["pat", "rub", "tap"]
    )
    assert Reactions({"calm": ("pat", "rub")}).cheapest_reactions(proba).tolist() == ["calm"] * 3
    assert Reactions().cheapest_reactions(proba).tolist() == [
        "tap",
        "pat",
        "pat",
    ]  # a tie goes to the first
    # calm costs 4 p(tap): 1.6, 0.2, 0.8; tap costs p(calm): 0.6, 0.95, 0.8; nothing costs 0.6.
    assert ROBOT.cheapest_reactions(proba).tolist() == ["tap", "calm", "nothing"]


def test_scores_are_100_less_the_mean_cost_of_each_subject():
    rows = [
        ("a", "tap", "pat"),
        ("a", "tap", "tap"),
        ("a", "rub", "pat"),
        ("b", "pat", "unknown"),
        ("b", "pat", "tap"),
    ]
    labelled = pd.DataFrame(rows, columns=["subject", "true", "predicted"])
    assert ROBOT.score_by_subject(labelled).to_dict() == pytest.approx(
        {"a": 100 - 400 / 3, "b": 100 - 160 / 2}
    )
    ignoring = Reactions({"calm": ("pat", "rub")}, ignored=True)
    assert ignoring.score_by_subject(labelled).to_dict() == pytest.approx({"a": 200 / 3, "b": 0})
    assert (
        Reactions({"nothing": ("tap",)}).score_by_subject(labelled)["b"] == 0
        and not Reactions({"a": ("pat",)}).is_default
    )


def test_a_gesture_called_nothing_is_not_silence():
    """A missed touch (an empty label) would be right."""
    labelled = pd.DataFrame({"subject": "a", "true": ["nothing", "pat"], "predicted": ["", "pat"]})
    with pytest.raises(
        InputError, match="nothing: this is also a gesture that is not listed; list it"
    ):
        Reactions(silence=0.5).score_by_subject(labelled)
    assert Reactions({"still": ("nothing",)}, silence=0.5).score_by_subject(labelled)["a"] == 75
    assert Reactions({"nothing": ("nothing",)}).score_by_subject(labelled)["a"] == 100


@given(
    st.integers(0, 10**6),
    st.sampled_from([Reactions(), ROBOT, Reactions({"x": ("rub", "tap")}, ignored=True)]),
)
def test_decisions_equal_a_loop_over_all_reactions(seed, robot):
    table = make_predictions(subjects=2, per_class=1, seed=seed)
    costs, reaction_of = (
        robot.cost_table(["pat", "rub", "tap"]),
        robot.reaction_by_gesture(["pat", "rub", "tap"]),
    )
    for row, taken in zip(
        table.to_dict("records"), react_to_decisions(table, robot)["taken"], strict=True
    ):
        expected = {
            said: sum(
                row[f"p_{g}"] * costs.loc[reaction_of[g], said] for g in ("pat", "rub", "tap")
            )
            for said in costs
        }
        assert expected[taken] == pytest.approx(min(expected.values()), abs=1e-9)


def test_a_reaction_that_does_not_exist_is_refused():
    with pytest.raises(InputError, match="no reaction petting"):
        Reactions(costs={"tap": {"petting": 2.0}}).cheapest_reactions(
            pd.DataFrame({"pat": [0.5], "tap": [0.5]})
        )


def test_points_that_are_lost_under_faults_by_hand():
    """Two taps of each person; at severity 2, subject 1 has one rub: calm for tap costs 4."""
    clean = pd.DataFrame(
        {"subject": [*"112233"], "capture": [0, 1] * 3, "true": "tap", "predicted": "tap"}
    )
    felt = clean.assign(predicted=["rub", *["tap"] * 5])
    levels = [
        rows_of_case(table, "under", "noise", level)
        for level, table in ((1, clean), (2, felt), (3, felt))
    ]
    labels = pd.concat([rows_of_case(clean), *levels], ignore_index=True)
    run = make_stress_run("svm", 1.0, {"noise": 0.0}, tables={"labels": labels})
    lost = points_lost([run], ("noise",), 2, ROBOT, "under")
    assert lost.to_dict("index") == {
        ("noise", 1): {"1": 0, "2": 0, "3": 0},
        ("noise", 2): {"1": 200, "2": 0, "3": 0},
    }
    assert points_lost([run], ("noise", "shift"), 2, ROBOT, "under") is None


def table(mistakes, of=4, gestures="abcd"):
    """``of`` captures of each gesture by each person; the mistake ``ab`` is an a labelled b."""
    rows = []
    for person, wrong in enumerate(mistakes, 1):
        for true in gestures:
            labels = [pair[1] for pair in wrong.split() if pair[0] == true]
            for label in labels + [true] * (of - len(labels)):
                rows.append(
                    (
                        str(person),
                        len(rows),
                        str(person),
                        true,
                        *(float(label == g) for g in gestures),
                    )
                )
    return pd.DataFrame(
        rows, columns=["fold", "capture", "subject", "true", *(f"p_{g}" for g in gestures)]
    )


def test_an_abstention_is_in_no_group_and_no_confusion():
    rows = table(["ab ba", "ab ba", "ab ba"])
    gone = rows["true"] == "a"
    abstaining = rows.assign(
        **{name: rows[name].where(~gone, 0.0) for name in ("p_a", "p_b", "p_c", "p_d")}
    )
    assert accuracy_by_grouping(abstaining)["accuracy"].tolist() == pytest.approx(
        [100 * 11 / 16, 75, 75]
    )


def test_the_pair_with_the_most_confusions_per_pair_of_captures_is_merged():
    # 12 captures of each. a and b: 5 mutual confusions / (12 * 12). Then ab and c: 4 / (24 * 12),
    # c and d: 3 / (12 * 12), so c and d are merged although ab and c have more confusions. The
    # order is the same without any one person.
    found = accuracy_by_grouping(table(["ab ba ac bc cd", "ab ba ca dc", "ab ac dc"]))
    assert found["grouping"].tolist() == [
        (("a",), ("b",), ("c",), ("d",)),
        (("a", "b"), ("c",), ("d",)),
        (("a", "b"), ("c", "d")),
    ]
    assert (
        found["groups"].tolist() == [4, 3, 2]
        and (found["same"] == 3).all()
        and (found["subjects"] == 3).all()
    )
    # Of 16 captures of each person, correct are 11, 12, 13; with a and b merged 13, 14, 14; with
    # both merged 14, 15, 15.
    assert found["accuracy"].tolist() == pytest.approx([100 * n / 48 for n in (36, 41, 44)])
    assert found["largest"].tolist() == pytest.approx([25, 50, 50])
    assert found[["low", "high"]].isna().all(axis=None)  # of three people


def by_hand(tested, grouping):
    """Share of the captures whose group has the highest sum of mean probabilities."""
    hits = []
    for _, capture in tested.groupby("capture"):
        sums = [sum(capture[f"p_{gesture}"].mean() for gesture in group) for group in grouping]
        hits.append(capture["true"].iloc[0] in grouping[int(np.argmax(sums))])
    return 100 * np.mean(hits)


@given(seed=st.integers(0, 10**6), counts=st.lists(st.integers(1, 3), min_size=3, max_size=4))
def test_nothing_of_a_person_decides_on_the_groups_of_that_person(seed, counts):
    people = [
        make_predictions(1, count, 0.6, seed + i, windows=2, gestures="abcd").assign(
            subject=str(i), fold=str(i)
        )
        for i, count in enumerate(counts)
    ]
    found = accuracy_by_grouping(pd.concat(people))
    expected = []
    for i, person in enumerate(people):  # the grouping comes from a table without the person
        chosen = accuracy_by_grouping(pd.concat([p for k, p in enumerate(people) if k != i]))[
            "grouping"
        ]
        expected.append([by_hand(person, grouping) for grouping in chosen])
    assert found["accuracy"].tolist() == pytest.approx(np.mean(expected, axis=0).tolist())


def test_all_seeds_of_the_most_accurate_system_are_used(store):
    tracked_run(store, "lda", predictions_with_hits([12, 13, 14, 13, 13]))
    for seed, hits in enumerate(([16, 17, 18, 17, 17], [18, 17, 16, 17, 17])):
        tracked_run(store, "rf", predictions_with_hits(hits), seed=str(seed))
    found = bench.groups(data="synth")
    assert found["accuracy"][0] == pytest.approx(85) and found["low"][0] == pytest.approx(85)
    assert bench.groups(model="lda")["accuracy"][0] == pytest.approx(65)
