"""Classifiers, scalers and published systems against independent computations; test_systems.py has what all must do."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.base import clone
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.tree import DecisionTreeClassifier

from bench.features.balli import Balli
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.features.selection import Subset
from bench.features.ta273 import Ta273
from bench.models.classic.bayes import GaussianBayes
from bench.models.classic.jung2014 import jung2014_svm
from bench.models.classic.jung2017 import jung2017_nn, jung2017_svm_rbf, jung2017_tree
from bench.models.classic.scaling import RangeScaler, ZScaler
from bench.models.classic.svm import svm
from bench.models.classic.tree import PrunedTree
from bench.models.classic.wingerden2014 import wingerden2014_mlp
from bench.models.sizes import sizes


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
    X = np.column_stack([X, X.sum(axis=1), np.ones(len(X))])  # dependent and constant features
    assert np.isfinite(GaussianBayes(1e-6).fit(X, y).predict_proba(X)).all()


def test_parameter_counts_by_hand(corpus):
    X, y = points()
    assert GaussianBayes().fit(X, y).parameters_ == 3 * (3 + 6 + 1)
    machine = svm(Jung28()).fit(corpus, corpus.gestures)
    costs, n = sizes(machine, 64, 40), len(machine.named_steps["classifier"].support_)
    # summed pressure, two frames, features, kernels, scores
    assert costs["ram_bytes"] == 4 * (40 + 2 * 64 + 28 + n + 3)
    assert costs["flash_bytes"] == 4 * (costs["parameters"] + 2 * 28)  # low end and width of each feature
    # spatial peaks of jung54 and areas are above a share of the maximum of the whole capture
    wholes = Jung54(), Jung28(area="capture"), Ta273()
    assert {part.keeps(40, 64) for part in wholes} == {40 * 64}
    assert Balli().keeps(40, 64) == 16 * 40 + 64 and Subset(Jung28(), 5).keeps(40, 64) == 40 + 2 * 64


def test_a_level_is_a_step_of_the_pruning_sequence():
    """All equally weak links are cut in one step, and what costs nothing is no step of its own."""
    X, y = points(n=240)
    X = X.round()  # coarse values, so that several links are equally weak

    def leaves(**how):
        return DecisionTreeClassifier(random_state=0, **how).fit(X, y).get_n_leaves()

    alphas = DecisionTreeClassifier(random_state=0).cost_complexity_pruning_path(X, y).ccp_alphas
    pruned = dict.fromkeys(leaves(ccp_alpha=alpha + 1e-9) for alpha in alphas if alpha > 1e-9)
    kept = [n for n in (leaves(), *pruned) if n >= 3]  # fewer leaves than classes cannot name them all
    steps = [PrunedTree(level).fit(X, y).tree_.get_n_leaves() for level in range(len(kept) + 2)]
    assert len(kept) > 5 and steps == [*kept, kept[-1], kept[-1]]


def test_networks_and_grids_are_the_published_ones():
    grid = jung2017_svm_rbf().spaces["svm"]
    assert len(grid["C"]) == 11 and len(grid["gamma"]) == 10
    assert (min(grid["C"]), max(grid["C"]), min(grid["gamma"]), max(grid["gamma"])) == (2**-5, 2**15, 2**-15, 2**3)
    assert jung2014_svm().spaces["svm"]["kernel"] == ["linear"] and len(jung2014_svm().spaces["svm"]["C"]) == 11
    assert jung2017_tree().spaces["tree"]["level"] == [5, 10, 15, 20, 25, 30]
    assert jung2017_nn().named_steps["classifier"].layers == (54, 27)
    assert wingerden2014_mlp().named_steps["classifier"].layers == (46,)


@pytest.mark.parametrize(
    ("ours", "theirs", "still"),
    [
        (RangeScaler(), MinMaxScaler(), 0),
        (RangeScaler(feature_range=(-1, 1)), MinMaxScaler((-1, 1)), -1),
        (ZScaler(), StandardScaler(), 0),
    ],
)
def test_varying_features_are_scaled_as_usual_and_constant_ones_stay(ours, theirs, still):
    rng = np.random.default_rng(0)
    train, test = rng.normal(size=(20, 4)) * [1, 1e-6, 1e6, 0], rng.normal(size=(5, 4)) * 10
    train[:, 3] = 432
    train[:10, 3] += 1e-11  # rounding
    ours = clone(ours).fit(train)
    theirs = theirs.fit(train)
    np.testing.assert_array_equal(ours.transform(test)[:, :3], theirs.transform(test)[:, :3])
    assert (ours.transform(test)[:, 3] == still).all() and (ours.transform(train)[:, 3] == still).all()
    assert np.abs(theirs.transform(test)[:, 3]).max() > 100
