"""The search over everything: judged as a plain loop would, within its budget and limits, resumed, blind to others."""

import pickle

import numpy as np
import pandas as pd
import pytest
from sklearn.feature_selection import SelectKBest, f_classif
from sklearn.model_selection import GroupKFold
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from bench import progress
from bench.corpora.folder import open_folder, write_folder
from bench.errors import InputError
from bench.scratch import home
from features.touch import TouchFeatures
from models.classic.lda import Discriminants
from models.search import auto, portfolio
from models.search import trial_scores as judged
from models.search.auto import Auto
from models.search.ensemble import tempered
from models.search.portfolio import Columns, complete
from models.search.space import Range
from models.search.trial_scores import Inner
from models.sizes import sizes
from tests.conftest import random_corpus, with_other_values

QUICK = [
    {"model": "lda", "lda.shrinkage": 0.5},
    {"model": "svm", "svm.scaling": "z", "svm.C": 10.0, "svm.gamma": 0.001},
    {"model": "lda", "window": 0.5, "repair": "stuck+dead", "faults": "all", "columns": 0.25},
]


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(portfolio, "FIRST", QUICK)
    few = {m: space for m, space in portfolio.SPACES.items() if m in ("lda", "svm", "softmax")}
    monkeypatch.setattr(portfolio, "SPACES", few)
    monkeypatch.setattr(portfolio, "MODELS", {m: portfolio.MODELS[m] for m in few})


def noisy(subjects=6, **kwargs):
    corpus = random_corpus(subjects=subjects, per_class=3, **kwargs)
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 160, len(corpus.frames))[:, None, None]
    return corpus.changed(frames=(corpus.frames + noise).astype(np.uint16))


def stored(corpus, folder):
    write_folder(corpus, folder)
    return open_folder(folder)


def searched(corpus, trials=5, **kwargs):
    return Auto(budget=float("inf"), trials=trials, inner="2", **kwargs).fit(corpus, corpus.gestures)


class Ticking:
    """A clock that goes on by so much whenever it is read."""

    def __init__(self, tick):
        self.now, self.tick = 0.0, tick

    def perf_counter(self):
        self.now += self.tick
        return self.now

    process_time = perf_counter


def test_a_trial_is_judged_as_a_plain_loop_would(quick):
    corpus = noisy()
    X, y, who = TouchFeatures().transform(corpus).to_numpy(), corpus.gestures, corpus.subjects.astype(str)
    hits = np.zeros(len(corpus))
    for train, test in GroupKFold(2, shuffle=True, random_state=0).split(X, groups=who):
        scaler = StandardScaler().fit(X[train])
        machine = SVC(C=10, gamma=0.001, break_ties=True).fit(scaler.transform(X[train]), y[train])
        hits[test] = machine.predict(scaler.transform(X[test])) == y[test]
    found = searched(corpus)
    assert found.tried_[1].state == "complete"
    assert found.tried_[1].subjects == pytest.approx({s: hits[who == s].mean() for s in np.unique(who)})
    assert found.trials_["accuracy"][1] == pytest.approx(np.mean([hits[who == s].mean() for s in np.unique(who)]))


def test_windows_are_judged_by_the_mean_of_undamaged_ones(quick):
    corpus = noisy(subjects=4, longest=120)
    trial = complete({"model": "lda", "window": 0.5, "faults": "all", "lda.shrinkage": 0.3})
    inner = Inner(corpus, corpus.gestures, auto.inner_folds(corpus.subjects.astype(str), "2"), None, 0)
    (_, test, proba, _), _ = inner.judge(trial)
    train = np.setdiff1d(np.arange(len(corpus)), test)
    whole = portfolio.steps_of(trial)
    from models.recipe import taken

    seen, row = taken(corpus[train], whole.training_steps())
    model = Discriminants(0.3).fit(TouchFeatures().transform(seen), corpus.gestures[train][row])
    for i in (0, len(test) - 1):
        alone, _ = taken(corpus[test[[i]]], whole.steps())
        expected = model.predict_proba(TouchFeatures().transform(alone)).mean(axis=0)
        np.testing.assert_allclose(proba[i], expected, atol=1e-6)


