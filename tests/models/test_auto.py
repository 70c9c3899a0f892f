"""The search over everything: judged as a plain loop would, within its budget and limits, resumed, blind to others."""

import itertools
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.feature_selection import SelectKBest, f_classif
from sklearn.model_selection import GroupKFold
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from bench.corpora.folder import open_folder, write_folder
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import Discriminants
from bench.models.recipe import taken
from bench.models.search import auto, portfolio, study, trial_scores
from bench.models.search.auto import Auto
from bench.models.search.ensemble import tempered
from bench.models.search.inner_folds import inner_folds
from bench.models.search.portfolio import Columns, complete
from bench.models.search.space import Range
from bench.models.search.trial_scores import Inner
from bench.models.sizes import sizes
from bench.pareto import front
from bench.scratch import home
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


def inner_of(corpus, touch=None):
    return Inner(corpus, corpus.gestures, inner_folds(corpus.subjects.astype(str), "2"), touch, 0)


def flash(system, corpus):
    return sizes(system, 64, int(corpus.lengths.max()))["flash_bytes"]


def ticking(monkeypatch, tick):
    """A clock that goes on by so much whenever it is read."""
    clock = SimpleNamespace(now=0.0)

    def read():
        clock.now += tick
        return clock.now

    clock.perf_counter = clock.process_time = read
    for module in (auto, study, trial_scores):
        monkeypatch.setattr(module, "time", clock)
    return clock


def test_a_trial_is_judged_as_a_plain_loop_would(quick):
    corpus = noisy()
    X, y, who = TouchFeatures().transform(corpus).to_numpy(), corpus.gestures, corpus.subjects.astype(str)
    hits = np.zeros(len(corpus))
    for train, test in GroupKFold(2, shuffle=True, random_state=0).split(X, groups=who):
        scaler = StandardScaler().fit(X[train])
        machine = SVC(C=10, gamma=0.001, break_ties=True).fit(scaler.transform(X[train]), y[train])
        hits[test] = machine.predict(scaler.transform(X[test])) == y[test]
    search = searched(corpus, 2)
    assert search.tried_[1].state == "complete"
    assert search.tried_[1].subjects == pytest.approx({s: hits[who == s].mean() for s in np.unique(who)})
    assert search.trials_["accuracy"][1] == pytest.approx(np.mean([hits[who == s].mean() for s in np.unique(who)]))


def test_windows_are_judged_by_the_mean_of_undamaged_ones(quick):
    corpus = noisy(longest=120)
    trial = complete({"model": "lda", "window": 0.5, "faults": "all", "lda.shrinkage": 0.3})
    (_, test, proba, _), _ = inner_of(corpus).judge(trial)
    train = np.setdiff1d(np.arange(len(corpus)), test)
    seen, row = taken(corpus[train], portfolio.steps_of(trial).training_steps())
    model = Discriminants(0.3).fit(TouchFeatures().transform(seen), corpus.gestures[train][row])
    for i in (0, len(test) - 1):
        windows, _ = taken(corpus[test[[i]]], portfolio.steps_of(trial).steps())
        expected = model.predict_proba(TouchFeatures().transform(windows)).mean(axis=0)
        np.testing.assert_allclose(proba[i], expected, atol=1e-6)


def test_the_first_seconds_are_what_a_limit_on_touch_judges_by(quick):
    corpus = noisy(longest=120)
    (_, test, proba, _), _ = inner_of(corpus, 0.2).judge(complete(QUICK[0]))
    train, frames = np.setdiff1d(np.arange(len(corpus)), test), int(0.2 * corpus.rate_hz)
    model = Discriminants(0.5).fit(TouchFeatures().transform(corpus[train]), corpus.gestures[train])
    begun = type(corpus).from_captures(
        [corpus[i][:frames] for i in test], corpus.captures.iloc[test], corpus.rate_hz, full_scale=corpus.full_scale
    )
    np.testing.assert_allclose(proba, model.predict_proba(TouchFeatures().transform(begun)), atol=1e-6)
    limited = searched(corpus, 1, max_decision="200ms")
    assert limited.tried_[0].accuracy != searched(corpus, 1).tried_[0].accuracy


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
    heaviest = search.tried_[int(trials["weight"].argmax())]
    again = inner_of(corpus).fitted(heaviest.trial)
    assert np.array_equal(search.best_.members[0].predict_proba(corpus), again.predict_proba(corpus))
    judged = trials[trials["state"] == "complete"]
    assert judged[["flash_bytes", "ram_bytes", "predict_ms"]].notna().all(axis=None)
    assert trials["ended"].is_monotonic_increasing
    for cost, name in (("flash", "flash_bytes"), ("ram", "ram_bytes"), ("predict", "predict_ms")):
        best = front(judged["accuracy"].to_numpy(), judged[name].to_numpy())
        assert trials.loc[trials[f"front_{cost}"]].index.tolist() == judged[best].index.tolist()
    assert search.trained_faults == () and len(Auto().trained_faults) > 10
    saved = pickle.loads(pickle.dumps(search))  # holds nothing of the training captures
    assert all(t.proba is None for t in saved.tried_)
    assert np.array_equal(saved.predict_proba(corpus), search.predict_proba(corpus))


