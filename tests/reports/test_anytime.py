"""Accuracy against seconds of search: curves by hand, a whole report on generated captures, mistakes in one line."""

import numpy as np
import pandas as pd
import pytest

from bench.errors import InputError
from reports import anytime
from reports.anytime import curve_of, main, near


def scores(of_a, of_b):
    rows = [("1", "a", s, v) for s, v in of_a.items()] + [("2", "b", s, v) for s, v in of_b.items()]
    return pd.DataFrame(rows, columns=["fold", "subject", "seconds", "accuracy"])


def test_a_fold_that_has_ended_stays_where_it_was():
    curve = curve_of(scores({1.0: 0.5, 2.0: 0.7}, {1.0: 0.3, 4.0: 0.9}))
    assert curve["seconds"].tolist() == [1.0, 2.0, 4.0]
    assert curve["accuracy"].tolist() == pytest.approx([0.4, 0.5, 0.8])
    assert curve["lost"].tolist() == pytest.approx([0.4, 0.3, 0.0])
    assert curve["error"].tolist() == pytest.approx([0.1, 0.2, 0.1])


def test_moments_without_a_system_are_left_out():
    curve = curve_of(scores({1.0: np.nan, 2.0: 0.7}, {1.0: 0.3, 2.0: 0.9}))
    assert curve["seconds"].tolist() == [2.0]


def test_near_the_end_is_where_it_stays_near():
    curve = pd.DataFrame({"seconds": [1.0, 2, 5, 9], "lost": [0.3, 0.01, 0.2, 0.0], "error": [0.1, 0.1, 0.1, 0.05]})
    assert near(curve) == 9
    curve["lost"] = [0.3, 0.04, 0.01, 0.0]
    assert near(curve) == 2


def test_the_report_is_written_and_says_that_captures_are_generated(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(anytime, "MOMENTS", np.array([0.5, 1.0]))
    small = ["data=synth", "data.subjects=4", "where=gesture in ['pat', 'rub', 'grab']", "protocol=groupkfold"]
    options = ["protocol.folds=2", "model.inner=2", "budget=2", "jobs=1", f"out={tmp_path / 'any'}"]
    assert main([*small, *options]) == 0
    assert "(synthetic)" in "".join(capsys.readouterr())
    assert {p.name for p in (tmp_path / "any").iterdir()} == {
        *("anytime.csv", "anytime.md", "trials.csv", "anytime.png", "anytime.svg")
    }
    found = pd.read_csv(tmp_path / "any" / "anytime.csv")
    assert set(found["subject"]) == {1, 2, 3, 4} and found["accuracy"].between(0, 1).all()
    trials = pd.read_csv(tmp_path / "any" / "trials.csv")
    assert set(trials["fold"]) == {"fold01", "fold02"} and (trials["state"] == "complete").any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["data=nothing"], "nothing"),
        (["budget=0"], "model.budget=0"),
        (["protocol=loso,challenge", "data=synth"], "give one of each"),
        (["model=svm"], "only auto"),
        (["nonsense=1"], "nonsense"),
    ],
)
def test_mistakes_are_one_line(arguments, message):
    with pytest.raises(InputError, match=message):
        main(arguments)
