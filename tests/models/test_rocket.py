"""Random convolutions and ridge: the ridge against scikit-learn, series against a loop."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import softmax
from sklearn.linear_model import Ridge as SklearnRidge
from sklearn.linear_model import RidgeClassifier
from sklearn.model_selection import LeaveOneGroupOut

from bench.models.rocket import PENALTIES, Ridge, Rocket
from bench.models.series import Series
from tests.conftest import random_corpus


@given(
    st.integers(3, 30),
    st.integers(1, 40),
    st.integers(2, 5),
    st.sampled_from(PENALTIES),
    st.integers(0, 99),
)
def test_ridge_and_what_it_predicts_for_left_out_groups_equal_scikit_learn(
    captures, width, groups, penalty, seed
):
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((captures, width)).astype(np.float32)
    features -= features.mean(axis=0)
    targets = np.where(rng.random((captures, 3)) < 0.4, 1.0, -1.0)
    group = np.concatenate([[0, 1], rng.integers(0, groups, captures - 2)])
    ours, exact = Ridge(features, targets), features.astype(np.float64)
    whole = SklearnRidge(alpha=penalty).fit(exact, targets)
    np.testing.assert_allclose(
        exact.T @ ours.dual_weights(penalty), whole.coef_.T, rtol=1e-4, atol=1e-6
    )
    expected = np.empty_like(targets)
    for train, test in LeaveOneGroupOut().split(features, groups=group):
        expected[test] = (
            SklearnRidge(alpha=penalty).fit(exact[train], targets[train]).predict(exact[test])
        )
    parts = [np.flatnonzero(group == g) for g in np.unique(group)]
    np.testing.assert_allclose(
        ours.predict_left_out(penalty, parts), expected, rtol=1e-4, atol=1e-5
    )


@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 30), st.integers(0, 99))
def test_series_equal_a_loop(rows, cols, longest, seed):
    corpus = random_corpus(
        subjects=2, per_class=1, grid=(rows, cols), longest=longest + 1, seed=seed
    )
    corpus = corpus[np.random.default_rng(seed).permutation(len(corpus))[:4]]
    values = []
    for frame in np.concatenate([*corpus]).astype(float):
        total = frame.sum()
        row = (
            sum((r + 1) * frame[r].sum() for r in range(rows)) / total if total else (rows + 1) / 2
        )
        col = (
            sum((c + 1) * frame[:, c].sum() for c in range(cols)) / total
            if total
            else (cols + 1) / 2
        )
        values.append([*frame.ravel(), total, row, col, frame.max(), (frame > 0.05 * 1023).mean()])
    values = np.array(values)
    sd = np.where(values.std(axis=0) > 1e-9, values.std(axis=0), 1)
    values = (values - values.mean(axis=0)) / sd
    captures = np.split(values, np.cumsum(corpus.lengths)[:-1])
    for series, own in zip(
        Series("both", length=12).fit(corpus).iter_series(corpus), captures, strict=True
    ):
        at = np.linspace(0, len(own) - 1, 12)
        expected = [np.interp(at, np.arange(len(own)), column) for column in own.T]
        np.testing.assert_allclose(series, expected, rtol=1e-4, atol=1e-4)


def test_scores_are_those_of_scikit_learn_with_the_best_penalty_and_temperature(corpus):
    fitted = Rocket(kernels=84).fit(corpus, corpus.gestures)
    features = fitted._compute_features(corpus)
    fitted._standardise(features)
    exact = RidgeClassifier(alpha=fitted.penalty_).fit(features.astype(np.float64), corpus.gestures)
    expected = softmax(
        exact.decision_function(features.astype(np.float64)) / fitted.temperature_, axis=1
    )
    np.testing.assert_allclose(fitted.predict_proba(corpus), expected, atol=1e-4)
    assert (fitted.predict(corpus) == corpus.gestures).mean() > 0.9