def test_it_goes_on_after_an_interruption_as_if_there_had_been_none(tmp_path, quick, monkeypatch):
    corpus = stored(noisy(), tmp_path / "corpus")
    for before in itertools.product(("touch", "jung54"), BEFORE["window"]):  # kept: tables that are read round alike
        inner_of(corpus).table(complete({"model": "lda"} | dict(zip(("features", "window"), before, strict=True))))
    straight = searched(corpus)
    (home() / "studies").rename(home() / "gone")
    real, made = Inner.judge, []

    def judge(self, trial):
        made.append(trial)
        if len(made) == 4:
            raise KeyboardInterrupt
        return real(self, trial)

    monkeypatch.setattr(Inner, "judge", judge)
    with pytest.raises(KeyboardInterrupt):
        searched(corpus)
    for _ in range(2):
        resumed = searched(corpus)
        assert len(made) == 6  # three were stored, and then all
        assert [t.trial for t in resumed.tried_] == [t.trial for t in straight.tried_]
        assert resumed.chosen_ == straight.chosen_
        assert np.array_equal(resumed.predict_proba(corpus), straight.predict_proba(corpus))


def test_other_people_change_nothing(tmp_path, monkeypatch):
    windowed = {"model": "lda", "window": 0.5, "faults": "all", "columns": 0.25}
    monkeypatch.setattr(portfolio, "FIRST", [QUICK[0], windowed])
    corpus = noisy(longest=60)
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    others = with_other_values(corpus, test)
    one, other = (searched(stored(c, tmp_path / name)[train], 2) for name, c in (("a", corpus), ("b", others)))
    assert [t.trial for t in one.tried_] == [t.trial for t in other.tried_] and one.chosen_ == other.chosen_
    probe = random_corpus(seed=9)
    assert np.array_equal(one.predict_proba(probe), other.predict_proba(probe))


def test_the_budget_is_the_whole_fit_and_more_of_it_tries_the_same_first(quick, monkeypatch):
    corpus = noisy()
    monkeypatch.setattr(portfolio, "work", lambda *args: 0.1)
    searches = []
    for budget in (0.5, 1.5, 6.0):
        clock = ticking(monkeypatch, 0.02)
        search = Auto(seconds=budget, inner="2", trials=12).fit(corpus, corpus.gestures)
        assert max(clock.now, search.search_seconds_ + search.fit_seconds_[0]) <= max(1.1 * budget, budget + 1)
        searches.append([t.trial for t in search.tried_ if t.state in ("complete", "pruned")])
    _, shorter, longer = searches
    assert len(QUICK) < len(shorter) < len(longer) and longer[: len(shorter)] == shorter


def test_where_time_is_short_fewer_captures_are_used(quick, monkeypatch, tmp_path):
    corpus = stored(noisy(subjects=6, gestures=("pat", "rub")), tmp_path / "corpus")
    monkeypatch.setattr(Inner, "_probed", lambda self, name: 10 / int(corpus.lengths.sum()))
    search = Auto(seconds=5.0, inner="2", trials=1).fit(corpus, corpus.gestures)
    part = corpus[search.part_]
    assert search.chosen_["captures"] == len(part) == int(np.ceil(len(corpus) / 5))
    assert set(part.gestures) == set(corpus.gestures) and len(set(part.subjects)) >= 2
    assert not (home() / "features").exists()  # nothing of a part is kept under the digest of all
    assert set(search.predict(corpus)) <= set(corpus.gestures)


def test_where_there_is_no_time_something_decides_within_the_limits(quick, monkeypatch):
    corpus = noisy()
    fit = lambda budget=1.0, **limits: Auto(seconds=budget, inner="2", **limits).fit(corpus, corpus.gestures)  # noqa: E731
    monkeypatch.setattr(Auto, "_expected", lambda self, inner, trial: 1e9)
    monkeypatch.setattr(portfolio, "FIRST", [QUICK[0], {"model": "lda", "columns": 0.25}])
    free = fit()
    assert free.tried_[0].state == "skipped" and free.classes_.tolist() == sorted(set(corpus.gestures))
    limit = flash(free, corpus) / 2
    assert flash(fit(max_flash=f"{limit / 1e3}kB"), corpus) <= limit
    for limits, cost in (({"max_flash": "10B"}, "flash_bytes"), ({"max_ram": "10B"}, "ram_bytes")):
        with pytest.raises(InputError, match=f"within the limits.*{cost}"):
            fit(**limits)
    ticking(monkeypatch, 1.0)  # every look at the clock takes longer than the budget
    search = fit(0.1)
    assert search.trials_["state"].tolist() == ["unjudged"] and search.trials_["weight"].tolist() == [1.0]
    assert search.trials_["accuracy"].isna().all() and not search.trials_["front_flash"].any()
    assert search.chosen_["1"].startswith("1.00 lda") and set(search.predict(corpus)) <= set(corpus.gestures)


