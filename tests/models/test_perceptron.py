"""The perceptron against scikit-learn's forward pass and a loop, and the guard against its two judges."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.preprocessing import StandardScaler

from bench.models.classic.lda import Discriminants
from bench.models.classic.perceptron import Perceptron
from bench.models.out_of_distribution import Guarded
from bench.models.sizes import parameter_count

QUICK = {"updates": 200}


def table(seed=0, rows=300, d=6, copies=2):
    """Three classes that no line separates, in captures of two windows, a part of them copies with a broken feature."""
    rng = np.random.default_rng(seed)
    y = rng.integers(0, 3, rows)
    X = rng.normal(size=(rows, d)).astype(np.float32)
    X[:, 0] += 3 * np.array([1, -1, 0])[y]
    X[:, 1] += 4 * np.abs(y - 1)
    copy = rng.integers(0, copies + 1, rows)
    X[copy > 0, 2] += 30
    index = pd.MultiIndex.from_arrays([np.arange(rows) // 2, copy], names=["capture", "copy"])
    return pd.DataFrame((X * 10.0 ** np.arange(d)).astype(np.float32), index=index), np.array([*"abc"])[y]


def test_it_decides_as_scikit_learns_network_of_the_same_weights():
    X, y = table(copies=0)
    ours = Perceptron(units=7, clip=2.0, **QUICK).fit(X, y)
    with pytest.warns(ConvergenceWarning):  # its weights are replaced
        theirs = MLPClassifier((7,), max_iter=1).fit(np.zeros((3, 6)), [*"abc"])
    theirs.coefs_, theirs.intercepts_ = ours.coefs_, ours.intercepts_
    given = StandardScaler().fit(X).transform(X).clip(-2, 2)
    np.testing.assert_allclose(ours.predict_proba(X), theirs.predict_proba(given), atol=1e-4)
    assert np.array_equal(ours.predict(X), ours.classes_[ours.predict_proba(X).argmax(axis=1)])
    assert parameter_count(ours) == 6 * 7 + 7 + 7 * 3 + 3 + 2 * 6


def test_rows_are_drawn_as_often_as_they_count():
    """Copies that count nearly nothing change nearly nothing; those that count as much as captures do."""
    X, y = table()
    undamaged = X[X.index.get_level_values("copy") == 0]
    alone = Perceptron(**QUICK).fit(undamaged, y[X.index.get_level_values("copy") == 0])
    hardly, much = (Perceptron(damaged=w, **QUICK).fit(X, y) for w in (1e-12, 1.0))
    np.testing.assert_allclose(hardly.mean_, alone.mean_, rtol=1e-4)
    np.testing.assert_allclose(hardly.coefs_[0], alone.coefs_[0], atol=1e-4)
    assert abs(much.mean_[2] - alone.mean_[2]) > 1


@given(st.integers(0, 100))
def test_one_feature_says_no_more_than_its_clip(seed):
    """Whatever a broken sensor makes of a feature, and one that was constant in training says nothing at all."""
    X, y = table(seed, rows=60)
    X["still"] = 7.0
    model = Perceptron(updates=20).fit(X, y)
    far, further = X.copy(), X.copy()
    far.iloc[:, 0], further.iloc[:, 0] = 1e3, 1e30
    further["still"] = -1e9
    assert np.array_equal(model.predict_proba(far), model.predict_proba(further))
    assert np.isfinite(model.predict_proba(further)).all()


# The guard


@pytest.fixture
def few_updates(monkeypatch):
    """The network learns for a shorter time than it does for a user."""
    monkeypatch.setattr("bench.models.out_of_distribution.Perceptron", partial(Perceptron, **QUICK))


def test_doubt_counts_features_beyond_two_and_a_half_deviations(few_updates):
    X, y = table()
    undamaged = (X.index.get_level_values("copy") == 0).astype(bool)
    usual = X[undamaged]
    away = ((X - usual.mean()).abs() > 2.5 * usual.std(ddof=0)).sum(axis=1)
    doubts = Guarded(doubt=0.5).fit(X, y).doubts(X)
    np.testing.assert_allclose(doubts, (away / 6 / 0.5).clip(upper=1))
    assert doubts[~undamaged].min() >= 1 / 3 and 0 < (doubts == 0).sum() < len(X)


def test_a_row_without_doubt_is_judged_by_discriminants_of_undamaged_rows_and_one_in_doubt_by_the_network(few_updates):
    X, y = table()
    model = Guarded(doubt=1 / 6).fit(X, y)
    whole = X.index.get_level_values("copy") == 0
    doubt = model.doubts(X)
    linear = Discriminants(windows=2.0).fit(X[whole], y[whole]).predict_proba(X)
    network = Perceptron(units=18, **QUICK).fit(X, y).predict_proba(X)
    np.testing.assert_allclose(model.predict_proba(X)[doubt == 0], linear[doubt == 0], atol=1e-9)
    np.testing.assert_allclose(model.predict_proba(X)[doubt == 1], network[doubt == 1], atol=1e-9)
    softly = Guarded(doubt=1.0).fit(X, y)
    share = softly.doubts(X)[:, None]
    np.testing.assert_allclose(softly.predict_proba(X), (1 - share) * linear + share * network, atol=1e-9)
    assert parameter_count(model) == 2 * 6 + 3 * 6 + 3 + (6 * 18 + 18 + 18 * 3 + 3 + 2 * 6)
