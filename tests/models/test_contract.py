"""What the harness may ask of a system, and what it assumes where a system has no answer."""

import numpy as np
import pytest
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from bench import contract
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.models.search.auto import Auto


class Plain(ClassifierMixin, BaseEstimator):
    """Fit and predict, nothing else."""

    def fit(self, X, y):
        self.classes_ = np.unique(y)
        return self

    def predict(self, X):
        return np.full(len(X), self.classes_[1])


def test_a_default_is_nobody_s_to_change():
    contract.history(Plain()).append(1)
    assert contract.history(Plain()) == []


def test_a_factory_is_handed_the_feature_set_whatever_its_argument_is_called(corpus):
    def mine(whatever, C=2.0):
        return make_pipeline(whatever, StandardScaler(), SVC(C=C))

    def plain(C=2.0):
        return make_pipeline(StandardScaler(), SVC(C=C))

    expected = make_pipeline(Jung28(), StandardScaler(), SVC(C=3.0)).fit(corpus, corpus.gestures).predict(corpus)
    for factory in (mine, plain):
        built = contract.build(factory, Jung28(), C=3.0)
        assert np.array_equal(built.fit(corpus, corpus.gestures).predict(corpus), expected)
    assert isinstance(contract.build(Plain, None), Plain)
    assert list(contract.features(contract.build(plain, Jung28()))) == ["jung28"]
    assert set(contract.features(Auto())) == {"touch", "jung54"}


class Given(Plain):
    """Predicts the labels or probabilities that a test gives it."""

    def __init__(self, labels=None, proba=None):
        self.labels, self.proba = labels, proba

    def predict(self, X):
        return np.resize(np.array(self.labels, dtype=object), len(X))

    def __getattr__(self, name):
        if name == "predict_proba" and self.__dict__.get("proba") is not None:
            return lambda X: np.resize(np.array(self.proba, dtype=float), (len(X), len(self.classes_)))
        raise AttributeError(name)


@pytest.mark.parametrize("label", ["Pat", None, 0])
def test_a_label_that_is_no_class_fails(corpus, label):
    system = Given([label]).fit(corpus, corpus.gestures)
    with pytest.raises(ValueError, match=f"predict gives {label!r}, which is not one of the trained gestures"):
        contract.decide(system, corpus)


@pytest.mark.parametrize(
    ("row", "fact"),
    [
        ([0.2, 2.0, -1.2], "softmax"),  # logits, with a sum of 1 by chance
        ([0.5, 0.5, 0.01], "sum of 1.01"),
        ([np.nan, np.nan, np.nan], "not finite; .* abstains"),
    ],
)
def test_values_that_are_no_probabilities_fail(corpus, row, fact):
    system = Given(proba=row).fit(corpus, corpus.gestures)
    with pytest.raises(ValueError, match=f"predict_proba gives .*{fact}"):
        contract.decide(system, corpus)


def test_a_system_that_declares_it_abstains_by_a_label_or_a_row_of_nan(corpus):
    by_label = Given(["unknown", corpus.gestures[0]]).fit(corpus, corpus.gestures)
    by_nan = Given(proba=[[np.nan] * 3, [1.0, 0, 0]]).fit(corpus, corpus.gestures)
    for system in (by_label, by_nan, make_pipeline(by_nan)):
        by_label.abstains = by_nan.abstains = "unknown"
        proba = contract.decide(system, corpus)[1]
        assert proba.sum(axis=1).tolist() == [i % 2 for i in range(len(corpus))]
    by_label.labels = ["Unknown"]
    with pytest.raises(ValueError, match="'Unknown'"):
        contract.decide(by_label, corpus)


class Owner(Plain):
    """Has attributes of the names of our methods for purposes of its own."""

    seen, keeps_before = {1, 2}, 3

    def length(self):
        return 5

    def decide(self, scores, threshold):
        return scores > threshold

    def keeps(self):
        return True

    def check(self, value):
        raise RuntimeError(value)


def test_a_method_is_known_by_the_names_of_its_parameters_others_are_the_authors_own(corpus):
    own = Owner().fit(corpus, corpus.gestures)
    contract.check(own)
    assert contract.window(own, 100.0) is None and contract.seen_by_features(own, corpus) == [corpus]
    assert not contract.decides_often(own)
    assert contract.kept(own, 40, 64) == 40 * 64 and contract.kept_before(own, 64) == 0
    assert len(contract.decide(own, corpus)[0]) == len(corpus)
    own.length = lambda rate_hz: 0.5
    with pytest.raises(InputError, match="gives 0.5; give a"):
        contract.window(own, 100.0)