def test_a_trial_that_fails_is_listed_and_the_others_go_on(quick, monkeypatch, tmp_path):
    corpus = stored(noisy(), tmp_path / "corpus")
    real = Inner.judge

    def judge(self, trial):
        if trial["model"] == "svm":
            raise FloatingPointError("not today")
        return real(self, trial)

    monkeypatch.setattr(Inner, "judge", judge)
    for _ in range(2):  # judged, then stored
        search = searched(corpus, 3)
        assert [t.state for t in search.tried_] == ["complete", "failed", "complete"]
        assert search.trials_["weight"][1] == 0
        assert search.chosen_["failed"] == 1 and "FloatingPointError: not today" in search.chosen_["error"]
    monkeypatch.setattr(Inner, "judge", lambda self, trial: 1 / 0)
    all_failed = searched(corpus.detached(), 2)
    assert all_failed.chosen_["failed"] == 2 and all_failed.chosen_["1"].startswith("1.00 lda")


def test_a_worse_trial_is_given_up_unless_it_is_much_smaller_or_the_better_one_is_too_large(quick, monkeypatch):
    corpus = noisy()
    small = {"model": "lda", "columns": 0.25, "lda.shrinkage": 0.9}
    monkeypatch.setattr(study.Study, "worse", lambda self, tried: True)
    monkeypatch.setattr(portfolio, "FIRST", [QUICK[0], {"model": "lda", "columns": 0.5, "lda.shrinkage": 0.9}, small])
    free = searched(corpus, 3).tried_
    assert [t.state for t in free] == ["complete", "pruned", "complete"]
    monkeypatch.setattr(portfolio, "FIRST", [QUICK[0], small])
    limit = free[0].costs["flash_bytes"] / 1500
    assert [t.state for t in searched(corpus, 2, max_flash=f"{limit}kB").tried_] == ["large", "complete"]


def test_limits_hold_for_an_ensemble_as_a_whole(quick, monkeypatch):
    """Both machines grow with captures: as they were judged they fit together, fitted to all captures they do not."""
    corpus = noisy()
    grown = [{"model": "svm", "svm.scaling": "z", "svm.C": c, "svm.gamma": 0.01} for c in (1.0, 100.0)]
    monkeypatch.setattr(portfolio, "FIRST", grown)

    def both(proba, codes, who, allowed):
        return {0: 0.5, 1: 0.5} if len(proba) == 2 and allowed({0, 1}) else {0: 1.0} if allowed({0}) else {}

    monkeypatch.setattr(auto, "selected", both)
    free = searched(corpus, 2)
    judged = sum(t.costs["flash_bytes"] for t in free.tried_)
    fitted = flash(free, corpus)
    assert len(free.best_.members) == 2 and judged < fitted
    limit = (judged + fitted) / 2
    limited = searched(corpus, 2, max_flash=f"{limit / 1e3}kB")
    assert len(limited.best_.members) == 1 and flash(limited, corpus) <= limit


@pytest.mark.parametrize("share", [0.5, 0.0001])
def test_columns_are_those_of_the_largest_f_ratio(share):
    corpus = noisy()
    table = TouchFeatures().transform(corpus)
    varies = table.loc[:, table.nunique() > 1]
    count = max(1, round(share * varies.shape[1]))
    kept = Columns(share).fit(varies, corpus.gestures)
    expected = SelectKBest(f_classif, k=count).fit(varies.astype(float), corpus.gestures).get_support(indices=True)
    assert kept.kept_.tolist() == expected.tolist()
    assert kept.transform(varies).columns.tolist() == varies.columns[expected].tolist()


@pytest.mark.parametrize("number", range(len(portfolio.FIRST)))
def test_what_comes_first_can_be_built_and_drawn(number):
    trial = complete(portfolio.FIRST[number])
    portfolio.classifier(trial, 0)
    portfolio.steps_of(trial).check()
    spaces = portfolio.BEFORE | {f"{trial['model']}.{k}": v for k, v in portfolio.SPACES[trial["model"]].items()}
    assert set(trial) == {"model", "features", *spaces}
    for name, values in spaces.items():
        drawn = isinstance(values, Range)
        assert values.low <= trial[name] <= values.high if drawn else trial[name] in values
    assert portfolio.work(trial, 2000, 200, 5) > portfolio.work(trial, 1000, 100, 5) > 0


@pytest.mark.parametrize(
    ("wrong", "fact"),
    [
        ({"trials": 0}, "trials=0:"),
        ({"seconds": float("inf")}, "no end"),
        ({"seconds": 0.0}, "model.seconds=0:"),
        ({"max_flash": "64"}, "max_flash=64:"),
        ({"max_decision": "1kB"}, "max_decision=1kB:"),
        ({"max_decision": "5ms"}, "max_decision=5ms.* 100 Hz"),
        ({}, "there is 1"),
    ],
)
def test_searches_that_cannot_be(wrong, fact):
    corpus = noisy(subjects=1)
    with pytest.raises(InputError, match=fact):
        Auto(**wrong).check()
        Auto(**wrong).check_training(corpus, corpus.gestures)
