"""The nested search: against a plain loop over grid and folds, resumed, and blind to test subjects."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler
from sklearn.svm import SVC

from bench.corpora.folder import open_folder, write_folder
from bench.errors import InputError
from bench.features.balli import Balli
from bench.features.jung28 import Jung28
from bench.features.ta273 import Ta273
from bench.models.classic.svm import svm
from bench.models.search.inner_folds import Tables, inner_folds
from bench.models.search.study import Tried
from bench.models.search.tuning import Search
from bench.models.sizes import parameter_count
from bench.models.space import Range
from bench.scratch import home
from tests.conftest import random_corpus, with_other_values

GRID = {"C": [0.125, 8.0, 512.0], "gamma": [0.01, 1.0]}


def noisy(subjects=5, **kwargs):
    """Captures whose classes overlap, so that parameters matter."""
    corpus = random_corpus(subjects=subjects, per_class=4, **kwargs)
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 120, len(corpus)).repeat(corpus.lengths)[:, None, None]
    return corpus.changed(frames=(corpus.frames + noise).astype(np.uint16))


def svms(space=GRID, inner="2", features=None, **how):
    return Search({"svm": svm}, {"svm": space}, features or {"jung28": Jung28()}, inner, **how)


def by_hand(corpus, folds):
    """Mean accuracy of the left-out subjects for every combination, with scikit-learn alone."""
    X, y, subjects = Jung28().transform(corpus).to_numpy(), corpus.gestures, corpus.subjects
    scores = {}
    for C, gamma in itertools.product(GRID["C"], GRID["gamma"]):
        hits = np.zeros(len(y))
        for train, test in folds:
            machine = make_pipeline(MinMaxScaler(), SVC(C=C, gamma=gamma, break_ties=True)).fit(X[train], y[train])
            hits[test] = machine.predict(X[test]) == y[test]
        scores[C, gamma] = np.mean([hits[subjects == s].mean() for s in set(subjects)])
    return scores


@pytest.mark.parametrize("inner", ["2", "loso"])
def test_a_grid_is_searched_as_a_plain_loop_would(inner):
    corpus = noisy()
    subjects = corpus.subjects.astype(str)
    splitter = LeaveOneGroupOut() if inner == "loso" else GroupKFold(int(inner), shuffle=True, random_state=0)
    expected = by_hand(corpus, list(splitter.split(subjects, groups=subjects)))
    search = svms(inner=inner).fit(corpus, corpus.gestures)
    best = max(expected.values())
    trials = search.trials_.set_index(["svm.C", "svm.gamma"])
    assert set(trials.index) == set(expected) and len(trials) == 6
    assert (search.chosen_["svm.C"], search.chosen_["svm.gamma"]) == min(k for k, v in expected.items() if v == best)
    for point, row in trials[trials["state"] == "complete"].iterrows():
        assert row["accuracy"] == pytest.approx(expected[point]) and row["subjects"] == 5
    fewest = {"C": Range(0.01, 1e3, log=True), "gamma": [0.1, 1.0]}
    assert len(svms(fewest, inner=inner, seconds=1e-9).fit(corpus, corpus.gestures).trials_) == 1  # a budget ends it
    again = svm(Jung28(), C=search.chosen_["svm.C"], gamma=search.chosen_["svm.gamma"]).fit(corpus, corpus.gestures)
    assert np.array_equal(search.predict_proba(corpus), again.predict_proba(corpus))
    assert parameter_count(search) == parameter_count(again) > 0


@given(st.lists(st.integers(0, 6), min_size=2, max_size=40), st.sampled_from(["2", "3", "7", "loso"]))
def test_inner_folds_keep_subjects_apart_and_test_everybody_once(who, inner):
    subjects = np.array(who).astype(str)
    if len(set(who)) == 1:
        with pytest.raises(InputError, match="there is 1"):
            inner_folds(subjects, inner)
        return
    folds = inner_folds(subjects, inner)
    for train, test in folds:
        assert not set(subjects[train]) & set(subjects[test])
        assert sorted([*train, *test]) == list(range(len(who)))
    assert sorted(np.concatenate([test for _, test in folds])) == list(range(len(who)))
    assert len(folds) == (len(set(who)) if inner == "loso" else min(int(inner), len(set(who))))


@pytest.mark.parametrize("features", [Ta273(), Balli(5)])
def test_learnt_features_never_see_the_subjects_that_judge(features):
    corpus = noisy(subjects=4)
    folds = inner_folds(corpus.subjects.astype(str), "2")
    judges = folds[0][1]
    labels = corpus.gestures.copy()
    labels[judges] = "pat"
    tables = [
        Tables({"f": features}, X, y, folds).part("f", 0, 0)
        for X, y in ((corpus, corpus.gestures), (with_other_values(corpus, judges), labels))
    ]
    pd.testing.assert_frame_equal(*tables)


def test_what_is_taken_by_hand():
    """Losses to the best, subject by subject: 0.05 +- 0.029, 0 +- 0 and 0.025 +- 0.063."""

    def tried(C, state, *shares):
        return Tried({"model": "svm", "features": "f", "svm.C": C}, state, subjects=dict(enumerate(shares)))

    trials = [
        tried(0.5, "pruned", 1.0),
        tried(8.0, "complete", 0.9, 0.9, 0.9, 0.9),
        tried(1.0, "complete", 0.9, 0.8, 0.9, 0.8),
        tried(4.0, "complete", 0.9, 0.9, 0.9, 0.9),
        tried(2.0, "complete", 0.9, 0.7, 1.0, 0.9),
    ]
    search = svms({"C": [0.5, 1.0, 2.0, 4.0, 8.0]}, features={"f": Jung28()})
    assert search._ranked(trials) == [3, 1, 4, 2]
    search.objective = "smallest"
    assert search._ranked(trials) == [4, 3, 1]


def test_test_subjects_change_nothing_that_is_chosen_or_learned_and_nothing_is_judged_again(tmp_path, monkeypatch):
    """With the cache of features and the stored study on the way."""
    corpus = noisy(subjects=4)
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    features = {"a": Jung28(), "b": Ta273()}
    searches = []
    for folder, captures in (("a", corpus), ("b", with_other_values(corpus, test))):
        write_folder(captures, tmp_path / folder)
        captures = open_folder(tmp_path / folder)[train]
        search = Search({"svm": svm}, {"svm": svm.space}, features, "2", trials=5)
        searches.append(search.fit(captures, captures.gestures))
    one, other = searches
    assert one.chosen_ == other.chosen_
    probe = random_corpus(seed=9)
    assert np.array_equal(one.predict_proba(probe), other.predict_proba(probe))
    assert len(list((home() / "studies").glob("*/000005.pickle"))) == 2 and set(one.trials_["features"]) == {"a", "b"}
    real, made = Search._made, []
    monkeypatch.setattr(Search, "_made", lambda self, *args: made.append(args) or real(self, *args))
    again = clone(other).fit(captures, captures.gestures)
    assert len(made) == 1  # all are stored: only the last fit is made
    facts = ["state", "accuracy", "subjects"]
    pd.testing.assert_frame_equal(again.trials_[facts], other.trials_[facts])
    assert again.chosen_ == other.chosen_
