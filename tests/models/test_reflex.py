"""reflex: what it is made of, and that nothing of the people it is tested on reaches it."""

from functools import partial

import numpy as np
import pandas as pd
import pytest

from bench import contract
from bench.cli import main
from bench.commands import printing
from bench.corpora.corpus import Corpus
from bench.corpora.faults import known
from bench.corpora.steps import Repair, Windows
from bench.errors import InputError
from bench.plan.cells import cells
from features.touch import TouchFeatures
from models.classic.lda import Discriminants
from models.classic.perceptron import Perceptron
from models.out_of_distribution import Guarded
from models.reflex import Reflex
from tests.conftest import random_corpus, runs, with_other_values

QUICK = {"copies": 1}


@pytest.fixture(autouse=True)
def few_updates(monkeypatch):
    """The network learns for a shorter time than it does for a user."""
    monkeypatch.setattr("models.out_of_distribution.Perceptron", partial(Perceptron, updates=100))


@pytest.fixture(scope="module")
def corpus():
    made = random_corpus(subjects=4, per_class=3, grid=(4, 5))
    lengths = np.resize([12, 25, 40, 60, 90], len(made))
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 400, (n, 4, 5)).astype(np.uint16) * (1 + i % 3) for i, n in enumerate(lengths)]
    return Corpus.from_captures(frames, made.captures, 30.0)


def test_a_capture_is_the_mean_of_its_windows_and_a_short_one_has_weights_of_its_own(corpus):
    system = Reflex(faults=("none",)).fit(corpus, corpus.gestures)
    found = system.predict_proba(corpus)
    for seconds, judge, short in ((1.0, Guarded(), False), (0.5, Discriminants(), True)):
        rows, tables = [], []
        for i in range(len(corpus)):
            cut = Windows(seconds)(Repair(("stuck", "dead"))(corpus[[i]]))
            rows += [i] * len(cut)
            tables.append(TouchFeatures().extract(cut))
        index = pd.MultiIndex.from_arrays([rows, [0] * len(rows)], names=["capture", "copy"])
        table = pd.concat(tables).set_axis(index)
        judge.fit(table, corpus.gestures[rows])
        each = judge.predict_proba(table)
        for i in range(len(corpus)):
            if (corpus.lengths[i] < 30) == short:
                np.testing.assert_allclose(found[i], each[np.array(rows) == i].mean(axis=0), atol=1e-5)
    table, proba = system.decide(corpus)
    assert (np.diff(table["capture"]) >= 0).all() and len(table) == len(proba)
    assert set(table["frames"]) == {12, 15, 30}


def test_undamaged_captures_are_what_is_not_doubted(corpus):
    """The discriminants and what is usual come from captures as they are, the network from their copies as well."""
    bare, damaged = (Reflex(faults=(f,), copies=2).fit(corpus, corpus.gestures) for f in ("none", "noise"))
    bare, damaged = (system.members[0].system_.named_steps["classifier"] for system in (bare, damaged))
    np.testing.assert_allclose(bare.linear_.coef_, damaged.linear_.coef_, rtol=1e-9)
    assert np.array_equal(bare.mean_, damaged.mean_) and np.array_equal(bare.sd_, damaged.sd_)
    assert not np.allclose(bare.robust_.mean_, damaged.robust_.mean_)


@pytest.mark.parametrize("changed", ["test", "train"])
def test_no_test_subject_has_a_say_in_what_it_learns(corpus, changed):
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")

    def learnt(given):
        system = Reflex(**QUICK).fit(given[train], given.gestures[train])
        judge, early = (recipe.system_.named_steps["classifier"] for recipe in system.members)
        parts = [early.coef_, judge.linear_.coef_, judge.mean_, judge.sd_, *judge.robust_.coefs_, judge.robust_.scale_]
        return np.concatenate([part.ravel() for part in parts])

    other = with_other_values(corpus, test if changed == "test" else train[::2])
    assert np.array_equal(learnt(corpus), learnt(other)) == (changed == "test")


