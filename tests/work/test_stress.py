"""`bench stress`: what is fitted on what, what is tracked, and what a second command does."""

import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from sklearn.base import BaseEstimator, ClassifierMixin

from bench.cli import main
from bench.corpora.faults import FAULTS, as_shares, damaged
from bench.outcomes import scores
from bench.outcomes.stability import COLUMNS
from bench.plan.cells import cells
from bench.plan.plan import Fold, Plan, folds_of
from bench.work.evaluation import Evaluation
from bench.work.stress import Stress, labelled, subset
from bench.work.tracking import key_of
from bench.work.workers import do_fold
from tests.conftest import random_corpus, runs, with_other_values

SMALL = ["stress", "data.subjects=4", "data.variants=normal", "jobs=2"]
FEW = tuple(FAULTS[name] for name in ("noise", "early_end"))


def table_of(client, run_):
    return pd.read_parquet(client.fetched(run_.info.run_id, "stress.parquet"))


class Recorder(ClassifierMixin, BaseEstimator):
    """Remembers what it was fitted on; labels by level."""

    seen = []

    def fit(self, X, y):
        level = np.array([frames.mean() for frames in X])
        self.classes_ = np.unique(y)
        self.means_ = np.array([level[y == c].mean() for c in self.classes_])
        self.seen.append((self, [frames.copy() for frames in X], X.index.copy(), pickle.dumps(vars(self))))
        return self

    def predict_proba(self, X):
        apart = np.abs(np.array([frames.mean() for frames in X])[:, None] - self.means_)
        return np.exp(-apart) / np.exp(-apart).sum(axis=1, keepdims=True)


def stressed(cell, corpus, fold, faults=FEW, fewer=()):
    return do_fold(Stress(faults, fewer), cell, corpus, fold, 1, "key")


def recorded(corpus, train, test, fewer=(), seed=0):
    Recorder.seen = []
    cell = SimpleNamespace(title=lambda: "a cell", estimator=Recorder, seed=seed)
    result = stressed(cell, corpus, Fold("x", train, test), fewer=fewer)
    assert not result.error, result.error
    return result.predictions, Recorder.seen


def test_only_clean_training_captures_are_seen_and_faults_leave_what_was_learnt(corpus):
    test = np.flatnonzero(corpus.subjects == "2")
    train = np.flatnonzero(corpus.subjects != "2")
    table, seen = recorded(corpus, train, test)
    ((model, frames, index, learnt),) = seen  # fitted once, whatever the faults
    assert np.array_equal(index, train)
    assert all(np.array_equal(a, corpus[int(i)]) for a, i in zip(frames, train, strict=True))
    assert pickle.dumps(vars(model)) == learnt
    _, others = recorded(with_other_values(corpus, test), train, test)
    assert others[0][3] == learnt
    assert len(table) == len(test) * 11 and set(table) == {
        "fold",
        "capture",
        "true",
        *(COLUMNS - {"hit"}),
        "subject",
        "repetition",
    }
    noisy = table[table["fault"] == "noise"].groupby("severity")["amount"].first()
    assert noisy.to_dict() == {s: FEW[0].describe(s) for s in range(1, 6)}
    clean = table[table["fault"] == "none"]
    assert clean["amount"].eq("").all() and (clean["length"].to_numpy() == corpus.lengths[test]).all()
    assert (table["train_subjects"] == 3).all()


def test_fewer_training_subjects_are_among_more_and_never_tested(corpus):
    test = np.flatnonzero(corpus.subjects == "2")
    train = np.flatnonzero(corpus.subjects != "2")
    table, seen = recorded(corpus, train, test, fewer=(1, 2))
    chosen = [set(corpus.subjects[index]) for _, _, index, _ in seen]
    assert [len(c) for c in chosen] == [3, 1, 2] and chosen[1] < chosen[2] < chosen[0] and "2" not in chosen[0]
    fewer = table[table["train_subjects"] < 3]
    assert fewer["fault"].eq("none").all() and len(fewer) == 2 * len(test)
    assert np.array_equal(subset(corpus, train, test, 2, 0), subset(corpus, train, test, 2, 0))
    drawn = {tuple(sorted(set(corpus.subjects[subset(corpus, train, test, 1, seed)]))) for seed in range(20)}
    assert len(drawn) == 3  # other seeds, other subjects


