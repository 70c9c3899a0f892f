"""Which recognisers decide together: against a search over all weights, and by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import log_loss

from bench.models.search.ensemble import fit_temperature, logarithms, selected, tempered


def drawn(seed, members=3, captures=30, classes=3):
    rng = np.random.default_rng(seed)
    codes = rng.integers(classes, size=captures)
    proba = rng.dirichlet(np.ones(classes), (members, captures))
    proba[:, np.arange(captures), codes] += rng.random((members, 1))
    return proba / proba.sum(axis=2, keepdims=True), codes, rng.integers(4, size=captures).astype(str)


def loss_of(proba, codes, subjects):
    """Mean of the subjects' log losses."""
    return np.mean(
        [-np.log([p[c] for p, c in zip(proba, codes, strict=True)])[subjects == s].mean() for s in set(subjects)]
    )


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


@pytest.mark.parametrize("bounds", [(0.05, 20.0), (0.9, 1.1)])
@pytest.mark.parametrize("seed", range(2))
def test_the_temperature_has_the_least_loss_within_its_bounds(seed, bounds):
    proba, codes, _ = drawn(seed)
    losses = {}
    for t in np.geomspace(*bounds, 300):
        powers = proba[0] ** (1 / t)
        losses[t] = log_loss(codes, powers / powers.sum(axis=1, keepdims=True), labels=[0, 1, 2])
    best = fit_temperature(logarithms(proba[0]), codes, *bounds)
    assert bounds[0] <= best <= bounds[1] and best == pytest.approx(min(losses, key=losses.get), rel=0.03)
    np.testing.assert_allclose(tempered(proba[0], t), powers / powers.sum(axis=1, keepdims=True))
