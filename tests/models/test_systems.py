"""The contract of every system of the registry, of adapters and of compositions.

A system of the registry is fitted once: its stored numbers (`tests.net.numbers`) and the checks of
`bench audit` share this fit.
"""

from functools import cached_property, partial
from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from torch import nn

from bench import contract
from bench.corpora.corpus import Corpus
from bench.models import PARTS
from bench.models.adapters import FromSeries, FromTorch
from bench.models.classic.perceptron import Perceptron
from bench.models.sizes import measure_sizes
from bench.running import audit
from tests.conftest import random_corpus
from tests.net.numbers import fit_system, make_system, split_touches, touches

SLOW = "jung2017_svm_rbf jung2017_nn ta2015_svm ta2015_rf gaus2015_rf reflex ren2023_transformer"

HARSH = {"repair": ("stuck", "dead", "offset"), "scale": "peak", "faults": ("all",), "copies": 1}
CHECKS = [
    audit.check_blindness,
    audit.check_labels,
    audit.check_single_captures,
    audit.check_cloning,
    audit.check_test_captures,  # with a second fit, which must be equal
    audit.check_saving,
]


def flatten_series(series):
    return series.reshape(len(series), -1)


def make_linear(frames, rows, cols, classes):
    return nn.Sequential(nn.Flatten(), nn.Linear(frames * rows * cols, classes))


def series_classifier():
    neighbours = make_pipeline(FunctionTransformer(flatten_series), KNeighborsClassifier(3))
    return FromSeries(neighbours, "both", 12)


COMPOSED = {
    "series": series_classifier,
    "module": lambda: FromTorch(module=make_linear, frames=5, epochs=2),
    "lda on windows": lambda: make_system("lda", window=0.1, **HARSH),
    "svm, turned": lambda: make_system("svm", turns=1),
    "cnn85 on damaged copies": lambda: make_system("cnn85", **HARSH),
    "reflex, scaled": lambda: make_system("reflex", scale="log"),
}


class Case(audit.AuditedSystem):
    """A system on the captures of its stored numbers."""

    def __init__(self, name):
        self.name = name
        make = COMPOSED.get(name, partial(make_system, name))
        self.cell = SimpleNamespace(estimator=make, seed=None, objects=())
        self.corpus, self.train, self.test = split_touches()
        self.probe = touches(seed=1)

    @cached_property
    def first(self):
        if self.name in COMPOSED:
            return self.fit_new(self.corpus[self.train])
        return fit_system(self.name)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.nightly] * (name in SLOW.split()))
        for name in (*PARTS, *COMPOSED)
    ],
)
def test_a_system_keeps_the_contract(name, monkeypatch):
    if name in COMPOSED:
        quick = partial(Perceptron, updates=50)
        monkeypatch.setattr("bench.models.out_of_distribution.Perceptron", quick)
    case = Case(name)
    contract.check_parameters(case.cell.estimator())
    for check in CHECKS:
        check(case)

    probe = case.probe
    proba = contract.predict_probabilities(case.first, probe)
    table, decisions = contract.predict_decisions(case.first, probe)
    assert set(table["capture"]) == {*range(len(probe))} and len(table) == len(decisions)
    assert (table["start"] + table["frames"] <= probe.lengths[table["capture"]]).all()
    means = [decisions[table["capture"] == i].mean(axis=0) for i in range(len(probe))]
    np.testing.assert_allclose(proba, means, rtol=1e-5, atol=1e-9)
    assert min(measure_sizes(case.first, 64, 40).values()) > 0

    # captures of one frame, of real numbers, on another grid
    tiny = random_corpus(subjects=2, per_class=2, grid=(1, 2), longest=2)
    frames = [capture / np.float32(8) for capture in tiny]
    tiny = Corpus.from_captures(frames, tiny.captures, 8.0, full_scale=128.0)
    proba = contract.predict_probabilities(case.fit_new(tiny), tiny[:2])
    assert proba.shape == (2, 3) and np.isfinite(proba).all()
