"""Weights in 8 bits: as whole numbers by hand, twice as once, and what C stores of them."""

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline

from bench import contract
from features.jung28 import Jung28
from features.touch import TouchFeatures
from models.classic.bayes import bayes
from models.classic.lda import lda
from models.classic.softmax import softmax
from models.nets.hughes2017 import Hughes2017CNN, Hughes2017CNNRNN
from models.quantised import in_bits
from models.recipe import Recipe
from models.reflex import Reflex
from tests.conftest import random_corpus

SYSTEMS = {
    "lda": lambda bits: Recipe(lda(TouchFeatures()), window=0.1, bits=bits),
    "softmax": lambda bits: Recipe(softmax(Jung28()), bits=bits),
    "bayes": lambda bits: Recipe(bayes(Jung28()), bits=bits),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_it_decides_nearly_as_before_and_again_the_same(name):
    corpus = random_corpus(longest=30)
    full, few = (SYSTEMS[name](bits).fit(corpus, corpus.gestures) for bits in (32, 8))
    difference = np.abs(full.predict_proba(corpus) - few.predict_proba(corpus))
    assert difference.any() and np.median(difference) < 0.02
    *before, one = [step for _, step in few.system_.steps]
    table = make_pipeline(*before).transform(corpus)
    other = in_bits(few.system_, 8).steps[-1][1]
    np.testing.assert_allclose(one.predict_proba(table), other.predict_proba(table), atol=1e-9)


def test_weights_are_whole_steps_by_hand():
    corpus = random_corpus(longest=30)
    models = (SYSTEMS["softmax"](bits).fit(corpus, corpus.gestures) for bits in (32, 8))
    for before, after in zip(*(model.system_.steps[-1][1].coef_ for model in models), strict=True):
        step = np.abs(before).max() / 127
        np.testing.assert_allclose(after, np.round(before / step) * np.float32(step), rtol=1e-6)


def test_few_bits_do_not_adapt():
    for kind in (Reflex, Hughes2017CNN):
        assert not contract.adapts(kind(bits=8)) and contract.adapts(kind())
    assert "bits" not in Hughes2017CNNRNN().get_params() and contract.adapts(Hughes2017CNNRNN())
