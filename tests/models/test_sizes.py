"""Sizes of systems that nobody helps to count: by hand where a number can be, above nothing everywhere."""

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
from torch import nn
from xgboost import XGBClassifier

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
