"""Discriminants against scikit-learn's, and windows of captures against covariances taken apart by hand."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import softmax
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from bench.features.touch import TouchFeatures
from bench.models import by_person
from bench.models.classic.lda import Discriminants, lda


def points(seed=0, counts=(20, 20, 20), d=4):
    """Classes that overlap, features of very different size, and correlated."""
    rng = np.random.default_rng(seed)
    y = np.repeat([*"abcdef"][: len(counts)], counts)
    own = rng.normal(size=(len(counts), d))[np.repeat(np.arange(len(counts)), counts)]
    X = (rng.normal(size=(len(y), d)) + own) @ rng.normal(size=(d, d))
    return X * 10.0 ** rng.integers(-3, 4, d) + rng.normal(size=d), y


def of_captures(seed, captures=30, d=3, classes=3):
    """Rows in any order of captures of 1 to 6 windows each, some of them damaged, as feature sets label them."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(1, 7, captures)
    labels = np.repeat(rng.permutation(1000)[:captures], rows), rng.integers(0, 3, rows.sum())
    index = pd.MultiIndex.from_arrays(labels, names=["capture", "copy"])
    code = np.repeat(np.arange(captures) % classes, rows)
    X = 2 * rng.normal(size=(classes, d))[code] + np.repeat(rng.normal(size=(captures, d)), rows, axis=0)
    X = (X + 0.5 * rng.normal(size=X.shape)) @ rng.normal(size=(d, d))
    order = rng.permutation(len(X))
    return pd.DataFrame(X, index=index).iloc[order], np.array([*"abcdef"])[code][order]


@given(
    st.integers(0, 10_000),
    st.sampled_from([(20, 20, 20), (5, 40, 12), (2, 3, 40, 6)]),
    st.sampled_from([0.001, 0.2, 0.7, 1.0]),
)
def test_discriminants_equal_scikit_learns(seed, counts, shrinkage):
    """Where classes are of different size, scikit-learn is given their shares, which weigh its covariance.

    Its scores then hold the logarithms of the shares, which are taken away: here classes count alike. Both shrink to
    the mean variance of the features as they are given, so scikit-learn is given standardised ones; its automatic
    shrinkage, which would scale once more, is not used.
    """
    X, y = points(seed, counts)
    shares = np.array(counts) / sum(counts)
    scaled = StandardScaler().fit_transform(X)
    theirs = LinearDiscriminantAnalysis(solver="lsqr", shrinkage=shrinkage, priors=shares).fit(scaled, y)
    expected = theirs.decision_function(scaled) - np.log(shares)
    ours = Discriminants(shrinkage).fit(X, y)
    np.testing.assert_allclose(ours.decision_function(X), expected, rtol=1e-6, atol=1e-6)
    assert np.array_equal(ours.predict(X), ours.classes_[expected.argmax(axis=1)])
    np.testing.assert_allclose(ours.predict_proba(X), softmax(expected, axis=1), rtol=1e-5, atol=1e-9)


@given(st.integers(0, 10_000), st.sampled_from([1.0, 2.0, 3.7, 8.0]), st.sampled_from([0.0, 0.2]))
def test_windows_of_a_capture_against_a_covariance_taken_apart(seed, windows, shrinkage):
    """Scores of so many windows in sum are the log density of their mean: between captures, and one n-th within."""
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
    expected = np.array([[-0.5 * (m - centre[c]) @ np.linalg.solve(one, m - centre[c]) for c in names] for m in Z[:7]])
    found = windows * model.decision_function(X.iloc[:7])
    np.testing.assert_allclose(found - found[:, :1], expected - expected[:, :1], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shrinkage", [0.0, 0.2, 1.0])
def test_constant_features_have_no_weight(shrinkage):
    X, y = points(d=3)
    still = np.column_stack([X, np.full(len(X), 7.0), np.full(len(X), 1e9) + np.arange(len(X)) % 2 * 1e-2, X * 0])
    model = Discriminants(shrinkage).fit(still, y)
    assert (model.coef_[:, 3:] == 0).all() and (model.coef_[:, :3] != 0).all()
    moved = still.copy()
    moved[:, 3:] = 1234
    assert np.array_equal(model.predict_proba(moved), model.predict_proba(still))
    if shrinkage == 0:  # else they count among the features whose mean variance it shrinks to
        np.testing.assert_allclose(model.coef_[:, :3], Discriminants(0).fit(X, y).coef_, rtol=1e-5)
    nothing = Discriminants(shrinkage).fit(X * 0 + 3, y)
    np.testing.assert_allclose(nothing.predict_proba(X), 1 / 3)


def left_out(stored, name):
    """Probabilities of `lda` trained without a person: statistics kept of other training parts, none kept, plain fit.

    Before, the process has kept statistics of all captures where this person goes by another one's name and has other
    gestures, and of all as they are.
    """
    subjects, y = stored.subjects, stored.gestures
    train = np.flatnonzero(subjects != name)
    other = subjects[train[0]]
    wrong = np.where(subjects == name, np.roll(y, 1), y)
    renamed = stored.changed(captures=stored.captures.assign(subject=np.where(subjects == name, other, subjects)))
    by_person.KEPT.clear()
    for X, gestures in ((renamed, wrong), (stored, wrong), (stored, y)):
        lda(TouchFeatures()).fit(X, gestures)
    warm = lda(TouchFeatures()).fit(stored[train], y[train])
    by_person.KEPT.clear()
    cold = lda(TouchFeatures()).fit(stored[train], y[train])
    plain = Pipeline(lda(TouchFeatures()).steps).fit(stored[train], y[train])
    assert by_person.KEPT and warm.fit_seconds_[0] > 0
    return [model.predict_proba(stored) for model in (warm, cold, plain)]


def test_leaving_persons_out_equals_the_plain_fit_and_takes_nothing_of_them(stored):
    for name in set(stored.subjects):
        warm, cold, plain = left_out(stored, name)
        assert np.array_equal(warm, cold)
        np.testing.assert_allclose(cold, plain, rtol=0, atol=1e-9)
