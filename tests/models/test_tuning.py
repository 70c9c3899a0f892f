"""The nested search: against a plain loop over grid and folds, resumed, blind to test subjects."""

import itertools
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import wilcoxon
from sklearn.base import clone
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler
from sklearn.svm import SVC

from bench.corpora.folder import open_folder, write_folder
from bench.features.jung28 import Jung28
from bench.features.selection import Subset
from bench.features.ta273 import Ta273
from bench.ground.scratch import data_folder
from bench.models.classic.svm import svm
from bench.models.search.study import FinishedTrial, Study
from bench.models.search.tuning import Search
from bench.models.sizes import count_parameters
from bench.models.space import Range
from tests.conftest import random_corpus, with_other_values

GRID = {"C": [0.125, 8.0, 512.0], "gamma": [0.01, 1.0]}
SELECTED = Subset(Jung28(), 4)  # which learns from labels


def noisy(subjects=4, longest=15):
    """Captures whose classes overlap, so that parameters matter."""
    corpus = random_corpus(subjects=subjects, per_class=3, longest=longest)
    noise = (
        np.random.default_rng(1).integers(0, 120, len(corpus)).repeat(corpus.lengths)[:, None, None]
    )
    return corpus.with_fields(frames=(corpus.frames + noise).astype(np.uint16))


def svms(space=GRID, inner="2", **how):
    return Search({"svm": svm}, {"svm": space}, {"selected": SELECTED}, inner, **how)


def by_hand(corpus, folds):
    """Mean accuracy of the left-out subjects for every combination, with scikit-learn alone."""
    y, subjects = corpus.gestures, corpus.subjects
    hits = {point: np.zeros(len(y)) for point in itertools.product(*GRID.values())}
    for train, test in folds:
        learnt = clone(SELECTED).fit(corpus[train], y[train])
        for (C, gamma), hit in hits.items():
            machine = make_pipeline(MinMaxScaler(), SVC(C=C, gamma=gamma, break_ties=True))
            machine.fit(learnt.transform(corpus[train]).to_numpy(), y[train])
            hit[test] = machine.predict(learnt.transform(corpus[test]).to_numpy()) == y[test]
    return {
        point: np.mean([hit[subjects == s].mean() for s in set(subjects)])
        for point, hit in hits.items()
    }


@pytest.mark.parametrize(
    ("inner", "splitter"),
    [("2", GroupKFold(2, shuffle=True, random_state=0)), ("loso", LeaveOneGroupOut())],
)
def test_a_grid_is_searched_as_a_plain_loop_would(inner, splitter):
    corpus = noisy(subjects=5)
    subjects = corpus.subjects.astype(str)
    expected = by_hand(corpus, list(splitter.split(subjects, groups=subjects)))
    search = svms(inner=inner).fit(corpus, corpus.gestures)
    best = max(expected.values()) - 1e-9  # means that are summed in another order differ
    trials = search.trials_.set_index(["svm.C", "svm.gamma"])
    assert set(trials.index) == set(expected) and len(trials) == 6
    assert (search.chosen_["svm.C"], search.chosen_["svm.gamma"]) == min(
        k for k, v in expected.items() if v >= best
    )
    for point, row in trials[trials["state"] == "complete"].iterrows():
        assert row["accuracy"] == pytest.approx(expected[point]) and row["subjects"] == 5
    again = svm(clone(SELECTED), C=search.chosen_["svm.C"], gamma=search.chosen_["svm.gamma"]).fit(
        corpus, corpus.gestures
    )
    assert np.array_equal(search.predict_proba(corpus), again.predict_proba(corpus))
    assert count_parameters(search) == count_parameters(again) > 0


def test_what_is_taken_by_hand():
    """Losses to the best, subject by subject: 0.05 +- 0.029, 0 +- 0 and 0.025 +- 0.063."""
    rows = {
        0.5: [1.0],
        8.0: [0.9] * 4,
        1.0: [0.9, 0.8, 0.9, 0.8],
        4.0: [0.9] * 4,
        2.0: [0.9, 0.7, 1.0, 0.9],
    }
    trials = [
        FinishedTrial(
            {"model": "svm", "features": "selected", "svm.C": C},
            "complete" if len(shares) == 4 else "pruned",
            subjects=dict(enumerate(shares)),
        )
        for C, shares in rows.items()
    ]
    search = svms({"C": sorted(rows)})
    assert search._rank_trials(trials) == [3, 1, 4, 2]
    search.objective = "smallest"
    assert search._rank_trials(trials) == [4, 3, 1]


