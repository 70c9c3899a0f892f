"""Which recognisers decide together: against a search over all weights, and by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import log_loss

from models.search.ensemble import Ensemble, selected, temperature_of, tempered


def drawn(seed, members=3, captures=30, classes=3):
    rng = np.random.default_rng(seed)
    codes = rng.integers(classes, size=captures)
    proba = rng.dirichlet(np.ones(classes), (members, captures))
    proba[:, np.arange(captures), codes] += rng.random((members, 1))
    return proba / proba.sum(axis=2, keepdims=True), codes, rng.integers(4, size=captures).astype(str)


def loss_of(proba, codes, subjects):
    """Mean of the subjects' log losses, by scikit-learn."""
    labels = list(range(proba.shape[1]))
    return np.mean([log_loss(codes[subjects == s], proba[subjects == s], labels=labels) for s in set(subjects)])


@given(st.integers(0, 200))
def test_each_pick_is_the_best_next_one(seed):
    proba, codes, subjects = drawn(seed)
    weights = selected(proba, codes, subjects, lambda some: True)
    picks, best = [0], loss_of(proba[0], codes, subjects)
    while len(picks) < 15:
        losses = [loss_of(proba[[*picks, i]].mean(axis=0), codes, subjects) for i in range(3)]
        if min(losses) >= best - 1e-9:
            break
        best = min(losses)
        picks.append(int(np.argmin(losses)))
    assert weights == pytest.approx({i: picks.count(i) / len(picks) for i in set(picks)})
    assert sum(weights.values()) == pytest.approx(1)


def test_what_is_not_allowed_is_not_picked():
    proba, codes, subjects = drawn(1, members=6)
    for most in (1, 2, 3):
        assert len(selected(proba, codes, subjects, lambda some, most=most: len(some) <= most)) <= most
    assert 0 not in selected(proba, codes, subjects, lambda some: 0 not in some)
    assert selected(proba, codes, subjects, lambda some: False) == {}


def test_subjects_count_alike_however_many_captures_they_have():
    codes, subjects = np.zeros(11, dtype=int), np.array(["a"] * 10 + ["b"])
    often = np.tile([0.8, 0.2], (11, 1))
    often[10] = [0.01, 0.99]  # right for the many captures of a, wrong for the one of b
    steady = np.tile([0.5, 0.5], (11, 1))
    assert loss_of(often, codes, subjects) > loss_of(steady, codes, subjects)
    assert list(selected(np.stack([steady, often]), codes, subjects, lambda some: some != {0, 1})) == [0]


@given(st.integers(0, 50))
def test_the_temperature_has_the_least_loss(seed):
    proba, codes, _ = drawn(seed)
    found = temperature_of(proba[0], codes)
    grid = np.exp(np.linspace(np.log(0.05), np.log(20), 400))
    losses = [log_loss(codes, tempered(proba[0], t), labels=[0, 1, 2]) for t in grid]
    assert log_loss(codes, tempered(proba[0], found), labels=[0, 1, 2]) <= min(losses) + 1e-6


def test_probabilities_of_half_precision_keep_their_zeros():
    proba = np.array([[1, 0], [0.5, 0.5]], dtype=np.float16)
    assert np.isfinite(tempered(proba, 2.0)).all() and tempered(proba, 2.0)[1].tolist() == [0.5, 0.5]
    assert np.isfinite(temperature_of(proba, np.array([1, 0])))


class Says:
    classes_ = np.array(["a", "b"])

    def __init__(self, label):
        self.label = label

    def predict(self, X):
        return np.full(len(X), self.label)


def test_members_without_probabilities_vote_by_weight():
    together = Ensemble([Says("a"), Says("b")], [0.4, 0.6], [1.0, 1.0])
    np.testing.assert_allclose(together.predict_proba([0]), [[0.4, 0.6]], atol=1e-6)
    assert together.predict([0, 0]).tolist() == ["b", "b"]
