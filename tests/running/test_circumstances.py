"""Circumstances: what is fitted on what, what is predicted in which case, and the measures."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bench.corpora.faults import FAULTS, as_shares, damage_captures
from bench.errors import InputError
from bench.ground.registry import load_views
from bench.plan.grid import make_cells
from bench.plan.plan import Fold, make_plans
from bench.running import loop
from bench.running.circumstances.faults import Faults
from bench.running.circumstances.instants import Instants
from bench.running.circumstances.subjects import Subjects, captures_of_subjects
from bench.running.evaluation import evaluate_fold, measure_run
from bench.values import scores
from bench.values.stability import COLUMNS, clean_labels
from tests.conftest import random_corpus, with_other_values
from tests.running.fakes import Level, MemoryStore, fake_cell

FEW = ("noise", "early_end")
CORPUS = random_corpus(per_class=2, grid=(4, 4))
TEST, TRAIN = np.flatnonzero(CORPUS.subjects == "2"), np.flatnonzero(CORPUS.subjects != "2")
FOLD = Fold("x", TRAIN, TEST)
ABOUT = {"system": "Level", "seed": "0", "data": "random", "synthetic": "false"}
ABOUT |= {"subset": "all", "target": "gesture", "protocol_label": "LOSO"}


class Recorder(Level):
    """Remembers what it was fitted on."""

    seen = []

    def fit(self, X, y):
        super().fit(X, y)
        self.seen.append(
            (self, [frames.copy() for frames in X], X.index.copy(), pickle.dumps(vars(self)))
        )
        return self


def evaluate_once(*circumstances, system=Level):
    """A fold of a system of tests, and the run of it."""
    cell = fake_cell(system, *circumstances)
    result = evaluate_fold(cell, CORPUS, FOLD, 1)
    return result, measure_run(SimpleNamespace(corpus=CORPUS, cell=cell), ABOUT, [result])


def evaluate_recorded(corpus, *more):
    Recorder.seen = []
    return evaluate_fold(fake_cell(Recorder, Faults(FEW), *more), corpus, FOLD, 1), Recorder.seen


@pytest.fixture(scope="module")
def stressed():
    """A fold with two faults and one or two training subjects besides, and every fit in it."""
    return evaluate_recorded(CORPUS, Subjects((1, 2)))


def test_only_clean_training_captures_are_seen_and_faults_leave_what_was_learned(stressed):
    result, ((model, frames, index, learned), *_) = stressed
    assert np.array_equal(index, TRAIN)
    assert all(np.array_equal(a, CORPUS[int(i)]) for a, i in zip(frames, TRAIN, strict=True))
    assert pickle.dumps(vars(model)) == learned
    _, others = evaluate_recorded(with_other_values(CORPUS, TEST))
    assert len(others) == 1 and others[0][3] == learned  # fitted once, whatever the faults
    table = result.tables["labels"]
    assert set(table) == {"fold", "capture", "true", *(COLUMNS - {"hit"}), "subject", "repetition"}
    noisy = table[table["case"] == "noise"].groupby("level")["amount"].first()
    assert noisy.to_dict() == {s: FAULTS["noise"].describe(s) for s in range(1, 6)}
    assert (clean_labels(table)["length"].to_numpy() == CORPUS.lengths[TEST]).all()


def test_fewer_training_subjects_are_among_more_and_never_tested(stressed):
    result, seen = stressed
    chosen = [set(CORPUS.subjects[index]) for _, _, index, _ in seen]
    assert (
        [len(c) for c in chosen] == [3, 1, 2]
        and chosen[1] < chosen[2] < chosen[0]
        and "2" not in chosen[0]
    )
    fewer = result.tables["labels"].query("circumstance == 'train_subjects'")
    assert len(fewer) == 2 * len(TEST) and (fewer["level"] == fewer["train_subjects"]).all()
    drawn = {
        tuple(sorted(set(CORPUS.subjects[captures_of_subjects(CORPUS, TRAIN, TEST, 1, seed)])))
        for seed in range(20)
    }
    assert len(drawn) == 3  # other seeds, other subjects


def test_labels_under_a_fault_are_those_of_the_damaged_captures_and_clean_ones_those_of_bench_run(
    stressed,
):
    result = stressed[0]
    table, whole = result.tables["labels"], evaluate_once()[0].table
    pd.testing.assert_frame_equal(result.table, whole)
    expected, clean = scores.label_captures(whole), clean_labels(table)
    for column in ("fold", "capture", "true", "predicted", "subject"):
        assert clean[column].tolist() == expected[column].tolist()
    system, shares = Level().fit(CORPUS[TRAIN], CORPUS.gestures[TRAIN]), as_shares(CORPUS, TEST)
    for fault in map(FAULTS.__getitem__, FEW):
        for severity in range(6):
            worse = damage_captures(CORPUS, TEST, shares, fault, severity)
            part = (
                table[(table["case"] == fault.name) & (table["level"] == severity)]
                if severity
                else clean
            )
            proba = system.predict_proba(worse[TEST])
            assert part["predicted"].tolist() == system.classes_[proba.argmax(axis=1)].tolist()
            p_true = proba[
                np.arange(len(TEST)), np.searchsorted(system.classes_, CORPUS.gestures[TEST])
            ]
            np.testing.assert_allclose(part["p_true"], p_true, rtol=1e-6)


class Shy(Level):
    """Abstains where no class is likely enough."""

    abstains = "unknown"

    def predict_proba(self, X):
        proba = super().predict_proba(X)
        return np.where(proba.max(axis=1, keepdims=True) > 0.9945, proba, np.nan)

    def predict(self, X):
        proba = self.predict_proba(X)
        return np.where(
            np.isnan(proba[:, 0]), "unknown", self.classes_[np.nan_to_num(proba).argmax(axis=1)]
        )


def test_abstentions_are_wrong_in_every_circumstance_and_their_share_is_told():
    _, run = evaluate_once(Faults(("noise",)), Instants((250.0, 1000.0)), system=Shy)
    system, shares = Shy().fit(CORPUS[TRAIN], CORPUS.gestures[TRAIN]), as_shares(CORPUS, TEST)
    for severity, row in run.tables["faults"].set_index("severity").iterrows():
        proba = system.predict_proba(
            damage_captures(CORPUS, TEST, shares, FAULTS["noise"], severity)[TEST]
        )
        gone = np.isnan(proba[:, 0])
        hit = system.classes_[np.nan_to_num(proba).argmax(axis=1)] == CORPUS.gestures[TEST]
        assert (row["accuracy"], row["abstained"]) == ((hit & ~gone).mean(), gone.mean())
    gone = np.isnan(system.predict_proba(CORPUS[TEST])[:, 0]).mean()
    assert 0 < run.metrics["abstained"] == gone < 1


def test_one_run_in_several_circumstances_has_what_a_run_in_each_has():
    every = (Faults(("noise",)), Instants((250.0, 1000.0)), Subjects((1,)))
    together, measured = evaluate_once(*every)
    for one in every:
        alone, run = evaluate_once(one)
        pd.testing.assert_frame_equal(alone.table, together.table)
        for name, table in alone.tables.items():
            found = together.tables[name]
            if name == "labels":
                found = found[found["circumstance"].isin(["", one.key])].reset_index(drop=True)
            pd.testing.assert_frame_equal(found, table)
        parts = ("accuracy", "loss", "replay_accuracy", "failing_slices.", "chance")
        same = {name: value for name, value in run.metrics.items() if name.startswith(parts)}
        assert len(same) > 3 and same.items() <= measured.metrics.items()
    labels = together.tables["labels"].assign(hit=lambda rows: rows["true"] == rows["predicted"])
    noisy = labels.loc[(labels["case"] == "noise") & (labels["level"] == 3), "hit"].mean()
    assert (
        measured.metrics["accuracy.noise.3"]
        == together.tracked_metrics["accuracy.noise.3"]
        == noisy
    )
    fewer = labels.loc[labels["train_subjects"] == 1, "hit"].mean()
    assert (
        measured.metrics["accuracy.train_subjects.1"]
        == together.tracked_metrics["accuracy.train_subjects.1"]
        == fewer
    )
    assert "stopping" not in measured.tables and {"fault", "time"} <= {
        *measured.tables["slices"]["circumstance"]
    }


def test_a_circumstance_that_fails_in_a_fold_leaves_the_others_and_is_tried_again(
    monkeypatch, capsys
):
    memory, replayed = MemoryStore(), Instants.evaluate_fold
    monkeypatch.setattr(loop, "connect", lambda writes: memory)
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: CORPUS)
    (cell,) = make_cells({"model": "bayes", "features": "jung28"})

    def run(evaluate):
        monkeypatch.setattr(Instants, "evaluate_fold", evaluate)
        every = (Faults(("noise",)), Instants((250.0,)))
        return *loop.run_plans(
            make_plans([replace(cell, circumstances=every)], 1)
        ), capsys.readouterr().err

    def fails(self, at):
        if at.fold.name == "2":
            raise ValueError("no replay")
        return replayed(self, at)

    first, said = run(fails)
    assert said.count("fold 2, after= failed: ValueError: no replay") == 1
    assert (
        first.is_complete
        and load_views()["under"].applies_to(first)
        and not load_views()["after"].applies_to(first)
    )
    assert {"accuracy", "loss.noise"} <= {*first.metrics} and "replay_accuracy" not in first
    second, said = run(replayed)
    assert "fold 2 done" in said and "fold 1 done" not in said
    assert (
        load_views()["after"].applies_to(second)
        and second["replay_accuracy"] > 0
        and not second.failed_circumstances
    )


def test_times_in_another_order_are_the_same_run():
    (one,), (other,) = (
        Instants.from_typed({"after": text})
        for text in ("200ms,1234.5678ms,100ms", "100ms,200ms,1234.5678ms")
    )
    assert one == other and one.params() == other.params()
    assert Instants.from_typed(one.typed_arguments()) == [one]


def test_a_column_that_tables_of_labels_need_is_refused_before_anything_runs(monkeypatch):
    (cell,) = make_cells({"model": "bayes", "features": "jung28"})
    named = CORPUS.with_fields(captures=CORPUS.captures.assign(level=1))
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: named)
    with pytest.raises(InputError, match="'level'"):
        make_plans([replace(cell, circumstances=(Faults(FEW),))], 1)
    assert make_plans([cell], 1)
