"""Sizes of systems without declared sizes, counted by hand."""

import numpy as np
import pytest
from sklearn import ensemble
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.decomposition import PCA
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
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

from bench.features.balli import Balli
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.features.selection import Subset
from bench.features.ta273 import Ta273
from bench.models.classic.bayes import GaussianBayes
from bench.models.classic.svm import svm
from bench.models.sizes import count_parameters, measure_sizes

Y = np.repeat(["a", "b", "c"], 20)
X = np.random.default_rng(0).normal(size=(60, 4)) + np.repeat(np.arange(3), 20)[:, None]
BY_HAND = [
    (LogisticRegression(), 3 * 4 + 3),
    (LinearDiscriminantAnalysis(), 3 * 4 + 3),
    (KNeighborsClassifier(), 60 * 4 + 60),  # every capture and its class
    (
        GaussianNB(),
        2 * 3 * 4 + 2 * 3 + 1,
    ),  # means, variances; priors, counts; the floor of variances
    (GaussianBayes(), 3 * (4 + 10 + 1)),
    (MLPClassifier((5,), max_iter=5), 4 * 5 + 5 + 5 * 3 + 3),
]


def count(classifier):
    return count_parameters(classifier.fit(X, Y))


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize(("classifier", "numbers"), BY_HAND)
def test_known_kinds_by_hand(classifier, numbers):
    assert count(classifier) == numbers


@pytest.mark.parametrize(
    ("model", "trees_of"),
    [
        (DecisionTreeClassifier(), lambda tree: [tree]),
        (ensemble.RandomForestClassifier(n_estimators=5), lambda forest: forest.estimators_),
        (
            ensemble.GradientBoostingClassifier(n_estimators=3),
            lambda boosted: boosted.estimators_.ravel(),
        ),
    ],
)
def test_a_tree_has_two_numbers_a_node_one_a_tree_and_the_shares_of_each_leaf_once(model, trees_of):
    total, leaves = 0, set()
    for tree in (each.tree_ for each in trees_of(model.fit(X, Y))):
        total += 1 + 2 * tree.node_count
        leaves |= {
            tuple(shares.ravel())
            for shares in tree.value[tree.children_left < 0].astype(np.float32)
        }
    assert count_parameters(model) == total + sum(map(len, leaves))


def test_boosted_trees_and_support_vectors_by_hand():
    boosted = XGBClassifier(n_estimators=4, max_depth=2).fit(X, np.repeat([0, 1, 2], 20))
    text = "".join(boosted.get_booster().get_dump())
    leaves = text.count("leaf=")  # root and class of each of 3 x 4 trees besides
    assert count_parameters(boosted) == 2 * (text.count("yes=") + leaves) + leaves + 2 * 12
    histograms = ensemble.HistGradientBoostingClassifier(
        max_iter=3, early_stopping=False, min_samples_leaf=5
    ).fit(X, Y)
    nodes = [tree.nodes for each in histograms._predictors for tree in each]
    trees = sum(2 * len(n) + int(n["is_leaf"].sum()) for n in nodes)
    assert (
        trees <= count_parameters(histograms) <= trees + 60 * 4 + 100
    )  # and the edges of its bins
    machine = SVC(kernel="linear").fit(X, Y)
    assert count_parameters(machine) == 4 * len(machine.support_) + 2 * len(machine.support_) + 3


def test_pipelines_and_ensembles_are_the_sum_of_their_parts():
    reduced = make_pipeline(StandardScaler(), PCA(2), LogisticRegression())
    assert count(reduced) >= 2 * 4 + 4 + 3 * 2 + 3  # components and their mean, then two inputs
    for other in (DecisionTreeClassifier(max_depth=2), GaussianNB()):
        parts = [("a", DecisionTreeClassifier()), ("b", other)]
        stacked = ensemble.StackingClassifier(parts, LogisticRegression(), cv=2).fit(X, Y)
        assert (
            count_parameters(stacked) == sum(map(count_parameters, stacked.estimators_)) + 3 * 6 + 3
        )


class OneNet(ClassifierMixin, BaseEstimator):
    """A module of PyTorch that somebody wrapped."""

    def fit(self, X, y):
        self.classes_ = np.unique(y)
        self.inner = nn.Sequential(nn.Linear(64, 5), nn.BatchNorm1d(5), nn.Linear(5, 3))
        return self


def test_modules_of_torch_are_found_wherever_they_are_kept(corpus):
    learnt = 64 * 5 + 5 + 2 * 5 + 5 * 3 + 3
    stored = 4 * (learnt + 2 * 5)  # mean and variance of the batch norm
    found = measure_sizes(OneNet().fit(corpus, corpus.gestures), 64, 40)
    assert found == {"parameters": learnt, "flash_bytes": stored, "ram_bytes": 4 * (64 * 40 + 3)}


def test_memory_is_what_features_and_classifiers_work_in(corpus):
    machine = svm(Jung28()).fit(corpus, corpus.gestures)
    costs, n = measure_sizes(machine, 64, 40), len(machine.named_steps["classifier"].support_)
    # summed pressure, two frames, features, kernels, scores
    assert costs["ram_bytes"] == 4 * (40 + 2 * 64 + 28 + n + 3)
    assert costs["flash_bytes"] == 4 * (
        costs["parameters"] + 2 * 28
    )  # low end and width of each feature
    # spatial peaks of jung54 and areas are above a share of the maximum of the whole capture
    assert {part.keeps(40, 64) for part in (Jung54(), Jung28(area="capture"), Ta273())} == {40 * 64}
    assert (
        Balli().keeps(40, 64) == 16 * 40 + 64 and Subset(Jung28(), 5).keeps(40, 64) == 40 + 2 * 64
    )
