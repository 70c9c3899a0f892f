"""Classifiers, scalers and published systems against independent computations; test_systems.py has what all must do."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.base import clone
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.svm import SVC
from sklearn.tree import DecisionTreeClassifier

from bench.corpora.corpus import Corpus
from bench.features.balli import Balli
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.features.selection import Subset
from bench.features.ta273 import Ta273
from bench.models.classic.bayes import GaussianBayes
from bench.models.classic.jung2014 import jung2014_svm
from bench.models.classic.jung2017 import jung2017_nn, jung2017_svm_rbf, jung2017_tree
from bench.models.classic.mlp import EarlyStoppedNet
from bench.models.classic.scaling import RangeScaler, ZScaler
from bench.models.classic.softmax import softmax
from bench.models.classic.svm import RankedSVC, svm
from bench.models.classic.tree import PrunedTree
from bench.models.classic.wingerden2014 import wingerden2014_mlp
from bench.models.sizes import sizes
from tests.conftest import random_corpus


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


@pytest.mark.parametrize("classes", [2, 3])
def test_svm_labels_are_those_of_libsvm(classes):
    X, y = points()
    X, y = X[: 20 * classes], y[: 20 * classes]
    ours = RankedSVC(C=4, gamma=0.5, break_ties=classes > 2).fit(X, y)
    proba = ours.predict_proba(X)
    assert (ours.classes_[proba.argmax(axis=1)] == SVC(C=4, gamma=0.5).fit(X, y).predict(X)).mean() > 0.95
    np.testing.assert_allclose(proba.sum(axis=1), 1)


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


def test_a_tree_of_separable_classes_keeps_a_leaf_for_each():
    """Gestures that differ in strength alone, with gaps between them; half of the captures are held out."""
    names = list("abcdefgh")
    rng = np.random.default_rng(0)
    y = np.repeat(names, 20)
    X = np.column_stack([np.repeat(np.arange(8), 20) * 100 + rng.uniform(0, 10, 160), rng.normal(size=160)])
    train = rng.random(160) < 0.5
    steps = len(np.unique(DecisionTreeClassifier().cost_complexity_pruning_path(X[train], y[train]).ccp_alphas))
    assert steps <= 10  # so the default level would cut to the root
    assert PrunedTree().level == 10 and (PrunedTree().fit(X[train], y[train]).predict(X[~train]) == y[~train]).all()
    one = PrunedTree().fit(X[y == "a"], y[y == "a"])
    assert set(one.predict(X)) == {"a"}


def test_the_best_run_on_the_held_captures_is_kept():
    X, y = points(n=120)
    net = EarlyStoppedNet((4,), runs=4, seed=3).fit(X, y)
    runs = [EarlyStoppedNet((4,), runs=1, seed=seed).fit(X, y) for seed in range(12, 16)]
    best = max(runs, key=lambda run: run.net_.best_validation_score_)
    assert np.array_equal(net.predict_proba(X), best.predict_proba(X))
    assert net.parameters_ == 3 * 4 + 4 + 4 * 3 + 3


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


@pytest.mark.parametrize("model", [svm, softmax])
def test_a_duration_that_never_varied_does_not_matter(model):
    """All training captures are equally long, as HAART's; a shorter one is still told by its pressure."""
    ragged = random_corpus(per_class=4)
    corpus = Corpus.from_captures([np.repeat(one[:1], 60, 0) for one in ragged], ragged.captures, ragged.rate_hz)
    fitted = model(features=Jung54()).fit(corpus, corpus.gestures)
    short = Corpus.from_captures([one[:45] for one in corpus], corpus.captures, corpus.rate_hz)
    assert (fitted.predict(short) == corpus.gestures).mean() > 0.8