def test_the_first_seconds_are_what_a_limit_on_touch_judges_by(quick):
    corpus = noisy(subjects=4, longest=120)
    folds = auto.inner_folds(corpus.subjects.astype(str), "2")
    trial = complete(QUICK[0])
    (_, test, proba, _), _ = Inner(corpus, corpus.gestures, folds, 0.2, 0).judge(trial)
    train, frames = np.setdiff1d(np.arange(len(corpus)), test), int(0.2 * corpus.rate_hz)
    model = Discriminants(0.5).fit(TouchFeatures().transform(corpus[train]), corpus.gestures[train])
    begun = type(corpus).from_captures(
        [corpus[i][:frames] for i in test], corpus.captures.iloc[test], corpus.rate_hz, full_scale=corpus.full_scale
    )
    np.testing.assert_allclose(proba, model.predict_proba(TouchFeatures().transform(begun)), atol=1e-6)
    asked = searched(corpus, 2, max_decision="200ms")
    assert asked.tried_[0].accuracy != searched(corpus, 2).tried_[0].accuracy


def test_what_decides_is_what_was_picked_fitted_to_everybody(quick):
    corpus = noisy()
    found = searched(corpus)
    chosen = found.trials_[found.trials_["weight"] > 0]
    assert chosen["weight"].sum() == pytest.approx(1) and (chosen["state"] == "complete").all()
    assert len(found.best_.members) == len(chosen) <= 5
    told = zip(found.best_.members, found.best_.weights, found.best_.temperatures, strict=True)
    mean = sum(w * tempered(m.predict_proba(corpus), t) for m, w, t in told)
    np.testing.assert_allclose(found.predict_proba(corpus), mean)
    assert sum(name.isdecimal() for name in found.chosen_) == len(chosen)


def test_it_repeats_itself_and_goes_on_after_an_interruption(tmp_path, quick, monkeypatch):
    corpus = stored(noisy(), tmp_path / "corpus")
    straight = searched(corpus)
    assert len(straight.trials_) == 5
    (home() / "studies").rename(home() / "gone")
    real, made = judged.Inner.judge, 0

    def judge(self, trial):
        nonlocal made
        made += 1
        if made == 4:
            raise KeyboardInterrupt
        return real(self, trial)

    monkeypatch.setattr(judged.Inner, "judge", judge)
    with pytest.raises(KeyboardInterrupt):
        searched(corpus)
    resumed = searched(corpus)
    assert made == 6  # three were stored
    again = searched(corpus)
    assert made == 6
    for other in (resumed, again):
        assert [t.trial for t in other.tried_] == [t.trial for t in straight.tried_]
        assert other.chosen_ == straight.chosen_
        assert np.array_equal(other.predict_proba(corpus), straight.predict_proba(corpus))


def test_a_study_grows_and_answers_shorter_searches_only_with_their_own_trials(tmp_path, quick):
    corpus = stored(noisy(), tmp_path / "corpus")
    grown = [searched(corpus, n) for n in (2, 6, 3)]
    assert [len(each.trials_) for each in grown] == [2, 6, 3]
    (home() / "studies").rename(home() / "gone")
    assert [t.trial for t in searched(corpus, 6).tried_] == [t.trial for t in grown[1].tried_]


def test_other_people_change_nothing(tmp_path, quick):
    corpus = noisy()
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    probe = random_corpus(seed=9)
    found = []
    for name, each in (("a", corpus), ("b", with_other_values(corpus, test))):
        whole = stored(each, tmp_path / name)
        found.append(searched(whole[train]))
    assert [t.trial for t in found[0].tried_] == [t.trial for t in found[1].tried_]
    assert found[0].chosen_ == found[1].chosen_
    assert np.array_equal(*(each.predict_proba(probe) for each in found))


@pytest.mark.parametrize("budget", [0.5, 2.0, 5.0, 20.0])
@pytest.mark.parametrize("tick", [0.001, 0.01])
def test_the_budget_is_the_whole_fit(budget, tick, quick, monkeypatch):
    corpus = noisy()
    clock = Ticking(tick)
    monkeypatch.setattr(auto, "time", clock)
    monkeypatch.setattr(judged, "time", clock)
    monkeypatch.setattr(portfolio, "work", lambda *args: 0.1)
    found = Auto(budget=budget, inner="2", trials=30).fit(corpus, corpus.gestures)
    assert clock.now <= max(1.1 * budget, budget + 1)
    assert found.search_seconds_ + found.fit_seconds_[0] <= max(1.1 * budget, budget + 1)
    assert found.predict(corpus).shape == (len(corpus),)


