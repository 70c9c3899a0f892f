"""Classifiers and scalers against independent computations; published grids and networks."""

from unittest import mock

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import softmax
from scipy.stats import multivariate_normal
from sklearn.base import clone
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.tree import DecisionTreeClassifier

from bench import contract
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models import by_person
from bench.models.classic import row_summaries
from bench.models.classic.bayes import GaussianBayes
from bench.models.classic.jung2014 import jung2014_svm
from bench.models.classic.jung2017 import jung2017_nn, jung2017_svm_rbf, jung2017_tree
from bench.models.classic.lda import Discriminants, lda
from bench.models.classic.scaling import RangeScaler, ZScaler
from bench.models.classic.tree import PrunedTree
from bench.models.classic.wingerden2014 import wingerden2014_mlp
from bench.models.recipe import build_recipe
from bench.models.reflex import Reflex


def points(seed=0, counts=(20, 20, 20), d=4):
    """Classes that overlap, features of very different size, and correlated."""
    rng = np.random.default_rng(seed)
    y = np.repeat([*"abcdef"][: len(counts)], counts)
    own = rng.normal(size=(len(counts), d))[np.repeat(np.arange(len(counts)), counts)]
    X = (rng.normal(size=(len(y), d)) + own) @ rng.normal(size=(d, d))
    return X * 10.0 ** rng.integers(-3, 4, d) + rng.normal(size=d), y


def test_bayes_equals_scipys_normal_density():
    X, y = points(d=3)
    model = GaussianBayes(ridge=0.01).fit(X, y)
    densities = [
        multivariate_normal(X[y == c].mean(axis=0), np.cov(X[y == c].T) + 0.01 * np.eye(3)).pdf(X)
        / 3
        for c in "abc"
    ]
    expected = np.stack(densities, axis=1)
    np.testing.assert_allclose(
        model.predict_proba(X), expected / expected.sum(axis=1, keepdims=True), rtol=1e-8
    )
    X = np.column_stack([X, X.sum(axis=1), np.ones(len(X))])  # dependent and constant features
    assert np.isfinite(GaussianBayes(1e-6).fit(X, y).predict_proba(X)).all()


def test_a_level_is_a_step_of_the_pruning_sequence():
    """All equally weak links are cut in one step, and what costs nothing is no step of its own."""
    X, y = points(counts=(80, 80, 80), d=3)
    X = (2 * X / X.std(axis=0)).round()  # coarse values, so that several links are equally weak

    def leaves(**how):
        return DecisionTreeClassifier(random_state=0, **how).fit(X, y).get_n_leaves()

    alphas = DecisionTreeClassifier(random_state=0).cost_complexity_pruning_path(X, y).ccp_alphas
    pruned = dict.fromkeys(leaves(ccp_alpha=alpha + 1e-9) for alpha in alphas if alpha > 1e-9)
    kept = [
        n for n in (leaves(), *pruned) if n >= 3
    ]  # fewer leaves than classes cannot name them all
    steps = [PrunedTree(level).fit(X, y).tree_.get_n_leaves() for level in range(len(kept) + 2)]
    assert len(kept) > 5 and steps == [*kept, kept[-1], kept[-1]]


def test_networks_and_grids_are_the_published_ones():
    grid = jung2017_svm_rbf().spaces["svm"]
    assert len(grid["C"]) == 11 and len(grid["gamma"]) == 10
    assert (min(grid["C"]), max(grid["C"]), min(grid["gamma"]), max(grid["gamma"])) == (
        2**-5,
        2**15,
        2**-15,
        2**3,
    )
    assert (
        jung2014_svm().spaces["svm"]["kernel"] == ["linear"]
        and len(jung2014_svm().spaces["svm"]["C"]) == 11
    )
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
    assert (ours.transform(test)[:, 3] == still).all() and (
        ours.transform(train)[:, 3] == still
    ).all()
    assert np.abs(theirs.transform(test)[:, 3]).max() > 100


# Discriminants


