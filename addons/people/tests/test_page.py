"""The section of a new person, against numbers that are known beforehand."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tests.reading.results import make_predictions, make_result, make_run
from touchbench_people.page import (
    UNLABELLED,
    accuracy_curve,
    comparable_curves,
    gain_sentence,
    new_person_exhibits,
)


def test_gains_of_shots_are_paired_and_who_loses_is_named(monkeypatch):
    by_known = {
        "0": [80.0, 60, 70, 70, 70],
        "2": [90.0, 70, 65, 70, 80],
        UNLABELLED: [82.0, 58, 70, 70, 70],
    }
    results = []
    for known, accuracy in by_known.items():
        people = pd.DataFrame({"subject": [*"abcde"], "accuracy": np.array(accuracy) / 100})
        about = {
            "protocol.shots": known.replace(UNLABELLED, "0"),
            "protocol.unlabelled": str(known == UNLABELLED),
        }
        results.append(make_result("s", tables={"per_subject": people}, **about))
    long = accuracy_curve(results)
    curve = long.set_index("known")
    assert curve.index.tolist() == ["0", UNLABELLED, "2"] and curve[
        "accuracy"
    ].tolist() == pytest.approx([70, 70, 75])
    gain = np.array([10.0, 10, -5, 0, 10])
    low, high = stats.t.interval(0.95, 4, gain.mean(), stats.sem(gain))
    assert curve.loc["2", ["gain", "gain_low", "gain_high"]].tolist() == pytest.approx(
        [5, low, high]
    )
    assert curve.loc["2", "worse"] == "c (-5.0)" and curve.loc[UNLABELLED, "worse"] == "b (-2.0)"
    change = f"2 labelled captures of each class change the accuracy of s by +5.0 [{low:+.1f}, {high:+.1f}]"
    for shown, words in ((long, change), (long[long["known"] != "2"], "")):
        monkeypatch.setattr(
            "touchbench_people.page.comparable_curves",
            lambda _, shown=shown: [("here", {"s": shown})],
        )
        assert words in gain_sentence([]) and bool(gain_sentence([])) == bool(words)


def test_runs_of_a_new_person_become_curves_with_those_that_are_drawn_alike():
    results, others = [], []
    for shots, unlabelled, draws in (
        ("0", False, 5),
        ("0", True, 5),
        ("1", False, 2),
        ("3", False, 2),
        ("1", False, 5),
    ):
        about = {
            "protocol.shots": shots,
            "protocol.unlabelled": unlabelled,
            "protocol.draws": draws,
        }
        about |= {
            "protocol.weight": 10,
            "protocol.seed": 0,
            "protocol.source": "",
            "protocol.classes": "",
        }
        table, values = (
            make_predictions(3, skill=0.5 + 0.1 * int(shots)),
            f"[{shots}, {unlabelled}, {draws}]",
        )
        for protocol, members in (("personal", results), ("loso", others)):
            name = protocol + values
            members.append(make_run("lda", table, **about, protocol=name, protocol_label=name))
    known = [by_system["lda"]["known"].tolist() for _, by_system in comparable_curves(results)]
    assert known == [["0", UNLABELLED, "1", "3"], ["0", UNLABELLED, "1"]]
    assert comparable_curves(results[:1]) == [] == comparable_curves(others)
    table = new_person_exhibits(results)[0].table
    assert table.texts[0]["gain"] == "-" and [row["shots"] for row in table.texts] == [
        "0",
        UNLABELLED,
        "1",
        "3",
    ]