def test_it_does_not_depend_on_the_captures_it_decides_with(corpus):
    system = Reflex(**QUICK).fit(corpus, corpus.gestures)
    whole = system.predict_proba(corpus)
    for i in (0, 7, len(corpus) - 1):
        np.testing.assert_allclose(system.predict_proba(corpus[[i]].detached())[0], whole[i], atol=1e-9)


@pytest.mark.parametrize("grid, rate, real", [((1, 2), 8.0, False), ((19, 24), 12.0, True), ((6, 6), 12.0, False)])
def test_any_grid_rate_and_kind_of_number(grid, rate, real):
    made = random_corpus(subjects=3, per_class=2, grid=grid)
    scale = np.float32(0.25) if real else 1
    given = Corpus.from_captures([f * scale for f in made], made.captures, rate, full_scale=1023.0 * float(scale))
    system = Reflex(**QUICK).fit(given, given.gestures)
    found = system.predict_proba(given)
    assert np.isfinite(found).all() and np.allclose(found.sum(axis=1), 1)
    one_frame = Corpus.from_captures([given[0][:1]], given.captures[:1], rate, full_scale=given.full_scale)
    assert np.isfinite(system.predict_proba(one_frame)).all()


def test_what_it_says_of_itself(corpus):
    system = Reflex(**QUICK)
    assert contract.trained_faults(system) == tuple(known())
    assert contract.trained_faults(Reflex(faults=("none",))) == ()
    for wrong in (
        {"early": 2.0},
        {"faults": ("nosie",)},
        {"repair": ("glue",)},
        {"window": -1.0},
        {"units": 0},
        {"doubt": 0.0},
    ):
        with pytest.raises(InputError):
            contract.check(Reflex(**wrong))


@pytest.mark.parametrize("model", ["reflex", "bayes"])
def test_more_copies_than_memory_are_refused_before_anything_is_run(model, capsys):
    asked = ["data.subjects=3", "data.variants=normal", "model.faults=noise", "model.copies=1000000"]
    assert main(["run", f"model={model}", *asked]) == 2
    assert "model.copies=1000000: needs at least" in capsys.readouterr().err


def test_stress_says_on_how_many_of_the_tested_faults_it_was_trained(capsys, monkeypatch):
    monkeypatch.setattr(printing, "WIDTH", 140)
    small = ["data.subjects=3", "data.variants=normal", "faults=noise,shift"]
    assert main(["stress", *small, "model=lda", "features=jung28", "model.faults=noise", "model.copies=1"]) == 0
    (run,) = runs("stress")[1]
    assert run.data.metrics["faults_trained"] == 1 and run.data.metrics["faults_tested"] == 2
    assert "1 of 2" in " ".join(capsys.readouterr().out.split())


def test_tune_searches_windows(capsys):
    small = ["data.subjects=3", "data.variants=normal", "model=lda", "features=jung28"]
    assert main(["tune", *small, "model.window=0.0,0.5", "model.repair=stuck+dead"]) == 0
    assert "window" in capsys.readouterr().out


def test_its_parameters_are_told_like_those_of_others():
    (cell,) = cells({"model": "reflex", "model.faults": "noise+shift"})
    assert cell.title() == "reflex[faults=noise+shift] | synth | loso"
    assert cell.estimator().trained_faults == ("noise", "shift")


def test_seconds_are_those_of_the_captures_it_is_given(corpus):
    """At twice the rate a second has twice the frames; what is shorter goes to the discriminants for short windows."""
    system = Reflex(**QUICK).fit(corpus, corpus.gestures)
    faster = Corpus.from_captures([corpus[0][:1].repeat(n, axis=0) for n in (30, 45, 60)], corpus.captures[:3], 60.0)
    table, _ = system.decide(faster)
    assert table.groupby("capture")["frames"].max().tolist() == [30, 30, 60]