def test_with_more_budget_the_same_trials_come_first(quick, monkeypatch):
    corpus = noisy()
    found = []
    for budget in (4.0, 8.0):
        clock = Ticking(0.01)
        monkeypatch.setattr(auto, "time", clock)
        monkeypatch.setattr(judged, "time", clock)
        found.append(Auto(budget=budget, inner="2").fit(corpus, corpus.gestures))
    until = next(i for i, t in enumerate(found[0].tried_) if t.state not in ("complete", "pruned"))
    assert until > 3 and sum(t.state == "complete" for t in found[1].tried_) > until
    assert [t.trial for t in found[1].tried_[:until]] == [t.trial for t in found[0].tried_[:until]]


def test_it_says_how_far_it_is(quick, tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "OFTEN_S", 0.0)
    said = []
    with progress.telling(tmp_path, "fold"):
        monkeypatch.setattr(portfolio, "FIRST", [*QUICK[:2]])
        real = auto.tell
        monkeypatch.setattr(auto, "tell", lambda *told: (real(*told), said.extend(progress.told(tmp_path))))
        Auto(budget=60.0, inner="2", trials=2).fit(noisy(), noisy().gestures)
    assert [words.split(",")[0] for _, _, words, *_ in said] == ["1 trials of 2", "2 trials of 2"]
    assert all("best" in words and 0 <= left <= 60 for _, _, words, left, *_ in said) and not progress.told(tmp_path)


def test_where_time_is_short_fewer_captures_are_used(quick, monkeypatch):
    corpus = noisy(gestures=("pat", "rub"))
    monkeypatch.setattr(judged.Inner, "_probed", lambda self, name: 10 / int(corpus.lengths.sum()))
    found = Auto(budget=5.0, inner="2", trials=1).fit(corpus, corpus.gestures)
    part = corpus[found.part_]
    assert found.chosen_["captures"] == len(part) == int(np.ceil(len(corpus) / 5))
    assert set(part.gestures) == set(corpus.gestures) and len(set(part.subjects)) >= 2
    assert set(found.predict(corpus)) <= set(corpus.gestures)


def test_where_there_is_no_time_at_all_something_decides_within_the_limits(quick, monkeypatch):
    corpus = noisy()
    monkeypatch.setattr(Auto, "_expected", lambda self, inner, trial: 1e9)
    found = Auto(budget=1.0, inner="2").fit(corpus, corpus.gestures)
    assert found.tried_[0].state == "skipped" and found.classes_.tolist() == sorted(set(corpus.gestures))
    monkeypatch.setattr(portfolio, "FIRST", [QUICK[0], {"model": "lda", "columns": 0.25}])
    large = sizes(Auto(budget=1.0, inner="2").fit(corpus, corpus.gestures), 64, 40)["flash_bytes"]
    small = Auto(budget=1.0, inner="2", max_flash=f"{large / 2000}kB").fit(corpus, corpus.gestures)
    assert sizes(small, 64, 40)["flash_bytes"] <= large / 2
    with pytest.raises(InputError, match="no trial is within the limits"):
        Auto(budget=1.0, inner="2", max_flash="10B").fit(corpus, corpus.gestures)


def test_a_budget_that_is_spent_before_the_first_trial_still_lists_what_decides(quick, monkeypatch):
    corpus = noisy()
    monkeypatch.setattr(auto, "time", Ticking(1.0))  # every look at the clock takes longer than the budget
    found = Auto(budget=0.1, inner="2").fit(corpus, corpus.gestures)
    assert found.trials_["state"].tolist() == ["unjudged"] and found.trials_["weight"].tolist() == [1.0]
    assert found.trials_["accuracy"].isna().all() and not found.trials_["front_flash"].any()
    assert found.chosen_["1"].startswith("1.00 lda") and set(found.predict(corpus)) <= set(corpus.gestures)