def test_test_subjects_change_nothing_that_is_chosen_or_learned_and_nothing_is_judged_again(
    tmp_path, monkeypatch
):
    """With the cache of features and the stored study on the way."""
    corpus, searches = noisy(), []
    test = np.flatnonzero(corpus.subjects == "2")
    for folder, captures in (("a", corpus), ("b", with_other_values(corpus, test))):
        write_folder(captures, tmp_path / folder)
        captures = open_folder(tmp_path / folder)[np.flatnonzero(corpus.subjects != "2")]
        search = Search(
            {"svm": svm}, {"svm": svm.space}, {"a": Jung28(), "b": Ta273()}, "2", trials=5
        )
        searches.append(search.fit(captures, captures.gestures))
    one, other = searches
    assert one.chosen_ == other.chosen_
    probe = random_corpus(seed=9)
    assert np.array_equal(one.predict_proba(probe), other.predict_proba(probe))
    assert set(one.trials_["features"]) == {"a", "b"}
    real, made = Search._make_model, []
    monkeypatch.setattr(
        Search, "_make_model", lambda self, *args: made.append(args) or real(self, *args)
    )
    again = clone(other).fit(captures, captures.gestures)
    assert len(made) == 1  # all are stored: only the last fit is made
    facts = ["state", "accuracy", "subjects"]
    pd.testing.assert_frame_equal(again.trials_[facts], other.trials_[facts])
    assert again.chosen_ == other.chosen_


def test_an_interrupted_search_goes_on_as_if_it_had_not_been(tmp_path, monkeypatch):
    corpus = noisy()
    write_folder(corpus, tmp_path / "stored")
    stored = open_folder(tmp_path / "stored")
    space, made = {"C": Range(1e-3, 1e3, log=True), "gamma": Range(1e-3, 1.0)}, []
    search = Search(
        {"svm": svm}, {"svm": space}, {"jung28": Jung28()}, "2", trials=13
    )  # ten are drawn blindly
    straight = clone(search).fit(corpus, corpus.gestures).trials_  # not stored

    def cut_off(self, *args, real=Search._make_model):
        made.append(args)
        if len(made) == 24:  # in the twelfth trial
            raise KeyboardInterrupt
        return real(self, *args)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Search, "_make_model", cut_off)
        clone(search).fit(stored, stored.gestures)
    (lock,) = (data_folder() / "studies").glob("*.lock")
    (lock.with_suffix("") / ".killed.pickle").write_bytes(
        b"half of a trial"
    )  # of a process that was killed
    resumed = search.fit(stored, stored.gestures).trials_
    pd.testing.assert_frame_equal(resumed.drop(columns="seconds"), straight.drop(columns="seconds"))
    assert straight["svm.C"].nunique() == 13  # they differ, or this shows nothing


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=6))
def test_a_trial_is_worse_if_a_signed_rank_test_over_the_subjects_so_far_says_so(pairs):
    mine, best = np.array(pairs).T / 4
    made = Study({"model": ["m"]}, {"m": {}}, 0, 9, np.inf, 0.0, {"cost": 1.0})
    step = iter(
        [
            FinishedTrial(
                {"model": "m"},
                "complete",
                subjects=dict.fromkeys(range(10), 1.0),
                costs={"cost": 2.0},
            ),  # too dear
            FinishedTrial({"model": "m"}, "complete", subjects=dict(enumerate([*best, 1.0]))),
            FinishedTrial({"model": "m"}, "large", subjects={"a": 99.0, "b": 99.0}),
        ]
    )
    made.judge_trials(lambda: next(step, None), {}, SimpleNamespace(digest=""), np.array([]))
    expected = (
        len(mine) > 1
        and wilcoxon(mine - best, alternative="less", zero_method="zsplit").pvalue < 0.1
    )
    expected = expected and mine.mean() < np.mean([*best, 1.0])
    assert (
        made.is_worse(FinishedTrial({"model": "m"}, "complete", subjects=dict(enumerate(mine))))
        == expected
    )
