"""Adaptation to one person, against means, spreads and optima by hand."""

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from bench.errors import InputError
from bench.features.base import capture_copy_index
from bench.features.jung28 import Jung28
from bench.features.touch import TouchFeatures
from bench.models.adapters import FromTorch
from bench.models.classic.lda import Discriminants, lda
from bench.models.classic.softmax import softmax
from bench.models.classic.svm import svm
from bench.models.nets.cnn85 import CNN85
from bench.models.nets.hughes2017 import Hughes2017CNN
from bench.models.quantised import quantise_pipeline
from bench.models.recipe import Recipe
from bench.models.reflex import Reflex
from tests.conftest import random_corpus
from tests.running.fakes import Level
from touchbench_people import last_layer
from touchbench_people.adaptation import (
    PRIOR_CAPTURES,
    SHOT_WEIGHT,
    adapt_discriminants,
    adapt_system,
    can_adapt,
    relearn_layer,
)
from touchbench_people.scaler import SPREAD_PRIOR, PersonScaler, adaptable


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
    mine = own.adapt(Z, known if labelled else None)
    centres = {c: X.to_numpy()[y == c].mean(axis=0) for c in "ab"}
    usual = [centres[c] for c in known] if labelled else X.to_numpy().mean(axis=0)
    both = labelled and count % 2 == 0  # both classes alike: all of it counts
    expected = np.mean(Z.to_numpy() - usual, axis=0) * (
        1 if both else count / (count + PRIOR_CAPTURES)
    )
    np.testing.assert_allclose(mine.transform(Z), Z.to_numpy() - expected, atol=1e-9)
    assert own.transform(Z) is Z  # it stays as it is


def test_the_spread_of_a_person_by_hand():
    (X, y), (Z, known) = rows(40), rows(10, seed=1)
    Z = 2 * Z
    centres = X.groupby(y).mean()
    sd_within = lambda A, labels: (A - centres.loc[labels].to_numpy()).std(ddof=0)  # noqa: E731
    ratios = [(known, sd_within(Z, known) / sd_within(X, y)), (None, Z.std(ddof=0) / X.std(ddof=0))]
    for labels, ratio in ratios:
        expected = X.mean() + (Z - X.mean()) / ratio ** (10 / (10 + SPREAD_PRIOR))
        scaler = PersonScaler(("scale",)).fit(X, y).adapt(Z, labels)
        np.testing.assert_allclose(scaler.transform(Z), expected)


def test_pooled_captures_count_ten_times():
    corpus = random_corpus()
    train, own = (np.flatnonzero((corpus.subjects == "1") == yes) for yes in (False, True))
    known, tested = own[::2], own[1::2]
    model = adaptable(Jung28(), "svm", ("pool",)).fit(corpus[train], corpus.gestures[train])
    before = model.predict_proba(corpus[tested])
    plain = svm(Jung28()).fit(corpus[train], corpus.gestures[train])
    assert np.array_equal(before, plain.predict_proba(corpus[tested]))  # not adapted yet
    found = adapt_system(model, corpus[known], corpus.gestures[known])
    by_hand = np.concatenate([train, *[known] * SHOT_WEIGHT])
    refitted = svm(Jung28()).fit(corpus[by_hand], corpus.gestures[by_hand])
    expected = refitted.predict_proba(corpus[tested])
    np.testing.assert_allclose(found.predict_proba(corpus[tested]), expected)
    assert np.array_equal(model.predict_proba(corpus[tested]), before)
    without = adapt_system(model, corpus[known], None)
    assert np.array_equal(without.predict_proba(corpus[tested]), before)
    assert [name for name, _ in without.steps] == ["features", "person", "scaler", "classifier"]


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

    found = relearn_layer(old, inputs, codes, captures)
    assert loss(found.ravel()) < loss(old.ravel())
    np.testing.assert_allclose(approx_fprime(found.ravel(), loss, 1e-6), 0, atol=1e-3)
    monkeypatch.setattr(last_layer, "STIFFNESS", 1e9)
    np.testing.assert_allclose(relearn_layer(old, inputs, codes, captures), old, atol=1e-6)


def test_a_network_learns_a_person_in_its_last_layer():
    corpus = random_corpus(longest=60, per_class=2)
    train, tested = np.flatnonzero(corpus.subjects != "1"), np.flatnonzero(corpus.subjects == "1")
    model = CNN85(frames=10, epochs=1, batch=16).fit(corpus[train], corpus.gestures[train])
    before = model.predict_proba(corpus[tested])
    weights = [p.clone() for p in model.net_.parameters()]
    same, mine = (adapt_system(model, corpus[tested], y) for y in (None, corpus.gestures[tested]))
    assert can_adapt(model) and np.array_equal(same.predict_proba(corpus[tested]), before)
    right = np.arange(len(tested)), np.searchsorted(model.classes_, corpus.gestures[tested])
    assert np.log(mine.predict_proba(corpus[tested])[right]).mean() > np.log(before[right]).mean()
    changed = [not torch.equal(a, b) for a, b in zip(mine.net_.parameters(), weights, strict=True)]
    assert changed[-2:] == [True, True] and not any(changed[:-2])
    assert all(torch.equal(a, b) for a, b in zip(model.net_.parameters(), weights, strict=True))
    with pytest.raises(InputError, match="'nod' is not a class"):
        adapt_system(model, corpus[:1], np.array(["nod"]))


