"""What classifiers and networks do with captures of one person: against means, spreads and optima by hand."""

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from bench import contract
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.models import person
from bench.models.classic.svm import svm
from bench.models.nets.cnn85 import CNN85
from bench.models.nets.hughes2017 import Hughes2017CNNRNN
from bench.models.person import PRIOR, SPREAD_PRIOR, WEIGHT, PersonScaler, relearnt
from bench.models.recipe import Recipe
from tests.conftest import random_corpus


def rows(n, features=3, seed=0, classes="ab"):
    rng = np.random.default_rng(seed)
    y = np.array([classes[i % len(classes)] for i in range(n)])
    values = rng.normal(0, 1, (n, features)) + 3 * (y == "b")[:, None]
    return pd.DataFrame(values, columns=list("xyz")[:features]), y


@given(st.integers(1, 30), st.booleans())
def test_the_mean_of_a_person_by_hand(count, labelled):
    X, y = rows(40)
    own = PersonScaler(("centre",)).fit(X, y)
    Z, known = rows(count, seed=1)
    Z = Z + [10, 0, -4]
    adapted = own.adapt(Z, known if labelled else None)
    centres = {c: X.to_numpy()[y == c].mean(axis=0) for c in "ab"}
    usual = [centres[c] for c in known] if labelled else X.to_numpy().mean(axis=0)
    both = labelled and count % 2 == 0  # both classes alike: all of it counts
    expected = np.mean(Z.to_numpy() - usual, axis=0) * (1 if both else count / (count + PRIOR))
    np.testing.assert_allclose(adapted.transform(Z), Z.to_numpy() - expected, atol=1e-9)
    assert own.transform(Z) is Z  # it stays as it is


def test_the_spread_of_a_person_by_hand():
    (X, y), (Z, known) = rows(40), rows(10, seed=1)
    Z = 2 * Z
    centres = X.groupby(y).mean()
    within = lambda A, labels: (A.to_numpy() - centres.loc[labels].to_numpy()).std(axis=0)  # noqa: E731
    for given_labels, ratio in ((known, within(Z, known) / within(X, y)), (None, Z.std(ddof=0) / X.std(ddof=0))):
        expected = X.mean() + (Z - X.mean()) / ratio ** (10 / (10 + SPREAD_PRIOR))
        np.testing.assert_allclose(PersonScaler(("scale",)).fit(X, y).adapt(Z, given_labels).transform(Z), expected)


def test_pooled_captures_count_ten_times():
    corpus = random_corpus()
    train, own = (np.flatnonzero((corpus.subjects == "1") == yes) for yes in (False, True))
    known, tested = own[::2], own[1::2]
    model = Recipe(svm(Jung28()), person=("pool",)).fit(corpus[train], corpus.gestures[train])
    before = model.predict_proba(corpus[tested])
    plain = svm(Jung28()).fit(corpus[train], corpus.gestures[train])
    assert np.array_equal(before, plain.predict_proba(corpus[tested]))  # nothing changes before a person is met
    found = model.adapt(corpus[known], corpus.gestures[known])
    by_hand = np.concatenate([train, *[known] * WEIGHT])
    expected = svm(Jung28()).fit(corpus[by_hand], corpus.gestures[by_hand]).predict_proba(corpus[tested])
    np.testing.assert_allclose(found.predict_proba(corpus[tested]), expected)
    assert np.array_equal(model.predict_proba(corpus[tested]), before)
    without = model.adapt(corpus[known], None)
    assert np.array_equal(without.predict_proba(corpus[tested]), before)
    assert [name for name, _ in without.system_.steps] == ["features", "person", "scaler", "classifier"]


def test_the_last_layer_is_at_an_optimum_and_a_stiff_one_stays(monkeypatch):
    rng = np.random.default_rng(0)
    old, inputs = rng.normal(0, 1, (3, 5)), rng.normal(0, 1, (9, 4))
    codes, captures = rng.integers(0, 3, 9), np.repeat([0, 1, 2], [2, 3, 4])

    def loss(flat):
        new = flat.reshape(3, 5)
        total = 0.0
        for capture in range(3):
            own = np.flatnonzero(captures == capture)
            for i in own:
                logits = new[:, :4] @ inputs[i] + new[:, 4]
                total -= np.log(np.exp(logits[codes[i]]) / np.exp(logits).sum()) / len(own)
        size = np.mean([np.sum(row**2) + 1 for row in inputs])
        return total + 0.3 / 2 * size * np.sum((new - old) ** 2)

    found = relearnt(old, inputs, codes, captures)
    assert loss(found.ravel()) < loss(old.ravel())
    np.testing.assert_allclose(approx_fprime(found.ravel(), loss, 1e-6), 0, atol=1e-3)
    monkeypatch.setattr(person, "STIFF", 1e9)
    np.testing.assert_allclose(relearnt(old, inputs, codes, captures), old, atol=1e-6)


@pytest.mark.parametrize("make", [lambda: CNN85(frames=10, epochs=1, batch=16), lambda: Hughes2017CNNRNN(epochs=1)])
def test_a_network_learns_a_person_in_its_last_layer(make):
    corpus = random_corpus(longest=60, per_class=2)
    train, tested = np.flatnonzero(corpus.subjects != "1"), np.flatnonzero(corpus.subjects == "1")
    model = make().fit(corpus[train], corpus.gestures[train])
    before = model.predict_proba(corpus[tested])
    weights = [p.clone() for p in model.net_.parameters()]
    same, adapted = (contract.adapted(model, corpus[tested], y) for y in (None, corpus.gestures[tested]))
    assert contract.adapts(model) and np.array_equal(same.predict_proba(corpus[tested]), before)
    if isinstance(model, CNN85):  # a vote, which the other takes, moves in steps
        right = np.arange(len(tested)), np.searchsorted(model.classes_, corpus.gestures[tested])
        assert np.log(adapted.predict_proba(corpus[tested])[right]).mean() > np.log(before[right]).mean()
    changed = [not torch.equal(a, b) for a, b in zip(adapted.net_.parameters(), weights, strict=True)]
    assert changed[-2:] == [True, True] and not any(changed[:-2])
    assert all(torch.equal(a, b) for a, b in zip(model.net_.parameters(), weights, strict=True))
    with pytest.raises(InputError, match="'nod' is none of the classes"):
        model.adapt(corpus[:1], np.array(["nod"]))