@pytest.mark.parametrize("model", ["svm", "cnn85"])
def test_clean_captures_and_severity_0_get_the_labels_of_bench_run(model):
    corpus = random_corpus(per_class=2)
    (cell,) = cells({"model": model} | ({"model.epochs": "1", "model.frames": "10"} if model == "cnn85" else {}))
    fold = folds_of(cell, corpus)[1]
    expected = do_fold(Evaluation(), cell, corpus, fold, 1, "key")
    assert not expected.error
    expected = scores.captures(expected.predictions)
    found = stressed(cell, corpus, fold)
    assert not found.error, found.error
    found = found.predictions
    clean = found[found["fault"] == "none"]
    for column in ("fold", "capture", "true", "predicted", "subject"):
        assert clean[column].tolist() == expected[column].tolist()
    estimator = cell.estimator().fit(corpus[fold.train], corpus.gestures[fold.train])
    shares = as_shares(corpus, fold.test)
    unharmed = damaged(corpus, fold.test, shares, FAULTS["cover"], 0)
    again = labelled(estimator, unharmed, fold.name, fold.test, {})
    assert again["predicted"].tolist() == expected["predicted"].tolist()
    assert np.array_equal(again["p_true"], clean["p_true"])


def test_labels_are_right_where_a_class_is_not_tested_and_a_window_net_decides_often(corpus):
    class Windows(Recorder):
        def decide(self, X):
            position = np.repeat(np.arange(len(X)), 2)
            proba = np.tile([[0.0, 0.2, 0.8], [0.0, 0.7, 0.3]], (len(X), 1))
            return pd.DataFrame({"capture": position, "start": 0, "frames": 1}), proba

    model = Windows().fit(corpus, corpus.gestures)
    test = np.flatnonzero((corpus.gestures != "pat") & (corpus.subjects == "3"))
    found = labelled(model, corpus, "3", test, {})
    assert found["predicted"].eq("tap").all() and found["capture"].tolist() == test.tolist()
    assert found["p_true"].tolist() == pytest.approx(np.where(found["true"] == "tap", 0.55, 0.45))


def test_a_command_is_tracked_written_and_found_again(monkeypatch, capsys):
    command = [*SMALL, "model=bayes,svm", "faults=noise,shift", "train_subjects=2"]
    assert main(command) == 0
    out = capsys.readouterr().out
    assert "synth (synthetic)" in out and "generated captures" in out and "svm · jung54" in out
    assert "Kendall" in Path("stress/stability.md").read_text()
    client, parents = runs("stress")
    assert [p.info.status for p in parents] == ["FINISHED"] * 2 and len(runs("stress_fold")[1]) == 8
    assert not runs("cell")[1] and not runs("fold")[1]
    bayes = parents[0]
    assert bayes.data.tags["synthetic"] == "true" and bayes.data.tags["system"] == "bayes · jung54"
    assert bayes.data.params["faults"] == "noise, shift" and bayes.data.params["train_subjects"] == "2"
    table = table_of(client, bayes)
    assert len(table) == 56 * (1 + 10 + 1)
    hit = table["true"] == table["predicted"]
    chosen = (table["fault"] == "noise") & (table["severity"] == 3)
    assert bayes.data.metrics["accuracy.noise.3"] == pytest.approx(hit[chosen].mean())
    clean = (table["fault"] == "none") & (table["train_subjects"] == 3)
    assert bayes.data.metrics["accuracy"] == pytest.approx(hit[clean].mean())
    assert {
        "loss.noise",
        "loss.shift",
        "chance",
        "failing_slices",
        "fit_seconds",
        "fault_seconds",
        "accuracy.train_subjects.2",
        "worst.subject",
        "folds",
    } <= set(bayes.data.metrics)
    written = {p.name for p in Path("stress").iterdir()}
    kept = {Path(a.path).name for a in client.client.list_artifacts(bayes.info.run_id, "stability")}
    assert kept == written and {"stability.md", "stability_heat_map.svg", "stability_slices.csv"} <= written
    assert "synth (synthetic)" in Path("stress/stability_heat_map.svg").read_text().replace("<!-- ", "")
    for path in Path("stress").glob("*.csv"):
        assert pd.read_csv(path)["data"].eq("synth (synthetic)").all()

    monkeypatch.setattr("reports.stability_figures.draw", lambda *_: [])
    before = {p.name: p.read_bytes() for p in Path("stress").glob("*.csv")}
    assert main(command) == 0  # the same again computes nothing and tells the same
    assert "stored before" in capsys.readouterr().err and len(runs("stress_fold")[1]) == 8
    assert {p.name: p.read_bytes() for p in Path("stress").glob("*.csv")} == before

    assert main(["report"]) == 2  # a stressed run is no row of the comparison
    assert "no scored run" in capsys.readouterr().err


