"""Attributes and methods that a system may have, their defaults, and adapters."""

import numpy as np
import pytest
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler
from sklearn.svm import SVC

from bench import contract
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.models.adapters import FromSeries
from bench.models.search.auto import Auto
from bench.models.series import Series
from tests.models.test_systems import flatten_series


class Given(ClassifierMixin, BaseEstimator):
    """Predicts the labels or probabilities that a test gives it."""

    def __init__(self, labels=None, proba=None):
        self.labels, self.proba = labels, proba

    def fit(self, X, y):
        self.classes_ = np.unique(y)
        return self

    def predict(self, X):
        return np.resize(np.array(self.labels, dtype=object), len(X))

    def __getattr__(self, name):
        if name == "predict_proba" and self.__dict__.get("proba") is not None:
            return lambda X: np.resize(
                np.array(self.proba, dtype=float), (len(X), len(self.classes_))
            )
        raise AttributeError(name)


def test_a_default_is_nobody_s_to_change():
    contract.history(Given()).append(1)
    assert contract.history(Given()) == []


def test_a_factory_is_handed_the_feature_set_whatever_its_argument_is_called(corpus):
    def mine(whatever, C=2.0):
        return make_pipeline(whatever, StandardScaler(), SVC(C=C))

    def plain(C=2.0):
        return make_pipeline(StandardScaler(), SVC(C=C))

    expected = (
        make_pipeline(Jung28(), StandardScaler(), SVC(C=3.0))
        .fit(corpus, corpus.gestures)
        .predict(corpus)
    )
    for factory in (mine, plain):
        built = contract.build_system(factory, Jung28(), C=3.0)
        assert np.array_equal(built.fit(corpus, corpus.gestures).predict(corpus), expected)
        assert list(contract.feature_sets(built)) == ["jung28"]
    assert isinstance(contract.build_system(Given, None), Given)
    assert set(contract.feature_sets(Auto())) == {"touch", "jung54"}


@pytest.mark.parametrize(
    ("answer", "fact"),
    [
        *(
            ({"labels": [label]}, f"predict gives {label!r}, which is not one of the t")
            for label in ("Pat", None, 0)
        ),
        (
            {"proba": [0.2, 2.0, -1.2]},
            "predict_proba gives .*softmax",
        ),  # logits, with a sum of 1 by chance
        ({"proba": [0.5, 0.5, 0.01]}, "predict_proba gives .*sum of 1.01"),
        ({"proba": [np.nan] * 3}, "predict_proba gives .*not finite; .* abstains"),
    ],
)
def test_labels_that_are_no_class_and_values_that_are_no_probabilities_fail(corpus, answer, fact):
    with pytest.raises(ValueError, match=fact):
        contract.predict_decisions(Given(**answer).fit(corpus, corpus.gestures), corpus)


def test_a_system_that_declares_it_abstains_by_a_label_or_a_row_of_nan(corpus):
    by_label = Given(["unknown", corpus.gestures[0]]).fit(corpus, corpus.gestures)
    by_nan = Given(proba=[[np.nan] * 3, [1.0, 0, 0]]).fit(corpus, corpus.gestures)
    by_label.abstains = by_nan.abstains = "unknown"
    for system in (by_label, by_nan, make_pipeline(by_nan)):
        proba = contract.predict_decisions(system, corpus)[1]
        assert proba.sum(axis=1).tolist() == [i % 2 for i in range(len(corpus))]
    by_label.labels = ["Unknown"]
    with pytest.raises(ValueError, match="'Unknown'"):
        contract.predict_decisions(by_label, corpus)


class Owner(Given):
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
    own = Owner(["pat"]).fit(corpus, corpus.gestures)
    contract.check_parameters(own)
    assert contract.window_frames(own, 100.0) is None and contract.input_of_features(
        own, corpus
    ) == [corpus]
    assert not contract.decides_often(own)
    assert (
        contract.memory_of_features(own, 40, 64) == 40 * 64 and contract.memory_before(own, 64) == 0
    )
    assert len(contract.predict_decisions(own, corpus)[0]) == len(corpus)
    own.length = lambda rate_hz: 0.5
    with pytest.raises(InputError, match="gives 0.5; give a"):
        contract.window_frames(own, 100.0)


def test_a_classifier_of_series_is_given_them_in_one_length(corpus):
    neighbours = make_pipeline(FunctionTransformer(flatten_series), KNeighborsClassifier(3))
    model = FromSeries(neighbours, "both", 25).fit(corpus, corpus.gestures)
    series = Series("both", 25).fit(corpus).transform(corpus).astype(float)
    expected = neighbours.fit(series, corpus.gestures.astype(str)).predict_proba(series)
    assert np.array_equal(model.predict_proba(corpus), expected) and series.shape[1:] == (69, 25)
    assert not contract.has_probabilities(FromSeries(SVC()))
