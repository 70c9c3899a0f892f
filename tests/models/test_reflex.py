"""reflex: what it is made of, and that nothing of the people it is tested on reaches it."""

from functools import partial

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.corpora.steps import Repair, Windows
from bench.features.base import labels
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import Discriminants
from bench.models.classic.perceptron import Perceptron
from bench.models.out_of_distribution import Guarded
from bench.models.reflex import Reflex
from tests.conftest import random_corpus


@pytest.fixture(autouse=True)
def few_updates(monkeypatch):
    """The network learns for a shorter time than it does for a user."""
    monkeypatch.setattr("bench.models.out_of_distribution.Perceptron", partial(Perceptron, updates=100))


@pytest.fixture(scope="module")
def corpus():
    made = random_corpus(subjects=4, per_class=3, grid=(4, 5))
    lengths = np.resize([12, 25, 40, 60, 90], len(made))
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 400, (n, 4, 5)).astype(np.uint16) * (1 + i % 3) for i, n in enumerate(lengths)]
    return Corpus.from_captures(frames, made.captures, 30.0)


def test_a_capture_is_the_mean_of_its_windows_and_a_short_one_has_weights_of_its_own(corpus):
    system = Reflex(faults=("none",)).fit(corpus, corpus.gestures)
    proba = system.predict_proba(corpus)
    for seconds, judge, short in ((1.0, Guarded(), False), (0.5, Discriminants(), True)):
        cuts = [Windows(seconds)(Repair(("stuck", "dead"))(corpus[[i]])) for i in range(len(corpus))]
        rows = np.repeat(np.arange(len(corpus)), [len(cut) for cut in cuts])
        table = pd.concat([TouchFeatures().extract(cut) for cut in cuts]).set_axis(labels(rows, 0 * rows))
        each = judge.fit(table, corpus.gestures[rows]).predict_proba(table)
        for i in np.flatnonzero((corpus.lengths < 30) == short):
            np.testing.assert_allclose(proba[i], each[rows == i].mean(axis=0), atol=1e-5)
    table, proba = system.decide(corpus)
    assert (np.diff(table["capture"]) >= 0).all() and len(table) == len(proba)
    assert set(table["frames"]) == {12, 15, 30}
