"""The nested search: against a plain loop over grid and folds, interrupted and resumed, and blind to test subjects."""

import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import BaseEstimator
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut
from sklearn.preprocessing import MinMaxScaler
from sklearn.svm import SVC

from bench.corpora.folder import open_folder, write_folder
from bench.errors import InputError
from bench.pareto import front
from bench.scratch import home
from features.balli import Balli
from features.hughes36 import Hughes36
from features.jung28 import Jung28
from features.ta273 import Ta273
from models.classic.jung2014 import jung2014_svm
from models.classic.rf import et, rf
from models.classic.svm import svm
from models.nets.cnn85 import CNN85
from models.search import study, tuning
from models.search.inner_folds import inner_folds
from models.search.space import Range
from models.search.tuning import Search
from models.sizes import parameter_count
from tests.conftest import random_corpus, with_other_values

GRID = {"C": [0.125, 8.0, 512.0], "gamma": [0.01, 1.0]}


def noisy(subjects=5, **kwargs):
    """Captures whose classes overlap, so that parameters matter."""
    corpus = random_corpus(subjects=subjects, per_class=4, **kwargs)
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 120, len(corpus)).repeat(corpus.lengths)[:, None, None]
    return corpus.changed(frames=(corpus.frames + noise).astype(np.uint16))


def stored(corpus, tmp_path):
    write_folder(corpus, tmp_path / "corpus")
    return open_folder(tmp_path / "corpus")


def by_hand(corpus, folds):
    """Mean accuracy of the left-out subjects for every combination, with scikit-learn alone."""
    X, y, subjects = Jung28().transform(corpus).to_numpy(), corpus.gestures, corpus.subjects
    scores = {}
    for C in GRID["C"]:
        for gamma in GRID["gamma"]:
            found = {}
            for train, test in folds:
                scaler = MinMaxScaler().fit(X[train])
                machine = SVC(C=C, gamma=gamma, break_ties=True).fit(scaler.transform(X[train]), y[train])
                hit = machine.predict(scaler.transform(X[test])) == y[test]
                found |= {s: hit[subjects[test] == s].mean() for s in set(subjects[test])}
            scores[C, gamma] = np.mean(list(found.values()))
    return scores


@pytest.mark.parametrize("inner", ["2", "3", "loso"])
def test_a_grid_is_searched_as_a_plain_loop_would(inner):
    corpus = noisy()
    subjects = corpus.subjects.astype(str)
    splitter = LeaveOneGroupOut() if inner == "loso" else GroupKFold(int(inner), shuffle=True, random_state=0)
    expected = by_hand(corpus, list(splitter.split(subjects, groups=subjects)))
    search = Search({"svm": svm}, {"svm": GRID}, {"jung28": Jung28()}, inner).fit(corpus, corpus.gestures)
    best = max(expected.values())
    assert len(search.trials_) == 6
    assert (search.chosen_["svm.C"], search.chosen_["svm.gamma"]) == min(k for k, v in expected.items() if v == best)
    whole = search.trials_[search.trials_["state"] == "complete"]
    for row in whole.itertuples():
        params = search.trials_.loc[row.Index]
        assert row.accuracy == pytest.approx(expected[params["svm.C"], params["svm.gamma"]])
    again = svm(Jung28(), C=search.chosen_["svm.C"], gamma=search.chosen_["svm.gamma"]).fit(corpus, corpus.gestures)
    assert np.array_equal(search.predict_proba(corpus), again.predict_proba(corpus))
    assert parameter_count(search) == parameter_count(again) > 0


@given(st.lists(st.integers(0, 6), min_size=2, max_size=40), st.sampled_from(["2", "3", "7", "loso"]))
def test_inner_folds_keep_subjects_apart_and_test_everybody_once(who, inner):
    subjects = np.array(who).astype(str)
    if len(set(who)) == 1:
        with pytest.raises(InputError, match="there is 1; train on more"):
            inner_folds(subjects, inner)
        return
    folds = inner_folds(subjects, inner)
    for train, test in folds:
        assert not set(subjects[train]) & set(subjects[test])
        assert sorted([*train, *test]) == list(range(len(who)))
    assert sorted(np.concatenate([test for _, test in folds])) == list(range(len(who)))
    assert len(folds) == (len(set(who)) if inner == "loso" else min(int(inner), len(set(who))))


