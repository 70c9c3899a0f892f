"""The section of a new person, against numbers that are known beforehand."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tests.reading.results import make_predictions, make_result, make_run
from touchbench_people import page
from touchbench_people.page import (
    UNLABELLED,
    NewPerson,
    accuracy_curve,
    comparable_curves,
    gain_sentence,
)


def test_gains_are_paired_and_losing_people_are_named(monkeypatch):
    by_known = {
        "0": [80.0, 60, 70, 70, 70],
        "2": [90.0, 70, 65, 70, 80],
        UNLABELLED: [82.0, 58, 70, 70, 70],
    }
    results = []
    for known, accuracy in by_known.items():
        people = pd.DataFrame({"subject": [*"abcde"], "accuracy": np.array(accuracy) / 100})
        params = {"protocol.shots": "0" if known == UNLABELLED else known}
        params["protocol.unlabelled"] = str(known == UNLABELLED)
        results.append(make_result("s", tables={"per_subject": people}, **params))
    rows = accuracy_curve(results)
    curve = rows.set_index("known")
    assert curve.index.tolist() == ["0", UNLABELLED, "2"]
    assert curve["accuracy"].tolist() == pytest.approx([70, 70, 75])
    gain = np.array([10.0, 10, -5, 0, 10])
    low, high = stats.t.interval(0.95, 4, gain.mean(), stats.sem(gain))
    gains = curve.loc["2", ["gain", "gain_low", "gain_high"]].tolist()
    assert gains == pytest.approx([5, low, high])
    assert curve.loc["2", "worse"] == "c (-5.0)" and curve.loc[UNLABELLED, "worse"] == "b (-2.0)"
    change = "2 labelled captures of each class change the accuracy of s by +5.0"
    for part, words in ((rows, f"{change} [{low:+.1f}, {high:+.1f}]"), (rows[:2], "")):
        curves = [("here", {"s": part})]
        monkeypatch.setattr(page, "comparable_curves", lambda _, curves=curves: curves)
        assert words in gain_sentence([]) and bool(gain_sentence([])) == bool(words)


def test_runs_become_curves_with_those_whose_shots_are_drawn_alike():
    results, others = [], []
    runs = [("0", False, 5), ("0", True, 5), ("1", False, 2), ("3", False, 2), ("1", False, 5)]
    for shots, unlabelled, draws in runs:
        params = {"shots": shots, "unlabelled": unlabelled, "draws": draws, "weight": 10, "seed": 0}
        params = {f"protocol.{key}": value for key, value in params.items()}
        params |= {"protocol.source": "", "protocol.classes": ""}
        table = make_predictions(3, skill=0.5 + 0.1 * int(shots))
        for protocol, members in (("personal", results), ("loso", others)):
            name = f"{protocol}[{shots}, {unlabelled}, {draws}]"
            members.append(make_run("lda", table, **params, protocol=name, protocol_label=name))
    known = [by_system["lda"]["known"].tolist() for _, by_system in comparable_curves(results)]
    assert known == [["0", UNLABELLED, "1", "3"], ["0", UNLABELLED, "1"]]
    assert comparable_curves(results[:1]) == [] == comparable_curves(others)
    texts = NewPerson().make_exhibits(results, Path())[0].table.texts
    assert texts[0]["gain"] == "-"
    assert [row["shots"] for row in texts] == ["0", UNLABELLED, "1", "3"]