def of_captures(seed, captures=30, d=3, classes=3):
    """Rows of captures of 1 to 6 windows in random order, some damaged, with the usual index."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(1, 7, captures)
    labels = np.repeat(rng.permutation(1000)[:captures], rows), rng.integers(0, 3, rows.sum())
    index = pd.MultiIndex.from_arrays(labels, names=["capture", "copy"])
    code = np.repeat(np.arange(captures) % classes, rows)
    X = 2 * rng.normal(size=(classes, d))[code] + np.repeat(
        rng.normal(size=(captures, d)), rows, axis=0
    )
    X = (X + 0.5 * rng.normal(size=X.shape)) @ rng.normal(size=(d, d))
    order = rng.permutation(len(X))
    return pd.DataFrame(X, index=index).iloc[order], np.array([*"abcdef"])[code][order]


@given(
    st.integers(0, 10_000),
    st.sampled_from([(20, 20, 20), (5, 40, 12), (2, 3, 40, 6)]),
    st.sampled_from([0.001, 0.2, 0.7, 1.0]),
)
def test_discriminants_equal_scikit_learns(seed, counts, shrinkage):
    """Classes of different size: scikit-learn is given their shares, which weight its covariance.

    Its scores then hold the logarithms of the shares, which are taken away: here classes count
    alike. Both shrink to the mean variance of the features as they are given, so scikit-learn is
    given standardised ones; its automatic shrinkage, which would scale once more, is not used.
    """
    X, y = points(seed, counts)
    shares = np.array(counts) / sum(counts)
    scaled = StandardScaler().fit_transform(X)
    theirs = LinearDiscriminantAnalysis(solver="lsqr", shrinkage=shrinkage, priors=shares).fit(
        scaled, y
    )
    expected = theirs.decision_function(scaled) - np.log(shares)
    ours = Discriminants(shrinkage).fit(X, y)
    np.testing.assert_allclose(ours.decision_function(X), expected, rtol=1e-6, atol=1e-6)
    assert np.array_equal(ours.predict(X), ours.classes_[expected.argmax(axis=1)])
    np.testing.assert_allclose(
        ours.predict_proba(X), softmax(expected, axis=1), rtol=1e-5, atol=1e-9
    )


@given(st.integers(0, 10_000), st.sampled_from([1.0, 2.0, 3.7, 8.0]), st.sampled_from([0.0, 0.2]))
def test_windows_of_a_capture_against_a_covariance_taken_apart(seed, windows, shrinkage):
    """The sum of window scores is the log density of the windows' mean."""
    X, y = of_captures(seed)
    captures = X.index.get_level_values("capture").to_numpy()
    Z = X.to_numpy()
    Z = (Z - Z.mean(axis=0)) / Z.std(axis=0)
    names = sorted(set(y))
    centre = {c: Z[y == c].mean(axis=0) for c in names}
    between, within = np.zeros((3, 3)), np.zeros((3, 3))
    for capture in set(captures):
        rows = Z[captures == capture]
        own = rows.mean(axis=0)
        away = own - centre[y[captures == capture][0]]
        for row in rows:
            between += np.outer(away, away) / len(X)
            within += np.outer(row - own, row - own) / len(X)
    one = between + within / windows
    one = (1 - shrinkage) * one + shrinkage * np.trace(one) / 3 * np.eye(3)
    model = Discriminants(shrinkage, windows).fit(X, y)
    expected = np.array(
        [
            [-0.5 * (m - centre[c]) @ np.linalg.solve(one, m - centre[c]) for c in names]
            for m in Z[:7]
        ]
    )
    found = windows * model.decision_function(X.iloc[:7])
    np.testing.assert_allclose(
        found - found[:, :1], expected - expected[:, :1], rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("shrinkage", [0.0, 0.2])
def test_constant_features_have_no_weight(shrinkage):
    X, y = points(d=3)
    rounded = 1e9 + np.arange(len(X)) % 2 * 64  # a step of single precision
    still = np.column_stack([X, np.full(len(X), 7.0), rounded, X / X.std(axis=0) * 1e-14])
    model = Discriminants(shrinkage).fit(still, y)
    assert (model.coef_[:, 3:] == 0).all() and (model.coef_[:, :3] != 0).all()
    moved = still.copy()
    moved[:, 3:] = 1234
    assert np.array_equal(model.predict_proba(moved), model.predict_proba(still))
    if shrinkage == 0:  # else they count among the features whose mean variance it shrinks to
        np.testing.assert_allclose(model.coef_[:, :3], Discriminants(0).fit(X, y).coef_, rtol=1e-5)
    nothing = Discriminants(shrinkage).fit(X * 0 + 3, y)
    np.testing.assert_allclose(nothing.predict_proba(X), 1 / 3)


def test_leaving_a_person_out_equals_the_plain_fit_and_takes_nothing_of_them(stored):
    """Warm: summaries of all captures are kept, also of this person with other labels and name.

    Cold: nothing is kept.
    """
    subjects, y = stored.subjects, stored.gestures
    train = np.flatnonzero(subjects != "2")
    wrong, others = (
        np.where(subjects == "2", np.roll(y, 1), y),
        np.where(subjects == "2", "1", subjects),
    )
    renamed = stored.with_fields(captures=stored.captures.assign(subject=others))
    by_person.CACHE.clear()
    for X, gestures in ((renamed, wrong), (stored, wrong), (stored, y)):
        lda(TouchFeatures()).fit(X, gestures)
    warm = lda(TouchFeatures()).fit(stored[train], y[train])
    by_person.CACHE.clear()
    cold = lda(TouchFeatures()).fit(stored[train], y[train])
    plain = Pipeline(lda(TouchFeatures()).steps).fit(stored[train], y[train])
    assert by_person.CACHE and warm.fit_seconds_[0] > 0
    proba = cold.predict_proba(stored)
    assert np.array_equal(warm.predict_proba(stored), proba)
    np.testing.assert_allclose(proba, plain.predict_proba(stored), rtol=0, atol=1e-9)


@given(st.integers(0, 10_000), st.sampled_from([1.0, 3.7]))
def test_summaries_of_persons_merge_to_that_of_all_rows_and_halves_are_kept(seed, windows):
    X, y = of_captures(seed, captures=40)
    person_of_capture = np.random.default_rng(seed).integers(0, 16, 1000)
    persons = person_of_capture[X.index.get_level_values("capture")]
    tree, model = row_summaries.SummaryTree(), Discriminants(0.2, windows, damaged=0.3)
    keys = tuple(np.unique(persons).tolist())
    tree.persons = {key: model.summarise_rows(X[persons == key], y[persons == key]) for key in keys}
    with mock.patch.object(
        row_summaries, "merge_summaries", side_effect=row_summaries.merge_summaries
    ) as merge:
        for left_out in keys:
            rest = tuple(key for key in keys if key != left_out)
            merged = tree.merge(rest)
    assert merge.call_count <= (len(keys) + 1) * 9  # of 16 keys, 4 halves a person and 4 again
    alone = row_summaries.SummaryTree(tree.persons).merge(rest)
    assert np.array_equal(merged.scatters, alone.scatters)
    rows = persons != left_out
    fitted = Discriminants(0.2, windows, damaged=0.3).fit(X[rows], y[rows])
    coef = model.fit_summary(merged).coef_
    np.testing.assert_allclose(coef, fitted.coef_, rtol=1e-7, atol=1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=5)
def test_settings_are_the_best_for_people_left_out_and_of_equals_the_first(seed):
    """Against a loop of plain fits, and accuracies of undamaged captures; e judges nothing."""
    X, y = of_captures(seed, captures=60, d=6)
    captures = X.index.get_level_values("capture").to_numpy()
    subjects = np.array([*"abcde"])[captures % 5]
    is_whole = X.index.get_level_values("copy") == 0
    best, expected = -1.0, None
    for windows in (1.0, 4.0):
        for shrinkage in (0.4, 0.2, 0.1, 0.05, 0.025):
            people = []
            for person in "abcd":
                rest, own = subjects != person, (subjects == person) & is_whole
                model = Discriminants(shrinkage, windows, damaged=0.3).fit(X[rest], y[rest])
                proba = pd.DataFrame(model.predict_proba(X[own])).groupby(captures[own]).mean()
                labels = pd.Series(y[own]).groupby(captures[own]).first()
                people.append((model.classes_[proba.to_numpy().argmax(axis=1)] == labels).mean())
            if np.mean(people) > best + 1e-9:
                best, expected = np.mean(people), (shrinkage, windows)
    model = Discriminants(damaged=0.3, tune=True).fit(X, y, np.where(subjects == "e", "", subjects))
    assert model.chosen_ == {"shrinkage": expected[0], "windows": expected[1]}
    plain = Discriminants(*expected, damaged=0.3).fit(X, y)
    assert np.array_equal(model.coef_, plain.coef_) and not plain.chosen_


def test_one_person_cannot_be_left_out(stored):
    one = stored[np.flatnonzero(stored.subjects == "2")]
    for model in (lda(TouchFeatures(), tune=True), Reflex(tune=True)):
        with pytest.raises(InputError, match="leaving training subjects out"):
            contract.check_training(model, one, one.gestures)
    with pytest.raises(InputError, match="leaving training subjects out"):
        lda(TouchFeatures(), tune=True).fit(one, one.gestures)


def test_every_way_to_windows_tunes_with_the_people_of_its_rows(stored):
    """Features from a file or computed, training in parts, and reflex give the same choice."""
    options = {"window": 1.0, "repair": ("stuck", "dead")}
    recipe = build_recipe(lda, TouchFeatures(), tune=True, **options)
    chosen = contract.chosen_values(clone(recipe).fit(stored, stored.gestures))
    in_memory = stored.with_fields(digest="", path=None)
    parts = [in_memory[np.flatnonzero(in_memory.subjects == s)] for s in np.unique(stored.subjects)]
    for fitted in (
        clone(recipe).fit(in_memory, stored.gestures),
        clone(recipe).fit_parts(parts),
        Reflex(tune=True, copies=1).fit(stored, stored.gestures),
    ):
        assert contract.chosen_values(fitted) == chosen != {}
        assert contract.searches_itself(fitted)


def test_a_table_in_place_of_captures_is_fitted_as_usual(stored):
    """As `bench tune` does, which computes the features itself."""
    table = TouchFeatures().fit_transform(stored)
    model = lda("passthrough").fit(table, stored.gestures)
    alone = Discriminants().fit(table, stored.gestures)
    assert np.array_equal(model.predict_proba(table), alone.predict_proba(table))
