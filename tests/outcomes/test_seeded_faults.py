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
from bench.models.classic.bayes import bayes
from bench.models.classic.rf import rf
from bench.models.classic.svm import svm
from bench.outcomes.gate import Measured, compare
from bench.protocols.subjects import LOSO
from bench.work.fold import decisions
from tests.outcomes.test_gate import HERE, LIMITS, NAMES


@cache
def corpus():
    return generate(subjects=8, repetitions=2, variants=("normal",))


def swapped(captures):
    """The same captures with two rows of the grid swapped."""
    frames = captures.frames.copy()
    frames[:, [2, 3]] = frames[:, [3, 2]]
    return captures.changed(frames=frames)


@cache
def table(rows_swapped=False):
    return Jung54().transform(swapped(corpus()) if rows_swapped else corpus())


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


def copy_of(make, fault="", share=0.05):
    """Fits a copy of a system that has a scaler, or none, with a fault or without."""

    def fit(fold, train, labels, test):
        if fault == "shuffled":
            labels = shuffled(labels, fold, share)
        fitted = make(features=Stored()).fit(train, labels)
        if fault == "leak":
            both = corpus()[np.sort(np.concatenate([train.index, test.index]))]
            scaler = fitted["scaler"].fit(fitted["features"].transform(both))
            fitted["classifier"].fit(scaler.transform(fitted["features"].transform(train)), labels)
        if fault == "rows":
            fitted["features"].set_params(rows_swapped=True)
        return fitted

    return fit


def shuffled(labels, seed, share):
    """The labels of some of the captures, dealt to them anew."""
    rng = np.random.default_rng(seed)
    labels, chosen = labels.copy(), rng.choice(len(labels), round(share * len(labels)), replace=False)
    labels[chosen] = labels[rng.permutation(chosen)]
    return labels


def run_of(fit, captures, seed="none", system="svm"):
    """Leave-one-subject-out with a copy of a system, as a baseline holds it.

    Args:
        fit: called with the number of the fold, the training captures, their labels and the test captures; gives the
            fitted classifier.
        captures: the corpus.
        seed: as tracked.
        system: as tracked.
    """
    tables = []
    for i, (train, test) in enumerate(LOSO().split(captures)):
        tables.append(
            decisions(fit(i, captures[train], captures.gestures[train], captures[test]), captures, str(i), test)
        )
    labels = scores.captures(pd.concat(tables, ignore_index=True))[["fold", "capture", "subject", "true", "predicted"]]
    return Measured("", NAMES | {"seed": seed, "system": system}, HERE, {}, labels, True)


def forest(seed, trees=20):
    return run_of(copy_of(partial(rf, trees=trees, seed=seed)), corpus(), str(seed), "rf")


@cache
def sound():
    """What a gate of three systems would hold."""
    return {
        "svm": run_of(copy_of(svm), corpus(), system="svm"),
        "bayes": run_of(copy_of(bayes), corpus(), system="bayes"),
        "rf": forest(0),
    }


def alarms(faulty):
    """What a gate says of a copy in place of one of its systems, the others unchanged."""
    (name,) = {k for k, run in sound().items() if run.names["system"] == faulty.names["system"]}
    current = [faulty if k == name else run for k, run in sound().items()]
    found = dict(zip(sound(), compare(list(sound().values()), current, **LIMITS), strict=True))
    assert not any(v.wrong for k, v in found.items() if k != name)
    return found[name].wrong


def test_copies_without_a_fault_raise_no_alarm():
    for name, make in (("svm", svm), ("bayes", bayes)):
        assert alarms(run_of(copy_of(make), corpus(), system=name)) == ()


@pytest.mark.parametrize("fault", ["rows", "leak", "shuffled"])
def test_a_faulty_copy_is_caught(fault):
    for name, make in (("svm", svm), ("bayes", bayes)):
        assert alarms(run_of(copy_of(make, fault), corpus(), system=name))
    if fault != "leak":  # a forest scales nothing
        assert alarms(run_of(copy_of(partial(rf, trees=20, seed=0), fault), corpus(), "0", "rf"))


def test_other_seeds_of_a_forest_raise_no_alarm():
    for seed in range(1, 5):
        assert alarms(forest(seed)) == ()