def test_a_trial_that_fails_is_told_and_the_others_go_on(quick, monkeypatch, tmp_path):
    corpus = stored(noisy(), tmp_path / "corpus")
    real = judged.Inner.judge

    def judge(self, trial):
        if trial["model"] == "svm":
            raise FloatingPointError("not today")
        return real(self, trial)

    monkeypatch.setattr(judged.Inner, "judge", judge)
    for _ in range(2):  # found, then stored
        found = searched(corpus)
        assert found.tried_[1].state == "failed" and found.trials_["weight"][1] == 0
        assert found.chosen_["failed"] >= 1 and "FloatingPointError: not today" in found.chosen_["error"]
    monkeypatch.setattr(judged.Inner, "judge", lambda self, trial: 1 / 0)
    (home() / "studies").rename(home() / "gone")
    all_failed = searched(corpus, 2)
    assert all_failed.chosen_["failed"] == 2 and all_failed.chosen_["1"].startswith("1.00 lda")


def test_one_within_the_limits_is_not_given_up_for_one_that_exceeds_them(quick, monkeypatch):
    corpus = noisy()
    monkeypatch.setattr(portfolio, "FIRST", [QUICK[0], {"model": "lda", "columns": 0.25, "lda.shrinkage": 0.9}])
    monkeypatch.setattr("optuna.trial.Trial.should_prune", lambda self: True)
    large = searched(corpus, 1).tried_[0].costs["flash_bytes"]
    found = searched(corpus, 2, max_flash=f"{large / 1500}kB")
    assert [t.state for t in found.tried_] == ["large", "complete"]


def test_limits_hold_for_what_is_fitted(quick):
    corpus = noisy()
    free = searched(corpus, 6)
    size = sizes(free, 64, int(corpus.lengths.max()))["flash_bytes"]
    for limit in (size / 2, 5e3):
        small = searched(corpus, 6, max_flash=f"{limit / 1e3:.3f}kB")
        assert sizes(small, 64, int(corpus.lengths.max()))["flash_bytes"] <= limit
    with pytest.raises(InputError, match="no trial is within the limits of model.max_.*flash_bytes"):
        searched(corpus, 3, max_flash="10B")
    with pytest.raises(InputError, match="ram_bytes"):
        searched(corpus, 3, max_ram="10B")


def test_limits_hold_for_an_ensemble_as_a_whole(quick, monkeypatch):
    """Both machines grow with captures: as they were judged they fit together, fitted to all captures they do not."""
    corpus = noisy()
    grown = [{"model": "svm", "svm.scaling": "z", "svm.C": c, "svm.gamma": 0.01} for c in (1.0, 100.0)]
    monkeypatch.setattr(portfolio, "FIRST", grown)
    monkeypatch.setattr(auto, "selected", lambda proba, codes, who, allowed: two(len(proba), allowed))

    def two(count, allowed):
        return {0: 0.5, 1: 0.5} if count == 2 and allowed({0, 1}) else {0: 1.0} if allowed({0}) else {}

    free = searched(corpus, 2)
    judged_as = sum(t.costs["flash_bytes"] for t in free.tried_)
    fitted = sizes(free, 64, 40)["flash_bytes"]
    assert len(free.best_.members) == 2 and judged_as < fitted
    limit = (judged_as + fitted) / 2
    held = searched(corpus, 2, max_flash=f"{limit / 1000}kB")
    assert len(held.best_.members) == 1 and sizes(held, 64, 40)["flash_bytes"] <= limit


def test_the_last_fits_end_where_a_limit_is_exceeded_late(quick, monkeypatch):
    """The first pick outgrows its limit when there is no time for another: another is fitted nevertheless."""
    corpus = noisy()
    real = judged.Inner.costs
    monkeypatch.setattr(auto.Clock, "left", 1e-6)
    found = searched(corpus, 2)
    search = Auto(budget=float("inf"), trials=2, inner="2", max_flash="1MB")
    search.tried_, search.part_ = found.tried_, found.part_
    best = max(found.tried_, key=lambda t: t.accuracy)
    first = []

    def costs(self, system):
        grown = {} if first else {"flash_bytes": 1e9}
        first.append(system)
        return real(self, system) | grown

    monkeypatch.setattr(judged.Inner, "costs", costs)
    inner = Inner(corpus, corpus.gestures, [], None, 0)
    ((kept, weight),) = search._fitted(inner, auto.Clock(0.0, 1.0))
    assert kept is not best and weight == 1.0 and len(first) == 2


