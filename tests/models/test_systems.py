"""What every system of the registry must do, and adapters and compositions with them: one suite for all."""

import pickle
from functools import partial

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.ensemble import RandomForestClassifier
from sklearn.neighbors import KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from torch import nn

from bench import contract
from bench.corpora.corpus import Corpus
from bench.features.jung28 import Jung28
from bench.ground.registry import load_part, required_parameters
from bench.models import PARTS, recipe
from bench.models.adapters import FromSeries, FromTorch
from bench.models.classic.perceptron import Perceptron
from bench.models.sizes import measure_sizes
from tests.conftest import random_corpus, with_other_values
from tests.net.numbers import QUICK

SEARCHES = {
    "auto",
    "jung2014_svm",
    "jung2017_tree",
    "jung2017_svm_linear",
    "jung2017_svm_rbf",
    "ta2015_svm",
}
SLOW = SEARCHES | {
    "hughes2015_softmax",
    "gaus2015_rf",
    "gaus2015_boost",
    "ta2015_rf",
    "jung2017_nn",
}
SLOW |= {"ren2023_transformer"}  # the parts of most are here with less to learn
HARSH = {"repair": ("stuck", "dead", "offset"), "scale": "peak", "faults": ("all",), "copies": 1}


def flattened(series):
    return series.reshape(len(series), -1)


def linear(frames, rows, cols, classes):
    return nn.Sequential(nn.Flatten(), nn.Linear(frames * rows * cols, classes))


COMPOSED = {
    "series": lambda: FromSeries(
        make_pipeline(FunctionTransformer(flattened), KNeighborsClassifier(3)), "both", 12
    ),
    "module": lambda: FromTorch(module=linear, frames=5, epochs=2),
    "lda on windows": lambda: made("lda", window=0.1, **HARSH),
    "svm, turned": lambda: made("svm", turns=1),
    "cnn85 on damaged copies": lambda: made("cnn85", **HARSH),
    "reflex, scaled": lambda: made("reflex", scale="log"),
}
DAILY = [name for name in (*PARTS, *COMPOSED) if name not in SLOW]


def made(name, **options):
    """A system with little to learn."""
    factory = load_part("models", name)
    defaults = recipe.parameter_defaults(factory)
    usual = (
        {k: v for k, v in {"epochs": 1}.items() if k in defaults} | QUICK.get(name, {}) | options
    )
    return recipe.build_recipe(factory, Jung28() if required_parameters(factory) else None, **usual)


@pytest.fixture(autouse=True)
def little_to_learn(monkeypatch):
    """Networks learn for a shorter time and forests have fewer trees than for a user."""
    models = {
        "out_of_distribution.Perceptron": partial(Perceptron, updates=50),
        "classic.mlp.MLPClassifier": lambda *args, **kwargs: MLPClassifier(
            *args, **kwargs | {"max_iter": 20}
        ),
        "classic.rf.RandomForestClassifier": lambda trees, **kwargs: RandomForestClassifier(
            10, **kwargs
        ),
    }
    for name, quick in models.items():
        monkeypatch.setattr(f"bench.models.{name}", quick)


@pytest.mark.parametrize(
    "name", [*DAILY, *(pytest.param(n, marks=pytest.mark.nightly) for n in SLOW - {"auto"})]
)
def test_contract(name):
    """Untrained copies, probabilities, the same again, alone, stored, on another skin, and nothing of whom it tests."""
    make = COMPOSED.get(name, lambda: made(name))
    corpus = random_corpus(subjects=3, per_class=2, longest=40)
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    bare = make()
    contract.check_parameters(bare)
    contract.check_training(bare, corpus[train], corpus.gestures[train])
    model = clone(bare).fit(corpus[train], corpus.gestures[train])
    assert not hasattr(bare, "classes_") and list(model.classes_) == ["pat", "rub", "tap"]
    assert clone(model).get_params().keys() == bare.get_params().keys() and not hasattr(
        clone(model), "classes_"
    )

    probe = random_corpus(seed=9, subjects=2, per_class=2, longest=60)
    proba = contract.predict_probabilities(model, probe)
    assert proba.shape == (12, 3)
    np.testing.assert_allclose(proba.sum(axis=1), 1, rtol=1e-5)
    assert np.array_equal(model.predict(probe), model.classes_[proba.argmax(axis=1)])
    table, decisions = contract.predict_decisions(model, probe)
    assert set(table["capture"]) == {*range(12)} and len(table) == len(decisions)
    assert (
        table["start"] + table["frames"] <= probe.lengths[table["capture"]]
    ).all() or "pad" in str(bare)
    of_captures = [decisions[table["capture"] == i].mean(axis=0) for i in range(12)]
    np.testing.assert_allclose(proba, of_captures, rtol=1e-5, atol=1e-9)

    for alone in ([0], [7, 3]):
        np.testing.assert_allclose(
            contract.predict_probabilities(model, probe[alone].detach()), proba[alone], atol=1e-5
        )
    assert np.array_equal(
        contract.predict_probabilities(pickle.loads(pickle.dumps(model)), probe), proba
    )

    other = with_other_values(corpus, test)  # other values and labels of whom it is tested on
    other.captures.loc[test, "gesture"] = "tap"
    again = clone(bare).fit(other[train], other.gestures[train])
    assert np.array_equal(contract.predict_probabilities(again, probe), proba)

    costs = measure_sizes(model, 64, 40)
    assert costs["flash_bytes"] > 0 and costs["ram_bytes"] > 0 and costs["parameters"] > 0

    tiny = random_corpus(subjects=2, per_class=2, grid=(1, 2), longest=2)  # captures of one frame
    real = Corpus.from_captures(
        [f / np.float32(8) for f in tiny], tiny.captures, 8.0, full_scale=128.0
    )
    found = contract.predict_probabilities(make().fit(real, real.gestures), real[:2])
    assert found.shape == (2, 3) and np.isfinite(found).all()