def test_bad_combinations_are_given_up_and_never_chosen():
    corpus = noisy(subjects=12)
    grid = {"C": [1.0, 8.0], "gamma": [1.0, 2.0**20, 2.0**21, 2.0**22]}  # the wide ones know their captures by heart
    searches = [Search({"svm": svm}, {"svm": grid}, {"jung28": Jung28()}, "3", seed=seed) for seed in range(50)]
    good = [s for s in searches if (s._given(0)["svm.C"], s._given(0)["svm.gamma"]) == (8.0, 1.0)]
    search = good[0].fit(corpus, corpus.gestures)  # begins with the best, so that the others can be told to be worse
    cut = search.trials_[search.trials_["state"] == "pruned"]
    assert len(cut) > 0 and (cut["subjects"] < 12).all() and not cut["front"].any()
    assert search.chosen_["svm.gamma"] == 1.0


@pytest.mark.parametrize("after", [1, 3])
@pytest.mark.parametrize("space", [GRID, {"C": Range(0.01, 1e3, log=True), "gamma": [0.1, 1.0]}])
def test_an_interrupted_search_goes_on_and_chooses_the_same(tmp_path, monkeypatch, space, after):
    corpus = stored(noisy(), tmp_path)
    search = lambda: Search({"svm": svm}, {"svm": space}, {"jung28": Jung28()}, "2", trials=6)  # noqa: E731
    straight = search().fit(corpus[corpus.subjects != "5"], corpus.gestures[corpus.subjects != "5"])
    (home() / "studies").rename(home() / "gone")
    made = 0
    real = tuning.Search._make

    def make(self, *args):
        nonlocal made
        made += 1
        if made == 2 * after + 2:  # in the middle of a combination
            raise KeyboardInterrupt
        return real(self, *args)

    monkeypatch.setattr(tuning.Search, "_make", make)
    with pytest.raises(KeyboardInterrupt):
        search().fit(corpus[corpus.subjects != "5"], corpus.gestures[corpus.subjects != "5"])
    before = made
    resumed = search().fit(corpus[corpus.subjects != "5"], corpus.gestures[corpus.subjects != "5"])
    told = ["svm.C", "svm.gamma", "state", "accuracy", "subjects"]
    pd.testing.assert_frame_equal(resumed.trials_[told], straight.trials_[told])
    assert resumed.chosen_ == straight.chosen_
    done = made - before
    made = -1000
    search().fit(corpus[corpus.subjects != "5"], corpus.gestures[corpus.subjects != "5"])
    assert made == -999 and done < 14  # all stored: only the last fit is made


@pytest.mark.parametrize("cut", [1, 2, 3, 4, 6, 8, 11])
def test_a_search_cut_off_between_two_values_goes_on_with_the_same_ones(tmp_path, monkeypatch, cut):
    import optuna

    corpus = stored(noisy(), tmp_path)
    space = {"C": Range(0.01, 1e3, log=True), "gamma": Range(0.01, 1.0)}
    search = lambda: Search({"svm": svm}, {"svm": space}, {"jung28": Jung28()}, "2", trials=4)  # noqa: E731
    straight = search().fit(corpus, corpus.gestures).trials_
    (home() / "studies").rename(home() / "gone")
    storage = optuna.storages.JournalStorage
    real, calls = storage.set_trial_param, []

    def stop(self, *args):
        calls.append(1)
        if len(calls) == cut:
            raise KeyboardInterrupt
        return real(self, *args)

    monkeypatch.setattr(storage, "set_trial_param", stop)
    with pytest.raises(KeyboardInterrupt):
        search().fit(corpus, corpus.gestures)
    monkeypatch.setattr(storage, "set_trial_param", real)
    resumed = search().fit(corpus, corpus.gestures).trials_
    told = ["svm.C", "svm.gamma", "state", "accuracy"]
    pd.testing.assert_frame_equal(resumed[told], straight[told])


