"""Systems with steps: windows, repair, scaling and faults; parameters that are refused."""

import re

import numpy as np
import pytest

from bench import contract
from bench.corpora.corpus import COPY
from bench.corpora.windows import Windows
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.features.touch import TouchFeatures
from bench.ground.registry import load_part
from bench.models.classic.lda import lda
from bench.models.classic.softmax import softmax
from bench.models.classic.svm import svm
from bench.models.recipe import Recipe, apply_steps, build_recipe
from bench.models.steps import DamagedCopies, Repair, Scale
from tests.conftest import random_corpus
from tests.models.test_systems import COMPOSED


@pytest.mark.parametrize("system", [lambda: lda(TouchFeatures()), COMPOSED["series"]])
def test_decisions_are_those_on_each_window_alone(system, corpus):
    train, test = corpus[corpus.subjects != "4"], corpus[corpus.subjects == "4"][::-1]
    model = Recipe(system(), window=0.1, hop=0.07).fit(train, train.gestures)

    cut = Windows(0.1, 0.07)  # tests/models/test_steps.py has a loop
    alone, seen = cut(test), cut(train).detach()
    windows = np.column_stack([cut.source_rows(test), alone.piece, alone.lengths])
    alone = alone.detach()
    table, proba = model.decide(test)
    assert np.array_equal(table, windows) and len(windows) > len(test)
    np.testing.assert_allclose(proba, model.system_.predict_proba(alone), rtol=1e-6, atol=1e-12)
    mean = np.array([proba[windows[:, 0] == i].mean(axis=0) for i in range(len(test))])
    np.testing.assert_allclose(model.predict_proba(test), mean, rtol=1e-6, atol=1e-12)
    # and what it learnt from are windows too, each with its capture's label
    again = system().fit(seen, seen.gestures).predict_proba(alone)
    np.testing.assert_allclose(proba, again, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", ["jung28", "series"])
def test_parts_that_come_one_after_the_other_are_learned_like_all_at_once(name, corpus):
    inner = {"jung28": lambda: lda(Jung28()), "series": COMPOSED["series"]}[name]()
    recipe = Recipe(inner, window=0.1, repair=("dead",), faults=("noise",), copies=2)
    at_once = recipe.fit(corpus, corpus.gestures).predict_proba(corpus)
    parts = (corpus[i : i + 5] for i in range(0, len(corpus), 5))
    assert np.array_equal(recipe.fit_parts(parts).predict_proba(corpus), at_once)


def test_steps_are_taken_one_after_the_other(corpus):
    steps = [DamagedCopies(("noise",), 2), Repair(("offset", "dead")), Scale("peak"), Windows(0.1)]
    seen, row = apply_steps(corpus, steps)
    by_hand = corpus
    for step in steps:
        by_hand = step(by_hand)
    assert np.array_equal(seen.frames, by_hand.frames) and seen.steps == tuple(steps)
    assert np.array_equal(corpus.index[row], seen.index) and np.array_equal(
        corpus.gestures[row], seen.gestures
    )
    assert seen.piece.max() // COPY == 2
    model = build_recipe(
        svm, Jung28(), window=0.1, repair="offset+dead", scale="peak", faults=("noise",), copies=2
    )
    assert model.training_steps() == steps and model.prediction_steps() == steps[1:]
    model.fit(corpus, corpus.gestures)
    again = svm(Jung28()).fit(seen, seen.gestures)
    assert np.array_equal(model.system_.predict_proba(corpus), again.predict_proba(corpus))
    cut, _ = apply_steps(corpus, steps[1:])  # faults are for training alone
    assert np.array_equal(model.decide(corpus)[1], again.predict_proba(cut))


@pytest.mark.parametrize(
    ("model", "options"),
    [
        ("cnn85", {"window": 1.0}),
        ("reflex", {"hop": 0.1, "scale": "peak"}),
        ("svm", {"window": -1.0}),
        ("cnn85", {"faults": "nois"}),
        ("rf", {"copies": 0, "faults": "all"}),
        ("lda", {"shrinkage": -0.1}),
        ("perceptron", {"units": 0}),
        ("touchnet", {"kernel": 4}),
        ("rocket", {"kernels": 83}),
        ("hughes2017_cnn", {"device": "cuda:99"}),
        ("cnn85", {"epochs": 0}),
        ("cnn85", {"frames": 10**9}),
        ("ren2023_transformer", {"precision": "half"}),
        ("hughes2017_ae_rnn", {"pretraining": 0}),
        ("zhou2016_3dcnn", {"frames": 7, "seconds": 0.5}),
        ("cnn85", {"hop": 40, "frames": 20}),
        ("zhou2016_lrcn", {"average": 17, "frames": 16}),
        ("lda", {"bits": 4}),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(model, options, corpus):
    name, value = next(iter(options.items()))
    shown = f"{value:g}" if isinstance(value, float) else value
    with pytest.raises(InputError, match=f"^model.{name}={re.escape(str(shown))}[^\n]*$"):
        system = build_recipe(load_part("models", model), Jung28(), **options)
        contract.check_parameters(system)
        contract.check_training(system, corpus, corpus.gestures)


def test_weights_are_whole_steps_by_hand():
    corpus = random_corpus(longest=30)
    models = (Recipe(softmax(Jung28()), bits=bits).fit(corpus, corpus.gestures) for bits in (32, 8))
    for before, after in zip(*(model.system_.steps[-1][1].coef_ for model in models), strict=True):
        step = np.abs(before).max() / 127
        np.testing.assert_allclose(after, np.round(before / step) * np.float32(step), rtol=1e-6)
