"""Fits from statistics of each training person, which a process keeps from fold to fold.

Leaving one person out after the other trains on the same captures again and again. What a classifier needs of the
captures of one person depends on these alone, and is added over the persons of a training part. Nothing is subtracted,
so a fold sees no statistic of a person whom it tests.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from hashlib import blake2b
from typing import Any, Protocol

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from bench.corpora.corpus import Corpus, origin
from bench.features.base import FeatureSet
from bench.features.cache import cache_key

MOST = 1 << 28  # bytes of statistics that a process keeps
# Statistics of persons and the seconds that they took, by what else they depend on: the last system and corpus alone.
KEPT: dict[tuple, dict[bytes, tuple[Any, tuple[float, float]]]] = {}


class Additive(Protocol):
    """A classifier that can be fitted to statistics of its training rows."""

    def summed(self, X: pd.DataFrame, y: np.ndarray) -> Any:
        """Statistics of the rows of one person."""

    def fit_summed(self, parts: Sequence[Any]) -> Additive:
        """Learn from the statistics of all persons."""


class ByPerson(Pipeline):
    """A feature set that learns nothing, and an `Additive` classifier.

    A corpus in memory, and persons whose statistics together need more than `MOST` bytes, are fitted as usual.

    Attributes:
        fit_seconds_: (wall, processor) seconds of the last fit, those of kept statistics included.
    """

    def fit(self, X: Corpus, y: np.ndarray) -> ByPerson:
        """Learn from captures and their class names."""
        (_, features), (_, classifier) = self.steps
        wall, cpu = time.perf_counter(), time.process_time()
        persons = _persons(X) if _stateless(features) and origin(X).path is not None and not origin(X).steps else []
        width = len(features.fit(X).get_feature_names_out()) if persons else 0
        if not persons or 8 * len(persons) * width**2 > MOST:
            super().fit(X, y)
            self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
            return self
        parts, seconds = [], np.zeros(2)
        about = cache_key(features, origin(X).digest), type(classifier), repr(sorted(classifier.get_params().items()))
        if about not in KEPT or 8 * (len(KEPT[about]) + len(persons)) * width**2 > MOST:
            KEPT.clear()
        kept = KEPT.setdefault(about, {})
        for rows in persons:
            key = _key(X, rows, y[rows])
            if key in kept:
                seconds += kept[key][1]
            else:
                began = time.perf_counter(), time.process_time()
                statistics = classifier.summed(features.transform(X[rows]), y[rows])
                kept[key] = statistics, (time.perf_counter() - began[0], time.process_time() - began[1])
            parts.append(kept[key][0])
        classifier.fit_summed(parts)
        self.fit_seconds_ = time.perf_counter() - wall + seconds[0], time.process_time() - cpu + seconds[1]
        return self


def _persons(X: Corpus) -> list[np.ndarray]:
    """Positions of the captures of each person."""
    codes, names = pd.factorize(X.subjects)
    order = np.argsort(codes, kind="stable")
    return np.split(order, np.cumsum(np.bincount(codes, minlength=len(names)))[:-1])


def _stateless(features: object) -> bool:
    kind = type(features)
    return isinstance(features, FeatureSet) and (kind.fit, kind.transform) == (FeatureSet.fit, FeatureSet.transform)


def _key(X: Corpus, rows: np.ndarray, y: np.ndarray) -> bytes:
    """Which captures, and their class names."""
    return blake2b(repr([*map(str, y)]).encode() + origin(X).index[rows].tobytes()).digest()
