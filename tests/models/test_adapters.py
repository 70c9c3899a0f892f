"""Classifiers of others as systems: what they are given; what any system must do is in test_systems.py."""

import numpy as np
import pytest
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.neighbors import KNeighborsClassifier
from torch import nn

from bench import contract
from bench.errors import InputError
from bench.models.adapters import FromSeries, FromTorch
from bench.models.series import Series


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
    model = FromSeries(OfSeries(), "both", 25).fit(corpus, corpus.gestures)
    series = Series("both", 25).fit(corpus).transform(corpus)
    assert np.array_equal(model.classifier_.seen_, series) and series.shape[1:] == (69, 25)
    expected = OfSeries().fit(series.astype(float), corpus.gestures.astype(str))
    assert np.array_equal(model.predict(corpus), expected.predict(series.astype(float)))
    assert not contract.has_probabilities(model) and contract.has_probabilities(FromSeries(KNeighborsClassifier()))


def linear(frames, rows, cols, classes):
    return nn.Sequential(nn.Flatten(), nn.Linear(frames * rows * cols, classes))


def test_a_module_is_made_for_the_window_and_trained(corpus):
    model = FromTorch(module=linear, frames=5, batch=8, rate=0.01, epochs=20).fit(corpus, corpus.gestures)
    assert (model.predict(corpus) == corpus.gestures).mean() > 0.7 and len(model.history_) == 20
    assert model.parameters_ == 5 * 64 * 3 + 3
    assert contract.window(model, 100.0) == 5 and contract.window(FromTorch(module=linear, seconds=0.5), 100.0) == 50
    with pytest.raises(InputError, match="model.epochs=0"):
        FromTorch(module=linear, epochs=0).check()