def capture_rows(values, captures):
    """Rows of captures, equally many of each."""
    capture = np.repeat(np.arange(captures), len(values) // captures)
    return pd.DataFrame(values, index=capture_copy_index(capture, np.zeros(len(values), dtype=int)))


@pytest.mark.parametrize("labelled", [True, False])
def test_adapting_is_learning_again_from_rows_of_training_and_of_the_person(labelled):
    """Against naive loops over all rows together, in the units of training."""
    rng, windows = np.random.default_rng(0), 2.0
    X = capture_rows(rng.normal(size=(120, 6)), 40)
    y = rng.integers(0, 3, 40).astype(str).repeat(3)
    P = capture_rows(rng.normal(0.7, 1, (20, 6)), 10)
    yp = np.array(list("0001001001")).repeat(2)  # and none of the third class
    general = Discriminants(0.2, windows).fit(X, y)
    before = general.decision_function(P)
    own = adapt_discriminants(general, P, yp if labelled else None, weight=4.0)
    mean, sd = X.to_numpy().mean(axis=0), X.to_numpy().std(axis=0)
    person = (P.to_numpy() - mean) / sd
    rows = (X.to_numpy() - mean) / sd
    first = np.array([rows[y == c].mean(axis=0) for c in "012"])
    rest = person - first[yp.astype(int)] if labelled else person  # 7 and 3 captures of two classes
    shift = rest.mean(axis=0) * 10 / 15
    names, weight, capture = y, np.ones(120), np.repeat(np.arange(40), 3)
    if labelled:
        rows, names = np.vstack([rows, person - shift]), np.concatenate([y, yp])
        weight = np.concatenate([weight, np.full(20, 4.0)])
        capture = np.concatenate([capture, 100 + np.repeat(np.arange(10), 2)])
    members = [names == c for c in "012"]
    centres = np.array([np.average(rows[m], axis=0, weights=weight[m]) for m in members])
    scatter = np.zeros((6, 6))
    for row, name, w in zip(rows, names, weight, strict=True):
        d = row - centres[int(name)]
        scatter += w * np.outer(d, d)
    for each in np.unique(capture):
        part = capture == each
        d = np.average(rows[part], axis=0, weights=weight[part]) - centres[int(names[part][0])]
        scatter += (windows - 1) * weight[part].sum() * np.outer(d, d)
    scatter /= weight.sum()
    scatter = 0.8 * scatter + (0.2 * np.trace(scatter) / 6 + 1e-9) * np.eye(6)
    coef = np.linalg.solve(scatter, centres.T).T
    probe = rng.normal(size=(7, 6))
    expected = ((probe - mean) / sd - shift) @ coef.T - 0.5 * (coef * centres).sum(axis=1)
    np.testing.assert_allclose(own.decision_function(probe), expected, atol=1e-9)
    np.testing.assert_array_equal(general.decision_function(P), before)  # it stays as it is


class InPlace(Level):
    """Changes its own arrays for a person, as much code of others does."""

    def adapt(self, X, y):
        self.means_[:] = self.means_[::-1].copy()
        return self


def test_what_adapts_in_place_carries_nothing_into_other_tests():
    corpus = random_corpus(subjects=2, per_class=2)
    train, test = (corpus[np.flatnonzero(corpus.subjects == name)] for name in "12")
    system = InPlace().fit(train, train.gestures)
    before = system.predict(test).tolist()
    adapted = adapt_system(system, test, test.gestures)
    assert adapted.predict(test).tolist() != before == system.predict(test).tolist()


def test_what_cannot_adapt():
    assert can_adapt(Reflex()) and can_adapt(adaptable(Jung28())) and can_adapt(Hughes2017CNN())
    module = FromTorch(module=lambda *_: None)
    rounded = Recipe(softmax(Jung28()), bits=8)
    others = [Hughes2017CNN(bits=8), rounded, svm(Jung28()), module, Level()]
    assert not any(map(can_adapt, others))
    wrong_ways = [{"ways": ("mean",)}, {"ways": ("pool", "pool")}]
    for wrong in (*wrong_ways, {"classifier": "lda"}, {"classifier": "cnn85"}):
        with pytest.raises(InputError, match="model.(ways|classifier)="):
            adaptable(Jung28(), **wrong)


@pytest.mark.parametrize("system", ("lda", "reflex"))
def test_weights_in_few_bits_adapt_like_exact_ones_and_stay_in_few_bits(system):
    corpus = random_corpus(subjects=2, per_class=3, grid=(4, 4), longest=90)
    train, person = (corpus[np.flatnonzero(corpus.subjects == name)] for name in "12")
    adapted = []
    for bits in (32, 8):
        general = Reflex(bits=bits, copies=1) if system == "reflex" else None
        general = general or Recipe(lda(TouchFeatures()), window=0.5, bits=bits)
        assert can_adapt(general)
        fitted = general.fit(train, train.gestures)
        before = fitted.predict_proba(person)
        adapted.append(adapt_system(fitted, person, person.gestures))
        assert np.array_equal(fitted.predict_proba(person), before)
    exact, rounded = (getattr(one, "whole_", one).system_ for one in adapted)
    expected = quantise_pipeline(exact, 8)[-1]
    found = rounded[-1]
    if system == "reflex":
        expected, found = expected.linear_, found.linear_
    np.testing.assert_allclose(found.coef_, expected.coef_)
    assert not np.allclose(found.coef_, getattr(exact[-1], "linear_", exact[-1]).coef_, rtol=1e-9)
