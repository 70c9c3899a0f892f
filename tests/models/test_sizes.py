"""Sizes of systems that nobody helps to count: by hand where a number can be, above nothing everywhere."""

import inspect
from functools import partial

import numpy as np
import pytest
import torch
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.decomposition import PCA
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.ensemble import (
    GradientBoostingClassifier,
    HistGradientBoostingClassifier,
    RandomForestClassifier,
    StackingClassifier,
)
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC
from sklearn.tree import DecisionTreeClassifier
from sklearn.utils import all_estimators
from torch import nn
from xgboost import XGBClassifier

from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.classic.perceptron import Perceptron
from bench.models.recipe import Recipe
from bench.models.reflex import Reflex
from bench.models.sizes import parameter_count, sizes

RNG = np.random.default_rng(0)
Y = np.repeat(["a", "b", "c"], 20)
X = RNG.normal(size=(60, 4)) + np.repeat(np.arange(3), 20)[:, None]


def count(classifier):
    return parameter_count(classifier.fit(X, Y))


def stored(trees):
    """Two numbers per node, one per tree, and each leaf's shares once, by walking every tree."""
    total, leaves = 0, set()
    for tree in trees:
        total += 1
        for node in range(tree.node_count):
            total += 2
            if tree.children_left[node] < 0:
                leaves.add(tuple(tree.value[node].ravel().astype(np.float32)))
    return total + sum(map(len, leaves))


def test_known_kinds_by_hand():
    machine = SVC(kernel="linear").fit(X, Y)
    n = len(machine.support_)
    assert parameter_count(machine) == 4 * n + 2 * n + 3
    assert count(LogisticRegression()) == count(LinearDiscriminantAnalysis()) == 3 * 4 + 3
    assert count(KNeighborsClassifier()) == 60 * 4 + 60  # every capture and its class
    assert count(GaussianNB()) == 2 * 3 * 4 + 2 * 3 + 1  # means, variances; priors, counts; the floor of variances
    with pytest.warns(ConvergenceWarning):
        assert count(MLPClassifier((5,), max_iter=5)) == 4 * 5 + 5 + 5 * 3 + 3
    tree = DecisionTreeClassifier(random_state=0).fit(X, Y)
    assert parameter_count(tree) == stored([tree.tree_])
    forest = RandomForestClassifier(n_estimators=5, random_state=0).fit(X, Y)
    assert parameter_count(forest) == stored([t.tree_ for t in forest.estimators_])
    boosted = GradientBoostingClassifier(n_estimators=3).fit(X, Y)
    assert parameter_count(boosted) == stored([t.tree_ for t in boosted.estimators_.ravel()])
    codes = np.unique(Y, return_inverse=True)[1]
    dumped = XGBClassifier(n_estimators=4, max_depth=2).fit(X, codes)
    text = "".join(dumped.get_booster().get_dump())
    leaves = text.count("leaf=")  # root and class of each of 3 x 4 trees besides
    assert parameter_count(dumped) == 2 * (text.count("yes=") + leaves) + leaves + 2 * 12
    histograms = HistGradientBoostingClassifier(max_iter=3, early_stopping=False, min_samples_leaf=5).fit(X, Y)
    nodes = [tree.nodes for each in histograms._predictors for tree in each]
    trees = sum(2 * len(n) + int(n["is_leaf"].sum()) for n in nodes)
    assert trees <= parameter_count(histograms) <= trees + 60 * 4 + 100  # and the edges of its bins


def test_pipelines_and_ensembles_are_the_sum_of_their_parts():
    reduced = make_pipeline(StandardScaler(), PCA(2), LogisticRegression()).fit(X, Y)
    assert parameter_count(reduced) >= 2 * 4 + 4 + 3 * 2 + 3  # components and their mean, then two inputs
    for parts in (
        [("a", DecisionTreeClassifier()), ("b", DecisionTreeClassifier(max_depth=2))],
        [("a", LogisticRegression()), ("b", GaussianNB())],
    ):
        stacked = StackingClassifier(parts, LogisticRegression(), cv=2).fit(X, Y)
        assert parameter_count(stacked) == sum(map(parameter_count, stacked.estimators_)) + 3 * 6 + 3


@pytest.mark.filterwarnings("ignore::FutureWarning")  # of classifiers that scikit-learn is about to change
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")  # their size is the same
@pytest.mark.parametrize("name", [name for name, _ in all_estimators(type_filter="classifier")])
def test_every_classifier_of_scikit_learn_has_a_size(name):
    kind = dict(all_estimators(type_filter="classifier"))[name]
    inner = {"estimator": LogisticRegression(), "estimators": [("a", LogisticRegression())]}
    made = kind(**{k: v for k, v in inner.items() if k in inspect.signature(kind).parameters})
    values = np.abs(X)
    try:
        made.fit(values, Y)
    except (ValueError, TypeError, IndexError) as e:
        pytest.skip(f"not for these tables: {str(e)[:80]}")
    found = sizes(made, 64, 40)
    assert found["flash_bytes"] > 0 or name == "DummyClassifier"
    assert found["ram_bytes"] == 4 * (64 * 40 + len(made.classes_))


class OneNet(ClassifierMixin, BaseEstimator):
    """A module of PyTorch that somebody wrapped."""

    def fit(self, X, y):
        self.classes_ = np.unique(y)
        self.inner = nn.Sequential(nn.Linear(64, 5), nn.BatchNorm1d(5), nn.Linear(5, 3))
        return self

    def predict(self, X):
        return np.full(len(X), self.classes_[0])


def test_modules_of_torch_are_found_wherever_they_are_kept(corpus):
    model = OneNet().fit(corpus, corpus.gestures)
    learnt = 64 * 5 + 5 + 2 * 5 + 5 * 3 + 3
    assert parameter_count(model) == learnt == sum(p.numel() for p in model.inner.parameters())
    found = sizes(model, 64, 40)
    assert found["flash_bytes"] == 4 * (learnt + 2 * 5)  # mean and variance of the batch norm
    assert found["ram_bytes"] == 4 * (64 * 40 + 3) and torch.is_tensor(model.inner[0].weight)


def test_what_frames_go_through_first_is_counted_wherever_it_stands(corpus, monkeypatch):
    monkeypatch.setattr("bench.models.out_of_distribution.Perceptron", partial(Perceptron, updates=20))
    plain = Recipe(lda(TouchFeatures()), window=0.1, repair=("stuck", "dead", "offset")).fit(corpus, corpus.gestures)
    bare = Recipe(lda(TouchFeatures()), window=0.1).fit(corpus, corpus.gestures)
    own = sizes(plain, 64, 40)["ram_bytes"] - sizes(bare, 64, 40)["ram_bytes"]
    assert own == 4 * 6 * 64
    small = {"window": 0.1, "early": 0.05, "units": 4, "copies": 1, "faults": ("none",)}
    reflex = Reflex(**small).fit(corpus, corpus.gestures)
    scaled = Recipe(Reflex(**small), scale="peak").fit(corpus, corpus.gestures)
    assert sizes(scaled, 64, 40)["ram_bytes"] == sizes(reflex, 64, 40)["ram_bytes"]
