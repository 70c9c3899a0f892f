"""The section of a new person, against numbers that are known beforehand."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tests.results import evaluated, made_up, result
from touchbench_people.page import WITHOUT, curve_of, curves_of, gained, new_person_section


def test_gains_of_shots_are_paired_and_who_loses_is_named(monkeypatch):
    by_known = {
        "0": [80.0, 60, 70, 70, 70],
        "2": [90.0, 70, 65, 70, 80],
        WITHOUT: [82.0, 58, 70, 70, 70],
    }
    results = []
    for known, accuracy in by_known.items():
        people = pd.DataFrame({"subject": [*"abcde"], "accuracy": np.array(accuracy) / 100})
        about = {
            "protocol.shots": known.replace(WITHOUT, "0"),
            "protocol.unlabelled": str(known == WITHOUT),
        }
        results.append(result("s", tables={"per_subject": people}, **about))
    long = curve_of(results)
    curve = long.set_index("known")
    assert curve.index.tolist() == ["0", WITHOUT, "2"] and curve[
        "accuracy"
    ].tolist() == pytest.approx([70, 70, 75])
    gain = np.array([10.0, 10, -5, 0, 10])
    low, high = stats.t.interval(0.95, 4, gain.mean(), stats.sem(gain))
    assert curve.loc["2", ["gain", "gain_low", "gain_high"]].tolist() == pytest.approx(
        [5, low, high]
    )
    assert curve.loc["2", "worse"] == "c (-5.0)" and curve.loc[WITHOUT, "worse"] == "b (-2.0)"
    change = f"2 labelled captures of each class change the accuracy of s by +5.0 [{low:+.1f}, {high:+.1f}]"
    for shown, words in ((long, change), (long[long["known"] != "2"], "")):
        monkeypatch.setattr(
            "touchbench_people.page.curves_of", lambda _, shown=shown: [("here", {"s": shown})]
        )
        assert words in gained([]) and bool(gained([])) == bool(words)


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
            made_up(3, skill=0.5 + 0.1 * int(shots)),
            f"[{shots}, {unlabelled}, {draws}]",
        )
        for protocol, members in (("personal", results), ("loso", others)):
            name = protocol + values
            members.append(evaluated("lda", table, **about, protocol=name, protocol_label=name))
    known = [by_system["lda"]["known"].tolist() for _, by_system in curves_of(results)]
    assert known == [["0", WITHOUT, "1", "3"], ["0", WITHOUT, "1"]]
    assert curves_of(results[:1]) == [] == curves_of(others)
    table = new_person_section(results).parts[0].table
    assert table.texts[0]["gain"] == "-" and [row["shots"] for row in table.texts] == [
        "0",
        WITHOUT,
        "1",
        "3",
    ]
