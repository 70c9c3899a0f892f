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

from bench.corpora.corpus import Corpus, corpus_origin
from bench.features.base import is_stateless
from bench.features.cache import cache_key

MAX_BYTES = 1 << 28  # bytes of statistics that a process keeps
# Statistics of persons and the seconds that they took, by what else they depend on: the last system and corpus alone.
CACHE: dict[tuple, dict[bytes, tuple[Any, np.ndarray]]] = {}


class Additive(Protocol):
    """A classifier that can be fitted to statistics of its training rows."""

    def summarise_rows(self, X: pd.DataFrame, y: np.ndarray) -> Any:
        """Statistics of the rows of one person."""

    def fit_summaries(self, parts: Sequence[Any]) -> Additive:
        """Learn from the statistics of all persons."""


class PerPersonPipeline(Pipeline):
    """A feature set that learns nothing, and an `Additive` classifier.

    A corpus in memory, and persons whose statistics together need more than `MAX_BYTES` bytes, are fitted as usual.

    Attributes:
        fit_seconds_: (wall, processor) seconds of the last fit, those of kept statistics included.
    """

    def fit(self, X: Corpus, y: np.ndarray) -> PerPersonPipeline:
        """Learn from captures and their class names."""
        (_, features), (_, classifier) = self.steps
        wall, cpu = time.perf_counter(), time.process_time()
        persons = (
            rows_by_person(X)
            if is_stateless(features) and corpus_origin(X).path is not None and not corpus_origin(X).steps
            else []
        )
        width = len(features.fit(X).get_feature_names_out()) if persons else 0
        if not persons or 8 * len(persons) * width**2 > MAX_BYTES:
            super().fit(X, y)
            self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
            return self
        about = (
            cache_key(features, corpus_origin(X).digest),
            type(classifier),
            repr(sorted(classifier.get_params().items())),
        )
        by_key = {person_key(X, rows, y[rows]): rows for rows in persons}
        kept = CACHE.get(about, {})
        if 8 * len(by_key.keys() | kept.keys()) * width**2 > MAX_BYTES:
            kept = {}
        CACHE.clear()
        CACHE[about] = kept
        seconds = sum((kept[key][1] for key in by_key if key in kept), np.zeros(2))
        self._cache_summaries(
            {key: rows for key, rows in by_key.items() if key not in kept}, X, y, kept
        )
        classifier.fit_summaries([kept[key][0] for key in by_key])
        self.fit_seconds_ = (
            time.perf_counter() - wall + seconds[0],
            time.process_time() - cpu + seconds[1],
        )
        return self

    def _cache_summaries(
        self, persons: dict[bytes, np.ndarray], X: Corpus, y: np.ndarray, kept: dict
    ) -> None:
        """Add the statistics of some persons, by their captures, to those that are kept."""
        if not persons:
            return
        (_, features), (_, classifier) = self.steps
        wall, cpu = time.perf_counter(), time.process_time()
        table = features.transform(X[np.concatenate([*persons.values()])])
        ends = np.cumsum([len(rows) for rows in persons.values()])
        sums = [
            classifier.summarise_rows(table[end - len(rows) : end], y[rows])
            for rows, end in zip(persons.values(), ends, strict=True)
        ]
        each = np.array([time.perf_counter() - wall, time.process_time() - cpu]) / len(sums)
        kept.update({key: (one, each) for key, one in zip(persons, sums, strict=True)})


def rows_by_person(X: Corpus) -> list[np.ndarray]:
    """Positions of the captures of each person."""
    codes, names = pd.factorize(X.subjects)
    order = np.argsort(codes, kind="stable")
    return np.split(order, np.cumsum(np.bincount(codes, minlength=len(names)))[:-1])


def person_key(X: Corpus, rows: np.ndarray, y: np.ndarray) -> bytes:
    """Which captures, and their class names."""
    return blake2b(repr([*map(str, y)]).encode() + corpus_origin(X).index[rows].tobytes()).digest()
