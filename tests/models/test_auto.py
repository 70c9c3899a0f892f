"""The search over everything: judged as a plain loop would, within its limits, resumed, blind to others."""

import pickle

import numpy as np
import pytest
from sklearn.model_selection import GroupKFold
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from bench.corpora.folder import open_folder, write_folder
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.search import portfolio
from bench.models.search.auto import Auto
from bench.models.search.ensemble import tempered
from tests.conftest import random_corpus, with_other_values

QUICK = [
    {"model": "lda", "lda.shrinkage": 0.5},
    {"model": "svm", "svm.scaling": "z", "svm.C": 10.0, "svm.gamma": 0.001},
    {"model": "lda", "window": 0.05, "columns": 0.25},
]
BEFORE = {"window": [0.0, 0.05], "repair": [""], "faults": [""], "scale": ["none"], "columns": [1.0, 0.5, 0.25]}


@pytest.fixture
def quick(monkeypatch):
    few = {m: space for m, space in portfolio.SPACES.items() if m in ("lda", "svm", "softmax")}
    models = {m: portfolio.MODELS[m] for m in few}
    for name, value in {"FIRST": QUICK, "BEFORE": BEFORE, "SPACES": few, "MODELS": models}.items():
        monkeypatch.setattr(portfolio, name, value)


def noisy(subjects=4, longest=15, **kwargs):
    corpus = random_corpus(subjects=subjects, per_class=3, longest=longest, **kwargs)
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 160, len(corpus.frames))[:, None, None]
    return corpus.changed(frames=(corpus.frames + noise).astype(np.uint16))


def stored(corpus, folder):
    write_folder(corpus, folder)
    return open_folder(folder)


def searched(corpus, trials=5, **kwargs):
    return Auto(seconds=float("inf"), trials=trials, inner="2", **kwargs).fit(corpus, corpus.gestures)


def test_a_trial_is_judged_as_a_plain_loop_would(quick):
    corpus = noisy()
    X, y, who = TouchFeatures().transform(corpus).to_numpy(), corpus.gestures, corpus.subjects.astype(str)
    hits = np.zeros(len(corpus))
    for train, test in GroupKFold(2, shuffle=True, random_state=0).split(X, groups=who):
        scaler = StandardScaler().fit(X[train])
        machine = SVC(C=10, gamma=0.001, break_ties=True).fit(scaler.transform(X[train]), y[train])
        hits[test] = machine.predict(scaler.transform(X[test])) == y[test]
    trial = searched(corpus, 2).trials_.loc[1]
    assert trial["state"] == "complete" and trial["subjects"] == 4
    assert trial["accuracy"] == pytest.approx(np.mean([hits[who == s].mean() for s in np.unique(who)]))


def test_what_decides_is_what_was_picked_fitted_to_everybody(quick):
    corpus = noisy()
    search = searched(corpus, 6)
    trials = search.trials_
    chosen = trials[trials["weight"] > 0]
    assert chosen["weight"].sum() == pytest.approx(1) and (chosen["state"] == "complete").all()
    assert sum(name.isdecimal() for name in search.chosen_) == len(search.best_.members) == len(chosen) <= 5
    members = zip(search.best_.members, search.best_.weights, search.best_.temperatures, strict=True)
    mean = sum(w * tempered(m.predict_proba(corpus), t) for m, w, t in members)
    np.testing.assert_allclose(search.predict_proba(corpus), mean)
    heaviest = trials.loc[trials["weight"].idxmax()]
    again = portfolio.system(dict(heaviest.dropna()), seed=0).fit(corpus, corpus.gestures)
    assert np.array_equal(search.best_.members[0].predict_proba(corpus), again.predict_proba(corpus))
    assert trials.loc[trials["state"] == "complete", ["flash_bytes", "ram_bytes", "predict_ms"]].notna().all(axis=None)
    assert search.trained_faults == () and len(Auto().trained_faults) > 10
    saved = pickle.loads(pickle.dumps(search))
    assert np.array_equal(saved.predict_proba(corpus), search.predict_proba(corpus))


def test_limits_hold_for_what_is_fitted_to_everybody(quick):
    corpus = noisy()
    least = searched(corpus, 3).trials_["flash_bytes"].min() / 1e3
    small = searched(corpus, 3, max_flash=f"{1.05 * least}kB")
    assert len(small.best_.members) == 1 and (small.trials_["state"] == "large").any()
    with pytest.raises(InputError, match="the least of 3 are flash_bytes"):
        searched(corpus, 3, max_flash="1B")
    short = Auto(seconds=1e-9, inner="2").fit(corpus, corpus.gestures)
    assert len(short.trials_) == 1  # however short the time, one is judged and decides


def test_other_people_change_nothing(tmp_path, monkeypatch):
    windowed = {"model": "lda", "window": 0.5, "faults": "all", "columns": 0.25}
    monkeypatch.setattr(portfolio, "FIRST", [QUICK[0], windowed])
    corpus = noisy(longest=60)
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    others = with_other_values(corpus, test)
    one, other = (searched(stored(c, tmp_path / name)[train], 2) for name, c in (("a", corpus), ("b", others)))
    assert one.chosen_ == other.chosen_
    probe = random_corpus(seed=9)
    assert np.array_equal(one.predict_proba(probe), other.predict_proba(probe))


def test_a_trial_that_fails_is_listed_and_the_others_go_on(quick, monkeypatch, tmp_path):
    def fails(**values):
        raise FloatingPointError("not today")

    fails.__wrapped__ = portfolio.MODELS["svm"]  # its signature
    monkeypatch.setitem(portfolio.MODELS, "svm", fails)
    corpus = stored(noisy(), tmp_path / "corpus")
    for _ in range(2):  # judged, then stored
        search = searched(corpus, 3)
        assert search.trials_["state"].tolist() == ["complete", "failed", "complete"]
        assert search.trials_["weight"][1] == 0
        assert search.chosen_["failed"] == 1 and "FloatingPointError: not today" in search.chosen_["error"]
    monkeypatch.setattr(portfolio, "FIRST", QUICK[1:2])
    with pytest.raises(RuntimeError, match="not today"):
        searched(corpus.detached(), 1)