def test_a_cut_line_and_a_lock_of_a_killed_process_do_no_harm(tmp_path):
    corpus = stored(noisy(), tmp_path)
    search = lambda trials: Search({"svm": svm}, {"svm": svm.space}, {"jung28": Jung28()}, "2", trials=trials)  # noqa: E731
    longer = search(4).fit(corpus, corpus.gestures)
    (path,) = (home() / "studies").glob("*.journal")
    path.write_bytes(path.read_bytes()[:-7])
    path.with_suffix(".journal.lock").write_text("")
    started = time.perf_counter()
    again = search(4).fit(corpus, corpus.gestures)
    assert time.perf_counter() - started < 15  # Optuna's own lock would wait 30 s
    assert again.chosen_ == longer.chosen_ and len(again.trials_) == 4


def test_a_shorter_search_is_not_answered_by_a_longer_one(tmp_path):
    corpus = stored(noisy(), tmp_path)
    search = lambda **how: Search({"svm": svm}, {"svm": svm.space}, {"jung28": Jung28()}, "2", **how)  # noqa: E731
    short = search(trials=2).fit(corpus, corpus.gestures)
    whole = search(trials=6).fit(corpus, corpus.gestures)
    assert len(whole.trials_) == 6
    again = search(trials=2).fit(corpus, corpus.gestures)
    assert again.chosen_ == short.chosen_ and len(again.trials_) == 2
    seconds = whole.trials_["seconds"].cumsum()
    assert len(search(budget=float(seconds[2]) - 1e-6).fit(corpus, corpus.gestures).trials_) == 3


def test_studies_that_cannot_be_written_only_cost_time(tmp_path):
    corpus = stored(noisy(), tmp_path)
    home().mkdir(exist_ok=True)
    (home() / "studies").write_text("in the way")
    assert len(Search({"svm": svm}, {"svm": GRID}, {"jung28": Jung28()}, "2").fit(corpus, corpus.gestures).trials_) == 6


@pytest.mark.parametrize("learnt", [Ta273(), Balli(5), Hughes36(states=2, iterations=2, epochs=1)])
def test_learnt_features_never_see_the_subjects_that_judge(learnt):
    corpus = noisy(subjects=4)
    folds = inner_folds(corpus.subjects.astype(str), "2")
    judges = folds[0][1]
    labels = corpus.gestures.copy()
    labels[judges] = "pat"
    other = with_other_values(corpus, judges)
    tables = [
        tuning.Tables({"f": learnt}, c, y, folds).train("f", 0) for c, y in ((corpus, corpus.gestures), (other, labels))
    ]
    pd.testing.assert_frame_equal(*tables)


def test_what_cannot_be_judged_is_told():
    corpus = noisy(subjects=2)
    one_each = corpus[((corpus.subjects == "1") & (corpus.gestures == "pat")) | (corpus.subjects == "2")]
    with pytest.raises(InputError, match="which here leaves one class"):
        Search({"svm": svm}, {"svm": GRID}, {"jung28": Jung28()}, "2").fit(one_each, one_each.gestures)


