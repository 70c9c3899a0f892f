"""Fits from summaries of each training person, which a process keeps from fold to fold.

Leaving one person out after another trains on the same captures again and again. A summary depends
on the captures of one person alone, and a fit merges the summaries of its training persons, half by
half: another person who is left out changes few halves, and the others are kept. Nothing is
subtracted, so a fold uses no summary of a person whom it tests.
"""

from __future__ import annotations

import time
from hashlib import blake2b

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from bench.corpora.corpus import Corpus, unblind
from bench.features.base import is_stateless
from bench.features.cache import cache_key
from bench.models.classic.row_summaries import RowSummary, SummaryTree
from bench.models.search.inner_folds import make_inner_folds, tested_subjects

MAX_BYTES = 1 << 29  # of the summaries that a process keeps
BYTES_PER_PERSON = 16  # for each pair of features: a matrix of the person, and one of a half
# Summaries of persons and the (wall, CPU) seconds they took, by system and corpus; only the last
# pair is kept.
CACHE: dict[tuple, tuple[SummaryTree, dict[int, np.ndarray]]] = {}


class PerPersonPipeline(Pipeline):
    """A feature set that learns nothing, and a classifier with ``fit_summary``.

    It is fitted as usual to a corpus in memory, to a table, where the classifier tunes itself, and
    where the summaries would need more than `MAX_BYTES`.

    Attributes:
        fit_seconds_: (wall, CPU) seconds of the last fit, those of kept summaries included.
    """

    def fit(self, X: Corpus, y: np.ndarray) -> PerPersonPipeline:
        """Fit to captures and their class names."""
        (_, features), (name, classifier) = self.steps
        started = _read_clocks()
        adds_persons = is_stateless(features) and not classifier.tune and _is_stored(X)
        persons = _rows_by_person(X) if adds_persons else []
        width = len(features.fit(X).get_feature_names_out()) if persons else 0
        bytes_each = BYTES_PER_PERSON * width**2
        if not persons or len(persons) * bytes_each > MAX_BYTES:
            subjects = {f"{name}__subjects": tested_subjects(X)} if classifier.tune else {}
            super().fit(X, y, **subjects)
            self.fit_seconds_ = tuple(_read_clocks() - started)
            return self
        settings = repr(sorted(classifier.get_params().items()))
        system_key = cache_key(features, unblind(X).digest), type(classifier), settings
        person_rows = {_person_key(X, rows, y[rows]): rows for rows in persons}
        tree, seconds = CACHE.get(system_key, (SummaryTree(), {}))
        if len(person_rows.keys() | seconds.keys()) * bytes_each > MAX_BYTES:
            tree, seconds = SummaryTree(), {}
        CACHE.clear()
        CACHE[system_key] = tree, seconds
        saved_seconds = sum((seconds[key] for key in person_rows if key in seconds), np.zeros(2))
        looked_up = _read_clocks()
        missing = {key: rows for key, rows in person_rows.items() if key not in seconds}
        if missing:
            tree.persons |= self._summarise_persons(missing, X, y)
        classifier.fit_summary(tree.merge(tuple(sorted(person_rows))))
        seconds |= dict.fromkeys(missing, (_read_clocks() - looked_up) / max(1, len(missing)))
        self.fit_seconds_ = tuple(_read_clocks() - started + saved_seconds)
        return self

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check that a classifier that tunes itself can leave out each person.

        Raises:
            InputError: it cannot.
        """
        if self.searches:
            make_inner_folds(X, y, "loso")

    @property
    def searches(self) -> bool:
        """True if the classifier tunes itself."""
        return self.steps[-1][1].tune

    def _summarise_persons(
        self, person_rows: dict[int, np.ndarray], X: Corpus, y: np.ndarray
    ) -> dict[int, RowSummary]:
        """Summary of each person, by the person's key."""
        (_, features), (_, classifier) = self.steps
        table = features.transform(X[np.concatenate([*person_rows.values()])])
        summaries, first = {}, 0
        for key, rows in person_rows.items():
            person_table = table[first : first + len(rows)]
            summaries[key] = classifier.summarise_rows(person_table, y[rows])
            first += len(rows)
        return summaries


def _read_clocks() -> np.ndarray:
    """Wall and CPU seconds."""
    return np.array([time.perf_counter(), time.process_time()])


def _is_stored(X: Corpus) -> bool:
    """True for captures of a stored corpus as they are."""
    return unblind(X).path is not None and not unblind(X).steps


def _rows_by_person(X: Corpus) -> list[np.ndarray]:
    """Positions of the captures of each person."""
    codes, names = pd.factorize(X.subjects)
    order = np.argsort(codes, kind="stable")
    return np.split(order, np.cumsum(np.bincount(codes, minlength=len(names)))[:-1])


def _person_key(X: Corpus, rows: np.ndarray, y: np.ndarray) -> int:
    """Hash of the captures of a person and their class names."""
    content = repr([*map(str, y)]).encode() + unblind(X).index[rows].tobytes()
    return int.from_bytes(blake2b(content, digest_size=16).digest(), "little")
