"""The gate's alarms: seeded faults in copies of systems, on generated captures; none without a fault."""

from functools import cache, partial

import numpy as np
import pandas as pd
import pytest
from sklearn.base import BaseEstimator, TransformerMixin

from bench import scores
from bench.corpora.corpus import origin
from bench.corpora.synth import generate
from bench.features.jung54 import Jung54
from bench.models.classic.rf import rf
from bench.models.classic.svm import svm
from bench.outcomes.gate import Measured, compare
from bench.protocols.subjects import LOSO
from bench.work.fold import decisions
from tests.outcomes.test_gate import HERE, LIMITS, NAMES


@cache
def corpus():
    return generate(subjects=8, repetitions=2, variants=("normal",))


@cache
def table(rows_swapped=False):
    frames = corpus().frames.copy()
    if rows_swapped:
        frames[:, [2, 3]] = frames[:, [3, 2]]
    return Jung54().transform(corpus().changed(frames=frames))


class Stored(TransformerMixin, BaseEstimator):
    """Features of `corpus` that are computed once for all tests."""

    def __init__(self, rows_swapped=False):
        self.rows_swapped = rows_swapped

    def fit(self, X, y=None):
        return self

    def transform(self, X):
        return table(self.rows_swapped).iloc[origin(X).index]

    def __sklearn_is_fitted__(self):
        return True


def fitted_copy(make, fault, fold, train, test):
    """A fitted copy of a system with a fault, or without."""
    labels = train.gestures.copy()
    if fault == "shuffled":  # some labels are dealt anew
        rng = np.random.default_rng(fold)
        chosen = rng.choice(len(labels), round(0.05 * len(labels)), replace=False)
        labels[chosen] = labels[rng.permutation(chosen)]
    fitted = make(features=Stored()).fit(train, labels)
    if fault == "leak":
        both = corpus()[np.sort(np.concatenate([train.index, test.index]))]
        scaler = fitted["scaler"].fit(fitted["features"].transform(both))
        fitted["classifier"].fit(scaler.transform(fitted["features"].transform(train)), labels)
    if fault == "rows":
        fitted["features"].set_params(rows_swapped=True)
    return fitted


def run_of(make, fault="", seed="none", system="svm"):
    """Leave-one-subject-out with a copy of a system, as a baseline holds it."""
    tables = []
    for i, (train, test) in enumerate(LOSO().split(corpus())):
        fitted = fitted_copy(make, fault, i, corpus()[train], corpus()[test])
        tables.append(decisions(fitted, corpus(), str(i), test))
    labels = scores.captures(pd.concat(tables, ignore_index=True))[["fold", "capture", "subject", "true", "predicted"]]
    return Measured("", NAMES | {"seed": seed, "system": system}, HERE, {}, labels, True)


def forest(seed, fault=""):
    return run_of(partial(rf, trees=20, seed=seed), fault, str(seed), "rf")


@cache
def sound():
    """What a gate of two systems would hold."""
    return {"svm": run_of(svm), "rf": forest(0)}


def alarms(faulty):
    """What a gate says of a copy in place of one of its systems, the other unchanged."""
    current = sound() | {faulty.names["system"]: faulty}
    found = dict(zip(sound(), compare([*sound().values()], [*current.values()], **LIMITS), strict=True))
    assert sum(bool(v.wrong) for v in found.values()) == bool(found[faulty.names["system"]].wrong)
    return found[faulty.names["system"]].wrong


@pytest.mark.parametrize("fault", ["rows", "leak", "shuffled"])
def test_a_faulty_copy_is_caught(fault):
    assert alarms(run_of(svm, fault))
    assert fault == "leak" or alarms(forest(0, fault))  # a forest scales nothing


def test_copies_without_a_fault_and_other_seeds_raise_no_alarm():
    assert alarms(run_of(svm)) == alarms(forest(1)) == alarms(forest(2)) == ()