def test_a_study_belongs_to_captures_labels_space_and_code(tmp_path, monkeypatch):
    corpus = stored(noisy(), tmp_path)
    search = Search({"svm": svm}, {"svm": GRID}, {"jung28": Jung28()}, "2")
    other = Search({"svm": svm}, {"svm": GRID | {"C": [8.0]}}, {"jung28": Jung28()}, "2")
    features = {"jung28": Jung28()}
    searches = [
        search,
        other,
        Search({"svm": svm}, {"svm": GRID}, {"ta273": Ta273()}, "2"),
        Search({"svm": svm}, {"svm": GRID}, features, "3"),
        Search({"svm": svm}, {"svm": GRID}, features, "2", seed=1),
        Search({"svm": svm}, {"svm": GRID}, features, "2", objective="accuracy+time"),
        Search({"svm": rf}, {"svm": GRID}, features, "2"),
        Search({"svm": et}, {"svm": GRID}, features, "2"),
        Search({"svm": partial(svm, C=1.0)}, {"svm": GRID}, features, "2"),
        Search({"svm": partial(svm, C=2.0)}, {"svm": GRID}, features, "2"),
    ]
    keys = {study.study_name(each.study_key(), corpus, corpus.gestures) for each in searches}
    keys.add(study.study_name(search.study_key(), corpus[1:], corpus.gestures[1:]))
    keys.add(study.study_name(search.study_key(), corpus, corpus.gestures[::-1]))
    assert len(keys) == 12
    monkeypatch.setattr(study, "source_digest", lambda part: "changed")
    assert study.study_name(search.study_key(), corpus, corpus.gestures) not in keys


def test_a_budget_ends_the_search():
    corpus = noisy()
    drawn = {"C": Range(0.01, 1e3, log=True), "gamma": [0.1, 1.0]}
    search = Search({"svm": svm}, {"svm": drawn}, {"jung28": Jung28()}, budget=1e-9)
    assert len(search.fit(corpus, corpus.gestures).trials_) == 1
    search.budget = float("inf")
    with pytest.raises(InputError, match="this search has no end"):
        search.check()


def test_the_fastest_of_those_that_are_as_good_is_taken():
    corpus = random_corpus(subjects=5, per_class=4)  # easy: one tree is as good as 200
    models = {"few": lambda features, seed=0: rf(features, trees=2, seed=seed), "many": rf}
    spaces = {"few": {}, "many": {"trees": [200]}}
    search = Search(models, spaces, {"jung28": Jung28()}, "2", trials=6, objective="accuracy+time")
    search.fit(corpus, corpus.gestures)
    assert set(search.trials_["model"]) == {"few", "many"}
    assert search.chosen_["model"] == "few"
    assert (search.trials_["state"] == "complete").all() and search.trials_["predict_ms"].notna().all()


def test_huge_lists_are_checked_value_by_value():
    """Ten lists of ten values are ten thousand million combinations."""
    made = []

    class Many(BaseEstimator):
        def __init__(self, **values):
            made.append(values)

        def check(self):
            if made[-1].get("p9") == 7:
                raise InputError("7 cannot be")

    search = Search({"many": Many}, {"many": {f"p{i}": list(range(10)) for i in range(10)}}, trials=3, inner="2")
    corpus = random_corpus()
    with pytest.raises(InputError, match="7 cannot be"):
        search.check_training(corpus, corpus.gestures)
    assert len(made) <= 100


def test_one_standard_error_by_hand():
    """The fastest whose mean loss to the best, subject by subject, is within its standard error."""
    accuracy = {0: [0.9, 0.9, 0.9, 0.9], 1: [0.9, 0.8, 0.9, 0.8], 2: [0.9, 0.7, 1.0, 0.9], 3: [0.1, 0.1, 0.1, 0.1]}
    spent = {0: 9.0, 1: 1.0, 2: 5.0, 3: 0.1}  # losses: 1 is 0.05 +- 0.029, 2 is 0.025 +- 0.063, 3 is 0.8 +- 0
    finished = [
        SimpleNamespace(
            params={"model": "svm", "features": "f", "svm.C": 2.0**i},
            user_attrs={"subjects": dict(zip("abcd", accuracy[i], strict=True)), "predict_ms": spent[i]},
        )
        for i in accuracy
    ]
    search = Search({"svm": svm}, {"svm": {"C": [1.0, 2.0, 4.0, 8.0]}}, {"f": Jung28()}, objective="accuracy+time")
    assert search._ranked(finished, list("abcd"))[0] == 2
    search.objective = "accuracy"
    assert search._ranked(finished[::-1], list("abcd")) == [3, 1, 2, 0]