def test_what_a_system_raises_is_the_folds_result(corpus):
    class Broken(Recorder):
        def predict_proba(self, X):
            if X.frames.max() > 1000:
                raise ValueError("too loud")
            return super().predict_proba(X)

    cell = SimpleNamespace(title=lambda: "a cell", estimator=Broken, seed=None)
    fold = Fold("x", np.arange(18), np.arange(18, 36))
    result = stressed(cell, corpus, fold, (FAULTS["stuck_taxels"],))
    assert "too loud" in result.error and result.predictions is None


def test_without_faults_there_is_the_learning_curve_alone():
    command = [*SMALL, "model=bayes", "features=jung28", "faults=none", "train_subjects=1,2"]
    assert main(command) == 0
    client, (run,) = runs("stress")
    assert run.data.params["faults"] == "none" and '"faults": "none"' in run.data.tags["touchbench.arguments"]
    table = table_of(client, run)
    assert table["fault"].eq("none").all() and sorted(table["train_subjects"].unique()) == [1, 2, 3]
    assert len(pd.read_csv("stress/stability_learning.csv")) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["faults=nois"], "faults=nois: not known; did you mean noise"),
        (["faults=noise,"], "nothing between two commas"),
        (["train_subjects=0"], "train_subjects=0: give whole numbers from 1 on"),
        (["train_subjects=few"], "train_subjects=few: give a whole number"),
        (["train_subjects=3"], "train_subjects=3: fold 1 of protocol=loso has 3 training subjects"),
        (["severities=2"], "no key is called 'severities'"),
        (["out=taken/here"], "taken/here cannot be written"),
    ],
)
def test_bad_input_is_one_line(arguments, message, capsys):
    Path("taken").write_text("a file")
    assert main([*SMALL, "model=bayes", *(["faults=noise"] if "out" in arguments[0] else []), *arguments]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert message in error


def test_a_column_that_the_table_needs_is_refused(corpus, monkeypatch, capsys):
    named = corpus.changed(captures=corpus.captures.assign(severity=1))
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: named)
    assert main(["stress"]) == 2
    assert "random has a column 'severity'" in capsys.readouterr().err


def test_other_faults_or_training_subjects_are_another_run(corpus):
    (cell,) = cells({"model": "bayes"})
    plan = Plan(cell, corpus, tuple(folds_of(cell, corpus)), 1, 1)
    keys = [key_of(plan, Stress(*how)) for how in ((FEW, ()), (FEW[:1], ()), (FEW, (2,)))]
    assert len(set(keys)) == 3 and keys[0] == key_of(plan, Stress(FEW))
    assert key_of(plan, Evaluation()) not in keys


def test_no_faulted_capture_reaches_the_feature_cache(tmp_path, monkeypatch):
    from bench.corpora.library import open_corpus
    from bench.scratch import home

    (cell,) = cells({"model": "bayes", "data.subjects": "2", "data.variants": "normal"})
    corpus = open_corpus(cell.data, cell.data_parameters)
    fold = folds_of(cell, corpus)[0]
    assert not stressed(cell, corpus, fold).error
    (kept,) = (home() / "features").glob("*.parquet")
    assert pd.read_parquet(kept).equals(cell.features.make().extract(corpus))
