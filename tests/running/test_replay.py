"""Prefixes, calibration and stopping against naive slices and hand calculation; whole folds."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import softmax
from sklearn.base import BaseEstimator, ClassifierMixin

from bench.corpora.corpus import Corpus, shared_frames, unblind
from bench.features.jung54 import Jung54
from bench.plan.plan import Fold
from bench.running.circumstances.instants import Instants
from bench.running.evaluation import evaluate_fold, measure_run
from bench.running.replay import (
    STATE,
    Calibration,
    Waiting,
    add_settledness,
    decision_instants,
    first_frames,
    learn_stopping_rule,
    replay_captures,
    skip_to_start,
    time_decisions,
    why_unlearnable,
)
from bench.values.stopping import (
    accuracy_by_instant,
    accuracy_by_threshold,
    accuracy_when_stopping,
    learn_stopping,
    standing_decisions,
    stopping_decisions,
)
from tests.conftest import random_corpus, with_other_values
from tests.running.fakes import Level, fake_cell

STREAM = Instants((), 100.0, stopping=True)  # as after=each hop_ms=100 stopping=yes makes it


class Rising(ClassifierMixin, BaseEstimator):
    """Reads the class in the first taxel; right from frame 4 on, sure by n / (n + 1)."""

    def fit(self, X, y):
        self.classes_ = np.unique(y)
        return self

    def predict_proba(self, X):
        proba = []
        for frames in X:
            n, count = len(frames), len(self.classes_)
            code = (int(frames[0, 0, 0]) + (n < 4)) % count
            row = np.full(count, 1 / (n + 1) / (count - 1))
            row[code] = n / (n + 1)
            proba.append(row)
        return np.array(proba)

    def predict(self, X):
        return self.classes_[self.predict_proba(X).argmax(axis=1)]


class Thirds(Rising):
    """Decides on every three frames by their mean level, as a window network does."""

    def decide(self, X):
        rows = [
            (i, s, frames[s : s + 3])
            for i, frames in enumerate(X)
            for s in range(0, len(frames), 3)
        ]
        table = pd.DataFrame(
            [(i, s, len(f)) for i, s, f in rows], columns=["capture", "start", "frames"]
        )
        return table, softmax([[f.mean(), 50, 80] for _, _, f in rows], axis=1)

    predict_proba = None


def coded_corpus(lengths=(10, 3, 7, 12, 5, 9), subjects=4):
    """Every subject has two captures of each of three classes, which stand in the first taxel."""
    labels = [(str(s), "abc"[i // 2], n) for s in range(subjects) for i, n in enumerate(lengths)]
    arrays = []
    for i, (_, gesture, n) in enumerate(labels):
        frames = np.random.default_rng(i).integers(0, 100, (n, 2, 3)).astype(np.uint16)
        frames[:, 0, 0] = "abc".index(gesture)
        arrays.append(frames)
    captures = pd.DataFrame(labels, columns=["subject", "gesture", "long"])
    return Corpus.from_captures(arrays, captures, 100.0, name="coded")


lengths_of = st.lists(st.integers(1, 30), min_size=1, max_size=8)


@given(lengths_of, st.integers(1, 35))
def test_a_prefix_is_the_first_frames(lengths, frames):
    arrays = [np.random.default_rng(i).integers(0, 9, (n, 2, 2)) for i, n in enumerate(lengths)]
    corpus = Corpus.from_captures(
        arrays, pd.DataFrame({"subject": ["1"] * len(lengths), "gesture": "a"}), 50.0
    )
    corpus = corpus[::-1]
    cut, half = first_frames(corpus, frames), skip_to_start(corpus, "middle")
    for first, rest, capture in zip(cut, half, arrays[::-1], strict=True):
        assert np.array_equal(first, capture[:frames])
        assert np.array_equal(rest, capture[len(capture) // 2 :]) and len(rest)
    assert shared_frames(cut)[0] is shared_frames(corpus)[0]
    assert skip_to_start(corpus, "onset") is corpus


@given(st.integers(1, 2000), st.floats(1, 500), st.one_of(st.none(), st.floats(1, 5000)))
def test_instants_rise_to_the_longest_capture(longest, rate, hop_ms):
    hop_ms = hop_ms and max(hop_ms, 1000 / rate)
    times, now = [], 0
    while len(times) < 4000 and (not times or times[-1] < longest):
        now += 1
        ms = now * hop_ms if hop_ms else 62.5 * 2 ** ((now - 1) / 2)
        times.append(int(np.floor(ms * rate / 1000 + 1e-6)))
    naive = sorted({n for n in times if 0 < n < longest} | {longest})
    assert decision_instants(Instants((), hop_ms), longest, rate).tolist() == naive


def test_features_of_prefixes_are_not_those_kept_for_whole_captures(stored):
    features = Jung54()
    features.fit_transform(stored)
    naive = Corpus.from_captures([f[:7] for f in stored], stored.captures, stored.rate_hz)
    pd.testing.assert_frame_equal(
        features.transform(first_frames(stored, 7)), features.extract(naive)
    )


@given(lengths_of, st.sampled_from([Rising, Thirds]))
@settings(max_examples=10)
def test_a_replay_decides_on_every_prefix_once(lengths, system):
    arrays = [
        np.random.default_rng(i).integers(0, 3, (n, 2, 2)) * 30
        for i, n in enumerate([*lengths, 2, 2])
    ]
    table = pd.DataFrame(
        {"subject": "1", "gesture": (["a", "b", "c"] * len(arrays))[: len(arrays)]}
    )
    corpus, instants = Corpus.from_captures(arrays, table, 50.0), np.array([2, 5, 11, 30])
    estimator, positions = system().fit(corpus, corpus.gestures), np.arange(len(corpus))[::2]
    naive = []
    for i in positions:
        for before, frames in zip([0, 2, 5, 11], instants, strict=True):
            if len(arrays[i]) > before:
                one = [arrays[i][:frames]]
                proba = (
                    estimator.predict_proba(one)[0]
                    if system is Rising
                    else estimator.decide(one)[1].mean(axis=0)
                )
                naive.append((i, len(one[0]), frames, *proba))
    found = replay_captures(estimator, corpus, "x", positions, instants)
    columns = ["capture", "frames", "instant", "p_a", "p_b", "p_c"]
    np.testing.assert_allclose(found[columns].to_numpy(dtype=float), naive, rtol=1e-5)


def test_decisions_are_timed_one_by_one():
    corpus, seen = coded_corpus(), []

    class Timed(Rising):
        def predict(self, X):
            seen.append(X.lengths.tolist())
            return super().predict(X)

    spent = time_decisions(Timed().fit(corpus, corpus.gestures), corpus[:3], np.array([4, 300]))
    assert seen == [[4], [10], [3], [4], [7]] and len(spent.ms) == 5 and min(spent.ms) > 0


def test_a_temperature_is_recovered():
    rng = np.random.default_rng(0)
    ms = np.exp(rng.uniform(np.log(50), np.log(5000), 40_000))
    share = np.log(ms / ms.min()) / np.log(ms.max() / ms.min())
    sharp = softmax(2 * rng.normal(size=(len(ms), 4)), axis=1)
    true = (rng.random(len(ms))[:, None] > sharp.cumsum(axis=1)).sum(axis=1)
    temperature = np.exp(np.log(4) * (1 - share) + np.log(0.5) * share)
    proba = softmax(
        np.log(sharp) * temperature[:, None], axis=1
    )  # too sure early, not sure enough late
    calibration = Calibration.fit(proba, true, ms)
    assert calibration.first == pytest.approx(4, rel=0.06) and calibration.last == pytest.approx(
        0.5, rel=0.06
    )
    assert calibration.first_ms == ms.min() and calibration.last_ms == ms.max()
    some, sure = np.array([[0.7, 0.2, 0.1]] * 3), Calibration(100.0, 900.0, 4.0, 1.0)
    by_hand = some ** np.array(
        [[1 / 4], [1 / 2], [1]]
    )  # before the first instant, half way to the last, after it
    np.testing.assert_allclose(
        sure(some, np.array([9.0, 300, 2e3])), by_hand / by_hand.sum(axis=1, keepdims=True)
    )


def settle_by_probability(table):
    """Settled as far as the label is probable."""
    return table.assign(settled=table.filter(like="p_").max(axis=1))


def test_waiting_is_the_ridge_regression_of_what_the_last_decision_gains():
    """By hand: 62.5 and 125 ms at 80 Hz are 0 and log 2; only the second label is equal."""
    proba = [[0.5, 0.3, 0.2], [0.4, 0.35, 0.25], [0.1, 0.3, 0.6], [0.6, 0.3, 0.1]]
    table = pd.DataFrame(proba, columns=["p_a", "p_b", "p_c"]).assign(
        fold="f", capture=[0, 0, 0, 1]
    )
    table = table.assign(frames=[5, 10, 10, 5], true=["c", "c", "c", "a"])
    late = np.log(2)
    by_hand = np.array(
        [
            [1, 0.5, 0.25, 0.3, 0.2, 0, 0, 0, 0, 0, 0],
            [1, 0.4, 0.16, 0.35, 0.25, late, late**2, 0.4 * late, 0.35 * late, 1, late],
            [1, 0.6, 0.36, 0.3, 0.1, late, late**2, 0.6 * late, 0.3 * late, 0, 0],
            [1, 0.6, 0.36, 0.3, 0.1, 0, 0, 0, 0, 0, 0],
        ]
    )
    gains = [Waiting(tuple(row))(table, 80.0) for row in np.eye(len(STATE))]
    np.testing.assert_allclose(np.column_stack(gains), by_hand, atol=1e-12)
    expected = np.linalg.solve(
        by_hand.T @ by_hand + 0.01 * np.eye(len(STATE)), by_hand.T @ [1, 1, 0, 0]
    )
    np.testing.assert_allclose(Waiting.fit(table, 80.0).weights, expected, atol=1e-8)
    unsure = add_settledness(
        table, Calibration(1.0, 1.0, 1.0, 1.0), Waiting((0.6, -1.0, *[0.0] * 9)), 80.0
    )
    assert unsure["settled"].tolist() == pytest.approx(
        [0.9, 0.8, 1, 1]
    )  # 1 - 0.6 + the largest probability, at most 1
    assert unsure["confidence"].tolist() == pytest.approx([0.5, 0.4, 0.6, 0.6])


def test_stopping_as_calculated_by_hand():
    corpus = coded_corpus()
    table = settle_by_probability(
        replay_captures(
            Rising().fit(corpus, corpus.gestures), corpus, "x", np.arange(6), np.arange(1, 13)
        )
    )
    # n / (n + 1) >= 0.8 from 4 frames on; the capture of 3 frames is labelled at its end, wrongly
    early = stopping_decisions(table, 0.8)
    assert early["frames"].tolist() == [4, 3, 4, 4, 4, 4]
    assert (early["true"] == early["predicted"]).tolist() == [True, False, True, True, True, True]
    assert stopping_decisions(table, 0.0)["frames"].tolist() == [1] * 6
    assert stopping_decisions(table, np.inf)["frames"].tolist() == [10, 3, 7, 12, 5, 9]
    threshold, series = learn_stopping(table, corpus.rate_hz)
    assert threshold == 0.8  # 0.75 stops after three frames
    row = series[series["threshold"] == 0.8].iloc[0]
    assert (
        row["mean_ms"] == pytest.approx(10 * 23 / 6)
        and row["accuracy"] == pytest.approx(5 / 6)
        and row["lost"] == 0
    )
    # after 4 frames the standing decisions are those of 4 frames
    assert standing_decisions(table, 4)["frames"].tolist() == [4, 3, 4, 4, 4, 4]
    curve = accuracy_by_instant(table, corpus.rate_hz).set_index("ms")
    assert curve.loc[30.0, "accuracy"] == 0 and curve.loc[40.0, "accuracy"] == pytest.approx(5 / 6)
    assert curve.loc[120.0, "mean_ms"] == pytest.approx(10 * 46 / 6)
    rules = pd.DataFrame({"fold": ["x"], "threshold": 0.8})
    swept = accuracy_by_threshold(table, corpus.rate_hz).set_index("threshold")
    assert (
        swept.loc[0.8, "accuracy"] == pytest.approx(5 / 6)
        and swept.loc[0.8, "mean_ms"] == row["mean_ms"]
    )
    assert accuracy_when_stopping(table, rules, corpus.rate_hz)["mean_ms"] == row["mean_ms"]


def test_a_loss_within_one_standard_error_is_allowed():
    rows = []  # three subjects with five captures; stopping at once is wrong once, for one subject
    for capture in range(15):
        early = 0.2 if capture == 0 else 0.9
        rows.append(("f", capture, str(capture // 5), "a", 1, 1, 0.9, early, 1 - early))
        rows.append(("f", capture, str(capture // 5), "a", 10, 10, 0.95, 0.9, 0.1))
    names = ["fold", "capture", "subject", "true", "frames", "instant", "settled", "p_a", "p_b"]
    threshold, series = learn_stopping(pd.DataFrame(rows, columns=names), 100.0)
    lost, error = series.loc[series["threshold"] == 0.9, ["lost", "error"]].iloc[0]
    assert lost == pytest.approx(error) == pytest.approx(0.2 / 3)  # of losses of 0.2, 0 and 0
    assert threshold == 0.9  # the highest of those that stop at once


@given(st.integers(0, 10_000), st.sampled_from([0.5, 0.75, 0.8, 0.85]))
@settings(max_examples=6)
def test_stopping_never_looks_at_later_frames(seed, threshold):
    corpus, rng = coded_corpus(subjects=1), np.random.default_rng(seed)
    estimator = Rising().fit(corpus, corpus.gestures)
    waiting, calibration = (
        Waiting(tuple(rng.normal(size=len(STATE)) / 5)),
        Calibration(10.0, 120.0, 2.0, 0.5),
    )

    def stops(corpus):
        table = replay_captures(
            estimator, corpus, "x", np.arange(len(corpus)), np.array([1, 2, 4, 6, 12])
        )
        return stopping_decisions(
            settle_by_probability(table)
            if seed % 2
            else add_settledness(table, calibration, waiting, 100.0),
            threshold,
        )

    before, frames = stops(corpus), corpus.frames.copy()
    for i, seen in enumerate(before["frames"]):
        rest = slice(corpus.starts[i] + seen, corpus.starts[i] + corpus.lengths[i])
        frames[rest] = rng.integers(0, 3, frames[rest].shape)
    pd.testing.assert_frame_equal(before, stops(corpus.with_fields(frames=frames)))


@pytest.fixture(scope="module")
def leveled():
    """A small corpus, a fold of it, and the result of a replay."""
    corpus = random_corpus(subjects=4, per_class=2, grid=(3, 4))
    fold = Fold("2", np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2"))
    return corpus, fold, evaluate_fold(fake_cell(Level, STREAM), corpus, fold, 1)


def test_no_test_subject_has_a_say_in_calibration_and_threshold(leveled):
    corpus, fold, first = leveled
    other = evaluate_fold(fake_cell(Level, STREAM), with_other_values(corpus, fold.test), fold, 1)
    for name in ("rules", "thresholds"):
        assert first.tables[name].equals(other.tables[name])
    assert not first.tables["replay"].equals(other.tables["replay"])
    stopping, _ = learn_stopping_rule(
        Level, with_other_values(corpus, fold.train[::2]), fold.train, Instants((), 100.0)
    )
    assert first.tables["rules"]["temperature_first"].item() != stopping.calibration.first


def test_training_subjects_are_judged_by_systems_that_were_not_trained_on_them():
    corpus = coded_corpus()
    pairs = []

    class Watched(Rising):
        def fit(self, X, y):
            self.subjects_ = set(X.subjects)
            return super().fit(X, y)

        def predict_proba(self, X):
            pairs.append((self.subjects_, set(unblind(X).subjects)))
            return super().predict_proba(X)

    learn_stopping_rule(Watched, corpus, np.flatnonzero(corpus.subjects != "3"), Instants((), 30.0))
    assert pairs and all(
        not trained & judged and "3" not in trained | judged for trained, judged in pairs
    )


def test_captures_that_cannot_teach_when_to_stop_are_refused_in_words():
    corpus = coded_corpus()
    assert why_unlearnable(Rising(), corpus) == ""
    two = corpus[np.isin(corpus.subjects, ["0", "1"])]
    for part in (two.subjects == "0", (two.subjects == "0") | (two.gestures != "c")):
        assert why_unlearnable(Rising(), two[part])


def test_a_fold_scores_whole_captures_as_bench_run_and_stops_as_it_has_learned(leveled):
    """Labels of whole captures are those of a plain run; times are 10 ms a frame."""
    corpus, fold, result = leveled
    plain, replay = evaluate_fold(fake_cell(Level), corpus, fold, 1), result.tables["replay"]
    pd.testing.assert_frame_equal(result.table, plain.table)
    labelled = stopping_decisions(replay, np.inf).set_index("capture").loc[plain.table["capture"]]
    np.testing.assert_allclose(labelled.filter(like="p_"), plain.table.filter(like="p_"), rtol=1e-6)
    early, by_hand = (
        stopping_decisions(replay, result.tables["rules"]["threshold"].item()),
        standing_decisions(replay, 25),
    )
    run = measure_run(
        SimpleNamespace(corpus=corpus, cell=fake_cell(Level, STREAM)),
        {"target": "gesture"},
        [result],
    ).metrics
    assert (
        result.tracked_metrics["replay_accuracy"]
        == run["replay_accuracy"]
        == run["accuracy"]
        == plain.tracked_metrics["accuracy"]
    )
    assert (
        result.tracked_metrics["adaptive_accuracy"] == (early["true"] == early["predicted"]).mean()
    )
    assert (
        run["adaptive_ms"] == 10 * early["frames"].mean()
        and run["mean_ms"] == 10 * corpus.lengths[fold.test].mean()
    )
    assert run["accuracy_at_250_ms"] == (by_hand["true"] == by_hand["predicted"]).mean()