def test_of_equal_combinations_the_earliest_values_are_taken():
    same = {"subjects": {"a": 0.5, "b": 0.5}}
    params = [{"model": "svm", "features": "f", "svm.C": c} for c in (4.0, 1.0, 2.0)]
    finished = [SimpleNamespace(params=p, user_attrs=same) for p in params]
    search = Search({"svm": svm}, {"svm": {"C": [1.0, 2.0, 4.0]}}, {"f": Jung28()})
    assert search._ranked(finished, ["a", "b"]) == [1, 2, 0]


def test_the_front_by_hand():
    accuracy = np.array([0.9, 0.8, 0.8, 0.7, 0.95, 0.9])
    cost = np.array([3.0, 1.0, 2.0, 1.0, np.nan, 3.0])
    assert front(accuracy, cost).tolist() == [True, True, False, False, False, True]


def test_raw_frames_are_searched_too():
    corpus = random_corpus(subjects=4, per_class=2, longest=12)
    space = {"frames": [5, 8], "epochs": [2], "batch": [8]}
    search = Search({"cnn85": CNN85}, {"cnn85": space}, inner="2").fit(corpus, corpus.gestures)
    assert search.chosen_["cnn85.frames"] in (5, 8) and search.best_.frames == search.chosen_["cnn85.frames"]
    table, proba = search.decide(corpus)
    assert len(table) == len(proba) >= len(corpus)


SEARCHES = {
    "grid": lambda: Search({"svm": svm}, {"svm": GRID}, {"jung28": Jung28()}, "2"),
    "learnt features": lambda: Search({"svm": svm}, {"svm": GRID}, {"ta273": Ta273()}, "2"),
    "published": lambda: jung2014_svm("2"),
    "two sets, two models": lambda: Search(
        {"svm": svm, "et": et},
        {"svm": svm.space, "et": {"trees": [20]}},
        {"a": Jung28(), "b": Ta273()},
        "2",
        trials=4,
    ),
}


@pytest.mark.parametrize("name", SEARCHES)
def test_test_subjects_change_nothing_that_is_chosen_or_learned(name):
    corpus = noisy(subjects=4)
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    other = with_other_values(corpus, test)
    probe = random_corpus(seed=9)
    found = [SEARCHES[name]().fit(c[train], c.gestures[train]) for c in (corpus, other)]
    assert found[0].chosen_ == found[1].chosen_
    assert np.array_equal(*(search.predict_proba(probe) for search in found))


def test_a_stored_corpus_leaks_nothing_through_tables_and_studies(tmp_path):
    """The same, with the cache of features and the stored study on the way."""
    corpus = noisy(subjects=4)
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    other = with_other_values(corpus, test)
    found = []
    for name, c in (("a", corpus), ("b", other)):
        write_folder(c, tmp_path / name)
        c = open_folder(tmp_path / name)
        found.append(SEARCHES["learnt features"]().fit(c[train], c.gestures[train]))
    assert found[0].chosen_ == found[1].chosen_
    assert len(list((home() / "features").iterdir())) == len(list((home() / "studies").glob("*.journal"))) == 2
    probe = random_corpus(seed=9)
    assert np.array_equal(*(search.predict_proba(probe) for search in found))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"inner": "1"}, "model.inner=1: give a number of subject groups"),
        ({"inner": "all"}, "model.inner=all: give"),
        ({"trials": 0}, "model.trials=0: give at least 1"),
        ({"budget": 0.0}, "model.budget=0: give"),
        ({"objective": "time"}, "model.objective=time: give accuracy"),
    ],
)
def test_searches_that_cannot_be(wrong, message):
    with pytest.raises(InputError, match=message):
        Search({"svm": svm}, {"svm": GRID}, {"jung28": Jung28()}, **wrong).check()


def test_jung2014_searches_a_linear_machine():
    corpus = noisy(subjects=4)
    chosen = jung2014_svm("2").fit(corpus, corpus.gestures)
    assert chosen.best_[-1].kernel == "linear" and len(chosen.trials_) == 11
