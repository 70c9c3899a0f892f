"""The search over everything: scores against a plain loop, limits, and the ensemble."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import GroupKFold
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.search import portfolio
from bench.models.search.auto import Auto
from bench.models.search.ensemble import (
    apply_temperature,
    fit_temperature,
    log_probabilities,
    select_ensemble,
)
from tests.models.test_tuning import noisy

QUICK = [
    {"model": "lda", "lda.shrinkage": 0.5},
    {"model": "svm", "svm.scaling": "z", "svm.C": 10.0, "svm.gamma": 0.001},
    {"model": "lda", "window": 0.05, "columns": 0.25},
]
BEFORE = {
    "window": [0.0, 0.05],
    "repair": [""],
    "faults": [""],
    "scale": ["none"],
    "columns": [1.0, 0.5, 0.25],
}


@pytest.fixture(scope="module", autouse=True)
def quick():
    """Few models, which learn fast."""
    few = {m: space for m, space in portfolio.SPACES.items() if m in ("lda", "svm", "softmax")}
    models = {m: portfolio.MODELS[m] for m in few}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "FIRST_TRIALS": QUICK,
            "STEP_SPACE": BEFORE,
            "SPACES": few,
            "MODELS": models,
        }.items():
            patch.setattr(portfolio, name, value)
        yield


def searched(corpus, trials, **kwargs):
    return Auto(seconds=float("inf"), trials=trials, inner="2", **kwargs).fit(
        corpus, corpus.gestures
    )


@pytest.fixture(scope="module")
def search(quick):
    return searched(noisy(), 6)


def test_a_trial_is_judged_as_a_plain_loop_would(search):
    corpus = noisy()
    X, y, who = (
        TouchFeatures().transform(corpus).to_numpy(),
        corpus.gestures,
        corpus.subjects.astype(str),
    )
    hits = np.zeros(len(corpus))
    for train, test in GroupKFold(2, shuffle=True, random_state=0).split(X, groups=who):
        scaler = StandardScaler().fit(X[train])
        machine = SVC(C=10, gamma=0.001, break_ties=True).fit(scaler.transform(X[train]), y[train])
        hits[test] = machine.predict(scaler.transform(X[test])) == y[test]
    trial = search.trials_.loc[1]
    assert trial["state"] == "complete" and trial["subjects"] == 4
    assert trial["accuracy"] == pytest.approx(
        np.mean([hits[who == s].mean() for s in np.unique(who)])
    )


def test_what_decides_is_what_was_picked_fitted_to_everybody(search):
    corpus, trials = noisy(), search.trials_
    chosen = trials[trials["weight"] > 0]
    assert chosen["weight"].sum() == pytest.approx(1) and (chosen["state"] == "complete").all()
    assert (
        sum(name.isdecimal() for name in search.chosen_)
        == len(search.best_.members)
        == len(chosen)
        <= 5
    )
    members = zip(
        search.best_.members, search.best_.weights, search.best_.temperatures, strict=True
    )
    mean = sum(w * apply_temperature(m.predict_proba(corpus), t) for m, w, t in members)
    np.testing.assert_allclose(search.predict_proba(corpus), mean)
    heaviest = trials.loc[trials["weight"].idxmax()]
    again = portfolio.make_system(dict(heaviest.dropna()), seed=0).fit(corpus, corpus.gestures)
    assert np.array_equal(
        search.best_.members[0].predict_proba(corpus), again.predict_proba(corpus)
    )
    assert (
        trials.loc[trials["state"] == "complete", ["flash_bytes", "ram_bytes", "predict_ms"]]
        .notna()
        .all(axis=None)
    )
    assert search.trained_faults == () and len(Auto().trained_faults) > 10
    saved = pickle.loads(pickle.dumps(search))
    assert np.array_equal(saved.predict_proba(corpus), search.predict_proba(corpus))


def test_limits_hold_for_what_is_fitted_to_everybody(search):
    corpus = noisy()
    least = search.trials_["flash_bytes"][:3].min() / 1e3
    small = searched(corpus, 3, max_flash=f"{1.05 * least}kB")
    assert len(small.best_.members) == 1 and (small.trials_["state"] == "large").any()
    with pytest.raises(InputError, match="the least of 1 are flash_bytes"):
        searched(corpus, 1, max_flash="1B")
    short = Auto(seconds=1e-9, inner="2").fit(corpus, corpus.gestures)
    assert len(short.trials_) == 1  # however short the time, one is judged and decides


def test_a_trial_that_fails_is_listed_and_the_others_go_on(monkeypatch):
    def fails(**values):
        raise FloatingPointError("not today")

    fails.__wrapped__ = portfolio.MODELS["svm"]  # its signature
    monkeypatch.setitem(portfolio.MODELS, "svm", fails)
    search = searched(noisy(), 3)
    assert (
        search.trials_["state"].tolist() == ["complete", "failed", "complete"]
        and search.trials_["weight"][1] == 0
    )
    assert (
        search.chosen_["failed"] == 1 and "FloatingPointError: not today" in search.chosen_["error"]
    )
    monkeypatch.setattr(portfolio, "FIRST_TRIALS", QUICK[1:2])
    with pytest.raises(RuntimeError, match="not today"):
        searched(noisy(), 1)


# Which trials decide together


def drawn(seed, members=3, captures=30, classes=3):
    rng = np.random.default_rng(seed)
    codes = rng.integers(classes, size=captures)
    proba = rng.dirichlet(np.ones(classes), (members, captures))
    proba[:, np.arange(captures), codes] += rng.random((members, 1))
    return (
        proba / proba.sum(axis=2, keepdims=True),
        codes,
        rng.integers(4, size=captures).astype(str),
    )


@given(st.integers(0, 200), st.sampled_from([1, 2, 3]))
def test_each_pick_is_the_best_next_one_that_is_allowed(seed, most):
    proba, codes, subjects = drawn(seed)

    def loss_of(picks):  # mean of the subjects' log losses
        losses = -np.log(proba[picks].mean(axis=0)[np.arange(30), codes])
        return np.mean([losses[subjects == s].mean() for s in set(subjects)])

    weights = select_ensemble(proba, codes, subjects, lambda some: len(some) <= most)
    picks = [0]
    while len(picks) < 15:
        losses = [loss_of([*picks, i]) if len({*picks, i}) <= most else np.inf for i in range(3)]
        if min(losses) >= loss_of(picks) - 1e-9:
            break
        picks.append(int(np.argmin(losses)))
    assert weights == pytest.approx({i: picks.count(i) / len(picks) for i in set(picks)})
    assert 0 not in select_ensemble(proba, codes, subjects, lambda some: 0 not in some)


@pytest.mark.parametrize("bounds", [(0.05, 20.0), (0.9, 1.1)])
def test_the_temperature_has_the_least_loss_within_its_bounds(bounds):
    proba, codes, _ = drawn(0)
    losses = {}
    for t in np.geomspace(*bounds, 300):
        powers = proba[0] ** (1 / t)
        powers /= powers.sum(axis=1, keepdims=True)
        losses[t] = -np.log(powers[np.arange(30), codes]).mean()
    best = fit_temperature(log_probabilities(proba[0]), codes, *bounds)
    assert bounds[0] <= best <= bounds[1] and best == pytest.approx(
        min(losses, key=losses.get), rel=0.03
    )
    np.testing.assert_allclose(apply_temperature(proba[0], t), powers)
