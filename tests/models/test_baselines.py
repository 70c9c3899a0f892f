"""Baselines against independent computations, and a guard for everything that is fitted."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.base import clone
from sklearn.model_selection import LeaveOneGroupOut, cross_val_score
from sklearn.svm import SVC

from bench.cost import parameter_count
from features.jung28 import Jung28
from models.bayes import GaussianBayes, bayes
from models.cnn85 import CNN85
from models.rf import rf
from models.svm import RankedSVC, svm
from models.xgb import xgb
from tests.conftest import random_corpus

SYSTEMS = {
    "bayes": lambda: bayes(Jung28()),
    "svm": lambda: svm(Jung28()),
    "rf": lambda: rf(Jung28(), trees=20),
    "xgb": lambda: xgb(Jung28(), trees=10),
    "cnn85": lambda: CNN85(frames=10, epochs=15, batch=16),
}


def points(n=60, d=3, seed=0):
    rng = np.random.default_rng(seed)
    y = np.repeat(["a", "b", "c"], n // 3)
    return rng.normal(size=(n, d)) + np.repeat(np.arange(3), n // 3)[:, None], y


def test_bayes_equals_scipys_normal_density():
    X, y = points()
    model = GaussianBayes(ridge=0.01).fit(X, y)
    densities = [
        multivariate_normal(X[y == c].mean(axis=0), np.cov(X[y == c].T) + 0.01 * np.eye(3)).pdf(X) / 3 for c in "abc"
    ]
    expected = np.stack(densities, axis=1)
    np.testing.assert_allclose(model.predict_proba(X), expected / expected.sum(axis=1, keepdims=True), rtol=1e-8)


def test_bayes_stands_dependent_and_constant_features():
    X, y = points(d=3)
    X = np.column_stack([X, X.sum(axis=1), np.ones(len(X))])
    assert np.isfinite(GaussianBayes(1e-6).fit(X, y).predict_proba(X)).all()


@pytest.mark.parametrize("classes", [2, 3])
def test_svm_labels_are_those_of_libsvm(classes):
    X, y = points()
    X, y = X[: 20 * classes], y[: 20 * classes]
    ours = RankedSVC(C=4, gamma=0.5, break_ties=classes > 2).fit(X, y)
    proba = ours.predict_proba(X)
    assert (ours.classes_[proba.argmax(axis=1)] == SVC(C=4, gamma=0.5).fit(X, y).predict(X)).mean() > 0.95
    np.testing.assert_allclose(proba.sum(axis=1), 1)


@pytest.mark.parametrize("name", SYSTEMS)
def test_contract_of_a_system(name, corpus):
    model = SYSTEMS[name]()
    train = corpus[corpus.subjects != "4"]
    model.fit(train, train.gestures)
    proba = model.predict_proba(corpus)
    assert proba.shape == (36, 3) and list(model.classes_) == ["pat", "rub", "tap"]
    np.testing.assert_allclose(proba.sum(axis=1), 1, rtol=1e-5)
    assert np.array_equal(model.predict(corpus), model.classes_[proba.argmax(axis=1)])
    assert parameter_count(model) > 0
    again = clone(model).fit(train, train.gestures)
    assert np.array_equal(again.predict_proba(corpus), proba)
    for grid in ((3, 5), (1, 2)):
        other = random_corpus(grid=grid)
        assert SYSTEMS[name]().fit(other, other.gestures).predict(other[:1]).shape == (1,)


@pytest.mark.parametrize("name", SYSTEMS)
def test_permuted_labels_give_chance(name):
    """A system that saw its test subjects, or their labels, would do better."""
    corpus = random_corpus(subjects=5, per_class=8)
    labels = np.random.default_rng(0).permutation(corpus.gestures)
    found = cross_val_score(SYSTEMS[name](), corpus, labels, groups=corpus.subjects, cv=LeaveOneGroupOut())
    assert abs(found.mean() - 1 / 3) < 4 * np.sqrt(2 / 9 / len(corpus))


@pytest.mark.parametrize("name", SYSTEMS)
def test_test_subjects_change_nothing_that_is_learned(name, corpus):
    """Other values in the test captures, and the fitted system still labels the same captures the same way."""
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    changed = corpus.frames.copy()
    for start, length in zip(corpus.starts[test], corpus.lengths[test], strict=True):
        changed[start : start + length] = np.random.default_rng(1).integers(0, 1023, (length, 8, 8))
    other = type(corpus)(**{**vars(corpus), "frames": changed})
    probe = random_corpus(seed=9)
    learned = [SYSTEMS[name]().fit(c[train], c.gestures[train]).predict_proba(probe) for c in (corpus, other)]
    assert np.array_equal(*learned)


def test_parameter_counts_by_hand():
    X, y = points()
    assert GaussianBayes().fit(X, y).parameters_ == 3 * (3 + 6 + 1)
    machine = SVC(kernel="linear").fit(X, y)
    n = machine.support_vectors_.shape[0]
    assert parameter_count(machine) == n * 3 + 2 * n + 3
    assert parameter_count(object()) is None
