"""Classifiers of others as systems: what they are given, and that they learn from it."""

import numpy as np
import pytest
import torch
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.neighbors import KNeighborsClassifier
from torch import nn

from bench import contract
from bench.errors import InputError
from models.adapters import FromSeries, FromTorch
from models.series import Series
from tests.conftest import random_corpus, with_other_values


class OfSeries(ClassifierMixin, BaseEstimator):
    """Nearest neighbours of flattened series; remembers what it saw."""

    def fit(self, X, y):
        self.seen_ = X
        self.inner_ = KNeighborsClassifier(3).fit(X.reshape(len(X), -1), y)
        self.classes_ = self.inner_.classes_
        return self

    def predict(self, X):
        return self.inner_.predict(X.reshape(len(X), -1))


def test_series_of_one_length_are_handed_over(corpus):
    train, test = corpus[corpus.subjects != "2"], corpus[corpus.subjects == "2"]
    model = FromSeries(OfSeries(), "both", 25).fit(train, train.gestures)
    series = Series("both", 25).fit(train)
    assert np.array_equal(model.classifier_.seen_, series.transform(train)) and model.classifier_.seen_.shape[1:] == (
        69,
        25,
    )
    expected = OfSeries().fit(series.transform(train).astype(float), train.gestures.astype(str))
    assert np.array_equal(model.predict(test), expected.predict(series.transform(test).astype(float)))
    assert (model.predict(test) == test.gestures).mean() > 0.7
    assert not contract.has_probabilities(model) and contract.has_probabilities(FromSeries(KNeighborsClassifier()))
    assert clone(model).get_params()["classifier"].get_params() == {}


def linear(frames, rows, cols, classes):
    return nn.Sequential(nn.Flatten(), nn.Linear(frames * rows * cols, classes))


def test_a_module_is_made_for_the_grid_and_trained(corpus):
    train, test = corpus[corpus.subjects != "2"], corpus[corpus.subjects == "2"]
    fit = lambda seed=0, **more: FromTorch(linear, 5, epochs=60, batch=8, rate=0.01, seed=seed, **more).fit(  # noqa: E731
        train, train.gestures
    )
    model = fit()
    assert (model.predict(test) == test.gestures).mean() > 0.7 and len(model.history_) == 60
    assert model.parameters_ == 5 * 64 * 3 + 3 and contract.window(model, 100.0) == 5
    assert np.array_equal(model.predict_proba(test), fit().predict_proba(test))
    assert not np.array_equal(model.predict_proba(test), fit(seed=1).predict_proba(test))
    assert contract.window(FromTorch(linear, seconds=0.5), 100.0) == 50
    other = random_corpus(grid=(3, 5))
    assert FromTorch(linear, 5, epochs=1).fit(other, other.gestures).predict(other[:1]).shape == (1,)
    with pytest.raises(InputError, match="model.epochs=0"):
        FromTorch(linear, epochs=0).check()
    assert torch.is_grad_enabled()


@pytest.mark.parametrize("make", [lambda: FromSeries(OfSeries()), lambda: FromTorch(linear, 5, epochs=2)])
def test_test_subjects_change_nothing_that_is_learned(make, corpus):
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    other, probe = with_other_values(corpus, test), random_corpus(seed=9)
    found = [make().fit(c[train], c.gestures[train]).predict(probe) for c in (corpus, other)]
    assert np.array_equal(*found)
