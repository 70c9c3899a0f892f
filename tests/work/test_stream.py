"""Prefixes, calibration and stopping against naive slices and hand calculation; whole commands."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import softmax
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics import log_loss

from bench.cli import main
from bench.corpora.corpus import Corpus, storage, unblinded
from bench.corpora.folder import open_folder, write_folder
from bench.errors import InputError
from bench.outcomes.stopping import by_instant, by_threshold, learn_stopping, learned_point, standing, stopped
from bench.plan.plan import Fold
from bench.work.replay import STATE, Calibration, Replay, Waiting, decision_latency, learned, prefix, replayed, weighed
from bench.work.stream import Stream
from bench.work.workers import do_fold
from features.jung54 import Jung54
from tests.conftest import predictions, random_corpus, runs, with_other_values

SMALL = ["model=bayes", "data.subjects=3", "data.variants=normal", "hop_ms=600", "jobs=2"]


def test_a_decision_is_timed_where_no_capture_reaches_the_first_instant():
    corpus = random_corpus(longest=30)
    assert list(Replay(60_000.0).instants(300, 100.0)) == [300]
    spent = decision_latency(Rising().fit(corpus, corpus.gestures), corpus, np.array([300]))
    assert len(spent) == 20 and min(spent) > 0


class Rising(ClassifierMixin, BaseEstimator):
    """The class stands in the first taxel; right from the fourth frame on, and n / (n + 1) sure after n frames."""

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
        rows = [(i, s, frames[s : s + 3]) for i, frames in enumerate(X) for s in range(0, len(frames), 3)]
        table = pd.DataFrame([(i, s, len(f)) for i, s, f in rows], columns=["capture", "start", "frames"])
        return table, softmax([[f.mean(), 50, 80] for _, _, f in rows], axis=1)

    predict_proba = None


def coded_corpus(lengths=(10, 3, 7, 12, 5, 9), subjects=4):
    """Every subject has two captures of each of three classes, which stand in the first taxel."""
    about = [(str(s), "abc"[i // 2], n) for s in range(subjects) for i, n in enumerate(lengths)]
    arrays = []
    for i, (_, gesture, n) in enumerate(about):
        frames = np.random.default_rng(i).integers(0, 100, (n, 2, 3)).astype(np.uint16)
        frames[:, 0, 0] = "abc".index(gesture)
        arrays.append(frames)
    captures = pd.DataFrame(about, columns=["subject", "gesture", "long"])
    return Corpus.from_captures(arrays, captures, 100.0, name="coded")


lengths_of = st.lists(st.integers(1, 30), min_size=1, max_size=8)


@given(lengths_of, st.integers(1, 35))
def test_a_prefix_is_the_first_frames(lengths, frames):
    arrays = [np.random.default_rng(i).integers(0, 9, (n, 2, 2)) for i, n in enumerate(lengths)]
    corpus = Corpus.from_captures(arrays, pd.DataFrame({"subject": ["1"] * len(lengths), "gesture": "a"}), 50.0)
    corpus = corpus[::-1]
    cut = prefix(corpus, frames)
    for found, whole in zip(cut, arrays[::-1], strict=True):
        assert np.array_equal(found, whole[:frames])
    assert storage(cut)[0] is storage(corpus)[0]
    for found, whole in zip(Replay(start="middle").begun(corpus), arrays[::-1], strict=True):
        assert np.array_equal(found, whole[len(whole) // 2 :]) and len(found)
    assert Replay().begun(corpus) is corpus


@given(st.integers(1, 2000), st.floats(1, 500), st.one_of(st.none(), st.floats(1, 5000)))
def test_instants_rise_to_the_longest_capture(longest, rate, hop_ms):
    hop_ms = hop_ms and max(hop_ms, 1000 / rate)
    found = Replay(hop_ms).instants(longest, rate)
    assert found[0] >= 1 and found[-1] == longest and (np.diff(found) > 0).all()
    times, now = [], 0
    while len(times) < 4000 and (not times or times[-1] < longest):
        now += 1
        ms = now * hop_ms if hop_ms else 62.5 * 2 ** ((now - 1) / 2)
        times.append(int(np.floor(ms * rate / 1000 + 1e-6)))
    naive = sorted({n for n in times if 0 < n < longest} | {longest})
    assert found.tolist() == naive


def test_a_replay_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="start=later"):
        Replay(start="later").check(100)
    with pytest.raises(InputError, match="one frame takes 10 ms"):
        Replay(hop_ms=9).check(100)
    Replay(hop_ms=10).check(100)


def test_features_of_prefixes_are_not_those_kept_for_whole_captures(tmp_path):
    write_folder(random_corpus(subjects=2), tmp_path / "stored")
    corpus = open_folder(tmp_path / "stored")
    features = Jung54()
    whole = features.fit_transform(corpus)
    cut = features.transform(prefix(corpus, 7))
    naive = Corpus.from_captures([f[:7] for f in corpus], corpus.captures, corpus.rate_hz)
    pd.testing.assert_frame_equal(cut, features.extract(naive))
    assert not np.allclose(cut, whole)


@given(lengths_of, st.sampled_from([Rising, Thirds]))
def test_a_replay_decides_on_every_prefix_once(lengths, system):
    arrays = [np.random.default_rng(i).integers(0, 3, (n, 2, 2)) * 30 for i, n in enumerate(lengths)]
    gestures = (["a", "b", "c"] * len(lengths))[: max(3, len(lengths))]
    arrays += [np.zeros((2, 2, 2), int)] * (len(gestures) - len(arrays))
    corpus = Corpus.from_captures(arrays, pd.DataFrame({"subject": "1", "gesture": gestures}), 50.0)
    estimator = system().fit(corpus, corpus.gestures)
    instants = np.array([2, 5, 11, 30])
    positions = np.arange(len(corpus))[::2]
    table = replayed(estimator, corpus, "x", positions, instants)
    naive = []
    for i in positions:
        for before, frames in zip([0, 2, 5, 11], instants, strict=True):
            if len(arrays[i]) > before:
                one = arrays[i][:frames]
                if system is Rising:
                    proba = estimator.predict_proba([one])[0]
                else:
                    proba = estimator.decide([one])[1].mean(axis=0)
                naive.append((i, len(one), frames, *proba))
    found = table[["capture", "frames", "instant", "p_a", "p_b", "p_c"]].to_numpy(dtype=float)
    np.testing.assert_allclose(found, naive, rtol=1e-5)


def test_a_temperature_is_found_again():
    rng = np.random.default_rng(0)
    ms = np.exp(rng.uniform(np.log(50), np.log(5000), 40_000))
    place = np.log(ms / ms.min()) / np.log(ms.max() / ms.min())
    sharp = softmax(2 * rng.normal(size=(len(ms), 4)), axis=1)
    true = (rng.random(len(ms))[:, None] > sharp.cumsum(axis=1)).sum(axis=1)
    temperature = np.exp(np.log(4) * (1 - place) + np.log(0.5) * place)
    told = softmax(np.log(sharp) * temperature[:, None], axis=1)  # too sure early, not sure enough late
    calibration = Calibration.fit(told, true, ms)
    assert calibration.first == pytest.approx(4, rel=0.06) and calibration.last == pytest.approx(0.5, rel=0.06)
    assert log_loss(true, calibration(told, ms)) == pytest.approx(log_loss(true, sharp), abs=2e-3)
    assert (calibration(told, ms).argmax(axis=1) == told.argmax(axis=1)).all()
    assert calibration.first_ms == ms.min() and calibration.last_ms == ms.max()


def test_the_likelihood_is_at_its_maximum():
    rng = np.random.default_rng(1)
    ms = rng.choice([100.0, 300.0, 900.0], 300)
    logits = rng.normal(size=(300, 3))
    proba, true = softmax(3 * logits, axis=1), (logits + rng.normal(size=(300, 3))).argmax(axis=1)
    found = Calibration.fit(proba, true, ms)
    best = log_loss(true, found(proba, ms))
    for first, last in ((1.05, 1), (0.95, 1), (1, 1.05), (1, 0.95)):
        other = Calibration(found.first_ms, found.last_ms, found.first * first, found.last * last)
        assert log_loss(true, other(proba, ms)) > best - 1e-9


def test_certain_and_single_decisions_can_be_calibrated():
    sure = Calibration.fit(np.eye(3)[[0, 1, 2]], np.array([0, 1, 2]), np.array([10.0, 20, 30]))
    assert 0 < sure.first < 1 and np.isfinite(sure(np.eye(3), np.array([1.0, 20, 99]))).all()
    wrong = Calibration.fit(np.eye(3)[[0, 1, 2]], np.array([1, 2, 0]), np.array([10.0, 10, 10]))
    assert wrong(np.eye(3), np.full(3, 10.0)).max() < 0.4


def surely(table):
    """Settled as far as the label is probable."""
    return table.assign(settled=table[[c for c in table if c.startswith("p_")]].max(axis=1))


def waited(rows=4000, seed=0):
    """Captures decided on three times, two classes; the later label is right, the earlier one where it is sure."""
    rng = np.random.default_rng(seed)
    sure = rng.random(rows) < 0.5
    true = rng.integers(0, 2, rows)
    right = sure | (rng.random(rows) < 0.5)  # an unsure label is a guess
    tables = []
    for instant, (top, hit) in enumerate(
        [(np.where(sure, 0.9, 0.6), right), (np.where(sure, 0.9, 0.6), right), (0.9, 1)]
    ):
        label = np.where(hit, true, 1 - true)
        p_a = np.where(label == 0, top, 1 - np.asarray(top))
        about = {"fold": "f", "capture": np.arange(rows), "true": np.array(["a", "b"])[true]}
        tables.append(pd.DataFrame(about | {"instant": instant, "frames": 10 * 2**instant, "p_a": p_a, "p_b": 1 - p_a}))
    table = pd.concat(tables).sort_values(["capture", "instant"], kind="stable", ignore_index=True)
    return table, np.repeat(sure, 3)


def test_waiting_is_worth_what_it_gained_in_training():
    """An unsure label is right half of the time and always in the end: half a point; a sure one gains nothing."""
    table, sure = waited()
    found = Waiting.fit(table, 100.0)(waited(seed=1)[0], 100.0)
    other, sure = waited(seed=1)
    first = (other["instant"] == 0).to_numpy()
    assert found[first & ~sure].mean() == pytest.approx(0.5, abs=0.06)
    assert found[first & sure].mean() == pytest.approx(0, abs=0.06)
    assert abs(found[(other["instant"] == 2).to_numpy()].mean()) < 0.06
    assert len(Waiting.fit(table, 100.0).weights) == len(STATE)


def test_hopeless_captures_are_not_waited_for():
    """Where the last label is no better, an unsure one is settled at once, though its confidence never rises."""
    table, sure = waited()
    for name in ("p_a", "p_b"):  # the last decision says what the first one said
        table[name] = table.groupby("capture")[name].transform("first")
    plain = Calibration(100.0, 400.0, 1.0, 1.0)
    found = weighed(table, plain, Waiting.fit(table, 100.0), 100.0)
    assert found["confidence"].min() < 0.65 and found["settled"].min() > 0.95
    assert set(stopped(found, 0.95)["frames"]) == {10}


def test_stopping_as_calculated_by_hand():
    corpus = coded_corpus()
    table = replayed(Rising().fit(corpus, corpus.gestures), corpus, "x", np.arange(6), np.arange(1, 13))
    table = surely(table)
    # n / (n + 1) >= 0.8 from 4 frames on; the capture of 3 frames never gets there and is labelled at its end, wrongly
    early = stopped(table, 0.8)
    assert early["frames"].tolist() == [4, 3, 4, 4, 4, 4]
    assert (early["true"] == early["predicted"]).tolist() == [True, False, True, True, True, True]
    assert stopped(table, 0.0)["frames"].tolist() == [1] * 6
    assert stopped(table, np.inf)["frames"].tolist() == [10, 3, 7, 12, 5, 9]
    threshold, series = learn_stopping(table, corpus.rate_hz)
    assert threshold == 0.8  # 0.75 stops after three frames
    row = series[series["threshold"] == 0.8].iloc[0]
    assert row["mean_ms"] == pytest.approx(10 * 23 / 6) and row["accuracy"] == pytest.approx(5 / 6) and row["lost"] == 0
    # after 4 frames the standing decisions are those of 4 frames; after 9 nothing has changed but what was seen
    assert standing(table, 4)["frames"].tolist() == [4, 3, 4, 4, 4, 4]
    curve = by_instant(table, corpus.rate_hz).set_index("ms")
    assert curve.loc[30.0, "accuracy"] == 0 and curve.loc[40.0, "accuracy"] == pytest.approx(5 / 6)
    assert curve.loc[120.0, "mean_ms"] == pytest.approx(10 * 46 / 6)
    swept = by_threshold(table, corpus.rate_hz).set_index("threshold")
    assert swept.loc[0.8, "accuracy"] == pytest.approx(5 / 6) and swept.loc[0.8, "mean_ms"] == row["mean_ms"]
    assert learned_point(table, {"x": 0.8}, corpus.rate_hz)["mean_ms"] == row["mean_ms"]


def test_a_loss_within_one_standard_error_is_allowed():
    rows = []  # three subjects with five captures; stopping at once is wrong once, for one subject
    for s in range(3):
        for c in range(5):
            wrong = s == c == 0
            rows.append(("f", 5 * s + c, str(s), "a", 1, 1, 0.9, 0.2 if wrong else 0.9, 0.8 if wrong else 0.1))
            rows.append(("f", 5 * s + c, str(s), "a", 10, 10, 0.95, 0.9, 0.1))
    names = ["fold", "capture", "subject", "true", "frames", "instant", "settled", "p_a", "p_b"]
    table = pd.DataFrame(rows, columns=names)
    threshold, series = learn_stopping(table, 100.0)
    lost = np.array([0.2, 0, 0])
    row = series[series["threshold"] == 0.9].iloc[0]
    assert row["lost"] == pytest.approx(lost.mean()) and row["error"] == pytest.approx(lost.std(ddof=1) / np.sqrt(3))
    assert threshold == 0.9  # the highest of those that stop at once: mean and standard error are equal here
    table.loc[table["capture"].isin([5, 10]) & (table["instant"] == 1), ["p_a", "p_b"]] = 0.2, 0.8
    assert learn_stopping(table, 100.0)[0] == np.inf  # now every subject loses a fifth: not by chance


@given(st.integers(0, 10_000), st.sampled_from([0.5, 0.75, 0.8, 0.85]))
def test_stopping_never_looks_at_later_frames(seed, threshold):
    corpus = coded_corpus()
    estimator = Rising().fit(corpus, corpus.gestures)
    instants = np.array([1, 2, 4, 6, 12])

    weights = np.random.default_rng(seed).normal(size=len(STATE)) / 5
    judges = (surely, lambda table: weighed(table, Calibration(10.0, 120.0, 2.0, 0.5), Waiting(tuple(weights)), 100.0))

    def stops(given):
        table = replayed(estimator, given, "x", np.arange(len(corpus)), instants)
        return stopped(judges[seed % 2](table), threshold)

    before = stops(corpus)
    frames = corpus.frames.copy()
    for i, seen in enumerate(before["frames"]):
        rest = slice(corpus.starts[i] + seen, corpus.starts[i] + corpus.lengths[i])
        frames[rest] = np.random.default_rng(seed).integers(0, 3, frames[rest].shape)
    pd.testing.assert_frame_equal(before, stops(corpus.changed(frames=frames)))


def replay_fold(cell, corpus, train, test):
    return do_fold(Stream(), cell, corpus, Fold("2", train, test), 1, "key")


def test_no_test_subject_has_a_say_in_calibration_and_threshold():
    from bench.plan.cells import cells

    corpus = random_corpus(subjects=5, per_class=2, grid=(3, 4))
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    (cell,) = cells({"model": "bayes", "features": "jung54"})
    first = replay_fold(cell, corpus, train, test)
    assert not first.error
    other = replay_fold(cell, with_other_values(corpus, test), train, test)
    assert first.chosen == other.chosen and first.trials.equals(other.trials)
    assert not first.predictions.equals(other.predictions)
    learnt = replay_fold(cell, with_other_values(corpus, train[::2]), train, test)
    assert first.chosen != learnt.chosen


def test_training_subjects_are_judged_by_systems_that_never_met_them():
    corpus = coded_corpus()
    met = []

    class Watched(Rising):
        def fit(self, X, y):
            self.met_ = set(X.subjects)
            return super().fit(X, y)

        def predict_proba(self, X):
            met.append((self.met_, set(unblinded(X)[0].subjects)))
            return super().predict_proba(X)

    train = np.flatnonzero(corpus.subjects != "3")
    learned(Watched, corpus, train, Replay())
    assert met and all(not seen & judged and "3" not in seen | judged for seen, judged in met)


def test_the_whole_capture_scores_as_bench_run_and_a_second_command_computes_nothing(capsys):
    assert main(["run", *(a for a in SMALL if not a.startswith("hop_ms"))]) == 0
    assert main(["stream", *SMALL, "out=one"]) == 0
    captured = capsys.readouterr()
    assert "stopped" in captured.out and "synthetic" in captured.out
    (client, (cell,)), (_, (parent,)) = runs("cell"), runs("stream")
    assert parent.data.metrics["accuracy"] == cell.data.metrics["accuracy"]
    whole = stopped(predictions(client, parent), np.inf).set_index(["fold", "capture"])
    plain = predictions(client, cell).set_index(["fold", "capture"]).loc[whole.index]
    columns = [c for c in plain if c.startswith("p_")]
    np.testing.assert_allclose(whole[columns], plain[columns], rtol=1e-6)
    names = {
        "adaptive_accuracy",
        "adaptive_ms",
        "mean_ms",
        "decide_ms_p99",
        "predict_ms_p99",
        "fit_cpu_seconds",
        "decisions_per_second",
        "accuracy_at_1000_ms",
    }
    assert names <= set(parent.data.metrics)
    assert parent.data.params["stream.start"] == "onset" and parent.data.tags["synthetic"] == "true"
    kept = {a.path for a in client.client.list_artifacts(parent.info.run_id)}
    assert kept == {
        "predictions.parquet",
        "instants.csv",
        "stopping.csv",
        "chosen.csv",
        "trials.csv",
        "streaming.png",
        "streaming.svg",
    }
    assert len(runs("stream_fold")[1]) == 3 and len(runs("fold")[1]) == 3

    assert main(["stream", *SMALL, "out=two"]) == 0
    assert "all 3 folds were stored before" in capsys.readouterr().err and len(runs("stream_fold")[1]) == 3
    assert open("one/streaming.csv").read() == open("two/streaming.csv").read()
    assert main(["report"]) == 0  # sees the cell alone
    assert len(pd.read_csv("report/comparison.csv")) == 1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["hop_ms=0"], "above 0"),
        (["hop_ms=1"], "one frame takes"),
        (["start=end"], "give onset or middle"),
        (["out=/dev/null/x"], "choose another folder"),
        (["data.subjects=2"], "only one subject trains"),
        (["source=file", "model=x"], "source=- to read standard input"),
        (["source=-"], "needs model="),
        (["source=-", "model=nothing"], "not a saved model"),
        (["source=-", "model=x", "data=haart"], "data= means nothing here"),
        (["window_ms=3"], "only with source=-"),
    ],
)
def test_what_cannot_be_streamed_is_refused(arguments, told, capsys):
    assert main(["stream", *arguments]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