def test_what_is_saved_holds_nothing_of_the_training_captures(quick):
    corpus = noisy()
    found = searched(corpus, 3)
    again = pickle.loads(pickle.dumps(found))
    assert all(t.proba is None for t in again.tried_) and found.tried_[0].proba is not None
    assert np.array_equal(again.predict_proba(corpus), found.predict_proba(corpus))


def test_faults_are_told_of_what_decides(quick):
    corpus = noisy()
    assert len(Auto().trained_faults) > 10
    assert searched(corpus, 1).trained_faults == ()


def test_costs_and_fronts_are_told(quick):
    found = searched(noisy(), 6).trials_
    complete_ = found[found["state"] == "complete"]
    assert complete_[["flash_bytes", "ram_bytes", "predict_ms"]].notna().all(axis=None)
    for cost, name in (("flash", "flash_bytes"), ("ram", "ram_bytes"), ("predict", "predict_ms")):
        for row in complete_.itertuples():
            others = complete_[complete_.index != row.Index]
            at_least = (others["accuracy"] >= row.accuracy) & (others[name] <= getattr(row, name))
            better = (others["accuracy"] > row.accuracy) | (others[name] < getattr(row, name))
            assert found.loc[row.Index, f"front_{cost}"] == (not (at_least & better).any())
    assert found["ended"].is_monotonic_increasing


@pytest.mark.parametrize("share", [0.1, 0.5, 0.0001])
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
    for name, values in spaces.items():
        if isinstance(values, Range):
            assert values.low <= trial[name] <= values.high
        else:
            assert trial[name] in values
    assert set(trial) == {"model", "features", *spaces}
    assert portfolio.work(trial, 2000, 200, 5) > portfolio.work(trial, 1000, 100, 5) > 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"inner": "1"}, "model.inner=1: give a number of subject groups"),
        ({"trials": 0}, "model.trials=0: give at least 1"),
        ({"members": 0}, "model.members=0: give at least 1"),
        ({"budget": 0.0}, "model.budget=0: give"),
        ({"budget": float("nan")}, "model.budget=nan: give"),
        ({"budget": float("inf")}, "this search has no end"),
        ({"max_flash": "64"}, "model.max_flash=64: give a number above 0 and B or kB"),
        ({"max_decision": "1kB"}, "model.max_decision=1kB: give a number above 0 and ms or s"),
        ({"max_decision": "infs"}, "model.max_decision=infs: give"),
        ({"max_predict": "-1ms"}, "model.max_predict=-1ms: give"),
    ],
)
def test_searches_that_cannot_be(wrong, message):
    with pytest.raises(InputError, match=message):
        Auto(**wrong).check()


def test_one_subject_or_one_class_is_told():
    with pytest.raises(InputError, match="shorter than a frame at 100 Hz"):
        Auto(max_decision="5ms").check_training(noisy(), noisy().gestures)
    corpus = noisy(subjects=2)
    with pytest.raises(InputError, match="there is 1; train on more"):
        Auto().check_training(corpus[corpus.subjects == "1"], corpus.gestures[corpus.subjects == "1"])
    part = ((corpus.subjects == "1") & (corpus.gestures == "pat")) | (corpus.subjects == "2")
    with pytest.raises(InputError, match="which here leaves one class"):
        Auto().check_training(corpus[part], corpus.gestures[part])


def test_rows_are_counted_as_the_table_has_them():
    corpus = noisy(subjects=4, longest=120)
    inner = Inner(corpus, corpus.gestures, [], None, 0)
    for before in ({}, {"window": 0.5}, {"faults": "all"}, {"window": 0.5, "faults": "all", "repair": "stuck+dead"}):
        trial = complete({"model": "lda"} | before)
        counted = inner.rows(trial)
        made = len(inner.table(trial).values)
        assert made == inner.rows(trial)
        assert counted == made if "faults" not in before else 0.9 < counted / made < 1.1  # some damage drops frames


def test_tables_say_the_same_kept_or_not(tmp_path):
    corpus = noisy(subjects=4, longest=120)
    kept = stored(corpus, tmp_path / "corpus")[3:40]
    trial = complete({"model": "lda", "window": 0.5, "faults": "all"})
    tables = [Inner(kept, kept.gestures, [], None, 0).table(trial) for _ in range(2)]  # computed, then read
    pd.testing.assert_frame_equal(tables[0].values, tables[1].values)
    assert tables[0].row.tolist() == tables[1].row.tolist()
