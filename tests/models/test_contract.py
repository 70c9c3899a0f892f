"""What the harness may ask of a system, and what it assumes where nothing is told."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.ensemble import RandomForestClassifier
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from bench import contract
from bench.errors import InputError
from features.jung28 import Jung28
from features.ta273 import Ta273
from models.classic.rf import rf
from models.classic.svm import svm
from models.nets.cnn85 import CNN85
from models.search.auto import Auto


class Plain(ClassifierMixin, BaseEstimator):
    """Fit and predict, nothing else."""

    def fit(self, X, y):
        self.classes_ = np.unique(y)
        return self

    def predict(self, X):
        return np.full(len(X), self.classes_[1])


class Telling(Plain):
    """Tells all there is to tell."""

    packages = ("numpy",)
    space = {"a": [1, 2]}
    searches = True
    members = ()
    chosen_ = {"a": 1}
    history_ = [{"loss": 1.0}]
    trials_ = pd.DataFrame({"a": [1]})
    search_seconds_ = 3.0
    fit_seconds_ = (1.0, 2.0)
    parameters_ = 7
    activations_ = 9

    def __init__(self, frames=5):
        self.frames = frames

    def check(self):
        raise InputError("no")

    def check_training(self, X, y):
        raise InputError("never")

    def length(self, rate_hz):
        return round(self.frames * rate_hz)

    def decide(self, X):
        table = pd.DataFrame({"capture": [0, 0], "start": [0, 1], "frames": 1})
        return table, np.array([[1.0, 0, 0], [0, 1, 0]])


def test_a_plain_classifier_has_the_defaults(corpus):
    plain = Plain().fit(corpus, corpus.gestures)
    assert contract.packages(Plain) == () and contract.space(Plain) is None and not contract.searches(plain)
    assert contract.check(plain) is None and contract.check_training(plain, corpus, corpus.gestures) is None
    assert contract.window(plain, 100.0) is None and contract.features(plain) == {}
    assert contract.fit_seconds(plain, 1.5, 2.5) == (1.5, 2.5) and contract.search_seconds(plain) is None
    assert contract.history(plain) == [] and contract.chosen(plain) == {} and contract.trials(plain) is None
    assert contract.inside(plain) is plain and not contract.members(plain)
    assert contract.learnt_numbers(plain) is None and contract.numbers_in_memory(plain) is None
    table, proba = contract.decide(plain, corpus)
    assert table["frames"].tolist() == corpus.lengths.tolist() and table["start"].eq(0).all()
    assert (proba == np.eye(3)[1]).all() and not contract.has_probabilities(plain)
    assert contract.kept(StandardScaler(), 40, 64) == 40 * 64 and contract.learns(StandardScaler())
    assert contract.kept(Jung28(), 40, 64) == 40 + 2 * 64 and contract.learns(Ta273()) and not contract.learns(Jung28())


def test_what_a_system_tells_is_believed(corpus):
    told = Telling().fit(corpus, corpus.gestures)
    assert contract.packages(Telling) == ("numpy",) and contract.space(Telling) == {"a": [1, 2]}
    assert contract.searches(told) and contract.window(told, 2.0) == 10 and contract.decides_often(told)
    assert contract.decide(told, corpus)[0]["start"].tolist() == [0, 1]
    assert contract.chosen(told) == {"a": 1} and contract.history(told) == [{"loss": 1.0}]
    assert contract.search_seconds(told) == 3.0 and contract.fit_seconds(told, 9.0, 9.0) == (1.0, 2.0)
    assert (contract.learnt_numbers(told), contract.numbers_in_memory(told)) == (7, 9)
    with pytest.raises(InputError, match="^no$"):
        contract.check(told)
    with pytest.raises(InputError, match="never"):
        contract.check_training(told, corpus, corpus.gestures)


@pytest.mark.parametrize(
    ("system", "tables"),
    [
        (SVC(), True),
        (SVC, True),
        (make_pipeline(StandardScaler(), SVC()), True),
        (Pipeline([("inner", make_pipeline(StandardScaler())), ("last", SVC())]), True),
        (svm(Jung28()), False),
        (make_pipeline(Jung28(), SVC()), False),
        (Plain(), False),
        (Plain, False),
        (CNN85, False),
        (lambda C=1.0: make_pipeline(StandardScaler(), SVC(C=C)), True),
        (lambda C=1.0: make_pipeline(Jung28(), SVC(C=C)), False),
    ],
)
def test_what_learns_from_tables_is_told_from_what_reads_captures(system, tables):
    assert contract.reads_tables(system) == tables


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


def test_an_object_is_known_by_its_classes_settings_and_libraries():
    part = make_pipeline(Jung28(), StandardScaler(), RandomForestClassifier(7))
    assert contract.shown(part) == "Jung28() > StandardScaler() > RandomForestClassifier(n_estimators=7)"
    assert contract.classes(part) == [Jung28] and contract.libraries(part) == ("scikit-learn",)
    assert "'n_neighbors': 3," in contract.settings(KNeighborsClassifier(3))
    fitted = KNeighborsClassifier(3).fit([[0], [1], [2]], [0, 1, 1])
    assert not hasattr(contract.copied(fitted), "classes_")
    assert "'classifier__n_estimators': 500," in contract.settings(rf(Jung28()))
