"""reflex: its perceptron against scikit-learn's, the guard against its two classifiers."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.preprocessing import StandardScaler

from bench.corpora.corpus import Corpus
from bench.corpora.windows import Windows
from bench.features.base import capture_copy_index
from bench.features.touch import TouchFeatures
from bench.models import out_of_distribution
from bench.models.classic.lda import Discriminants
from bench.models.classic.perceptron import Perceptron
from bench.models.out_of_distribution import GuardedDiscriminants
from bench.models.reflex import Reflex
from bench.models.sizes import count_parameters
from bench.models.steps import Repair
from tests.conftest import random_corpus

Quick = partial(Perceptron, updates=100)


@pytest.fixture(autouse=True)
def few_updates(monkeypatch):
    """The network learns for a shorter time than it does for a user."""
    monkeypatch.setattr(out_of_distribution, "Perceptron", Quick)


def table(rows=300, d=6, copies=2):
    """Three classes that no line separates, two windows a capture, some copies with a fault."""
    rng = np.random.default_rng(0)
    y = rng.integers(0, 3, rows)
    X = rng.normal(size=(rows, d)).astype(np.float32)
    X[:, 0] += 3 * np.array([1, -1, 0])[y]
    X[:, 1] += 4 * np.abs(y - 1)
    copy = rng.integers(0, copies + 1, rows)
    X[copy > 0, 2] += 30
    index = pd.MultiIndex.from_arrays([np.arange(rows) // 2, copy], names=["capture", "copy"])
    return (
        pd.DataFrame((X * 10.0 ** np.arange(d)).astype(np.float32), index=index),
        np.array([*"abc"])[y],
        copy == 0,
    )


def test_the_perceptron_decides_as_scikit_learns_network_of_the_same_weights():
    X, y, _ = table(copies=0)
    ours = Quick(units=7, clip=2.0).fit(X, y)
    with pytest.warns(ConvergenceWarning):  # its weights are replaced
        theirs = MLPClassifier((7,), max_iter=1).fit(np.zeros((3, 6)), [*"abc"])
    theirs.coefs_, theirs.intercepts_ = ours.coefs_, ours.intercepts_
    given = StandardScaler().fit(X).transform(X).clip(-2, 2)
    np.testing.assert_allclose(ours.predict_proba(X), theirs.predict_proba(given), atol=1e-4)
    assert count_parameters(ours) == 6 * 7 + 7 + 7 * 3 + 3 + 2 * 6


def test_rows_are_drawn_as_often_as_they_count():
    """Copies of low weight change nearly nothing; copies of full weight do."""
    X, y, whole = table()
    alone, hardly, much = (
        Quick().fit(X[whole], y[whole]),
        Quick(damaged=1e-12).fit(X, y),
        Quick().fit(X, y),
    )
    np.testing.assert_allclose(hardly.mean_, alone.mean_, rtol=1e-4)
    np.testing.assert_allclose(hardly.coefs_[0], alone.coefs_[0], atol=1e-4)
    assert abs(much.mean_[2] - alone.mean_[2]) > 1


def test_one_feature_says_no_more_than_its_clip():
    """Values beyond the clip make no difference, nor does a feature constant in training."""
    X, y, _ = table(rows=60)
    X["still"] = 7.0
    model = Quick().fit(X, y)
    far, further = X.copy(), X.copy()
    far.iloc[:, 0], further.iloc[:, 0] = 1e3, 1e30
    further["still"] = -1e9
    assert np.array_equal(model.predict_proba(far), model.predict_proba(further))
    assert np.isfinite(model.predict_proba(further)).all()


def test_in_doubt_the_network_decides_and_else_discriminants_of_undamaged_rows():
    """Doubt counts features beyond two and a half deviations."""
    X, y, whole = table()
    away = ((X - X[whole].mean()).abs() > 2.5 * X[whole].std(ddof=0)).sum(axis=1)
    linear = Discriminants(windows=2.0).fit(X[whole], y[whole]).predict_proba(X)
    network = Quick(units=18).fit(X, y).predict_proba(X)
    for doubt in (1 / 6, 0.5, 1.0):
        model, share = (
            GuardedDiscriminants(doubt=doubt).fit(X, y),
            (away / 6 / doubt).clip(upper=1).to_numpy(),
        )
        np.testing.assert_allclose(model.network_weights(X), share)
        expected = (1 - share[:, None]) * linear + share[:, None] * network
        np.testing.assert_allclose(model.predict_proba(X), expected, atol=1e-9)
        assert share[~whole].min() >= 1 / 6 and 0 < (share == 0).sum() < len(X)
    assert count_parameters(model) == 2 * 6 + 3 * 6 + 3 + (6 * 18 + 18 + 18 * 3 + 3 + 2 * 6)


def test_a_capture_is_the_mean_of_its_windows_and_a_short_one_has_weights_of_its_own():
    made = random_corpus(subjects=4, per_class=3)
    rng, lengths = np.random.default_rng(0), np.resize([12, 25, 40, 60, 90], len(made))
    frames = [
        rng.integers(0, 400, (n, 4, 5)).astype(np.uint16) * (1 + i % 3)
        for i, n in enumerate(lengths)
    ]
    corpus = Corpus.from_captures(frames, made.captures, 30.0)
    system = Reflex(faults=("none",)).fit(corpus, corpus.gestures)
    proba = system.predict_proba(corpus)
    for seconds, judge, short in (
        (1.0, GuardedDiscriminants(), False),
        (0.5, Discriminants(), True),
    ):
        cuts = [
            Windows(seconds)(Repair(("stuck", "dead"))(corpus[[i]])) for i in range(len(corpus))
        ]
        rows = np.repeat(np.arange(len(corpus)), [len(cut) for cut in cuts])
        features = pd.concat([TouchFeatures().extract(cut) for cut in cuts]).set_axis(
            capture_copy_index(rows, 0 * rows)
        )
        each = judge.fit(features, corpus.gestures[rows]).predict_proba(features)
        for i in np.flatnonzero((corpus.lengths < 30) == short):
            np.testing.assert_allclose(proba[i], each[rows == i].mean(axis=0), atol=1e-5)
    decided, proba = system.decide(corpus)
    assert (np.diff(decided["capture"]) >= 0).all() and len(decided) == len(proba)
    assert set(decided["frames"]) == {12, 15, 30}
