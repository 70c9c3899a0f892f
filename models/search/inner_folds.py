"""Inner folds of whole training subjects, and what is fitted and judged in each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd
from sklearn.base import TransformerMixin, clone
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError

TIMED = 3  # single captures whose prediction is timed


def inner_folds(subjects: np.ndarray, inner: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """(train, test) positions of inner folds; nobody is on both sides.

    Raises:
        InputError: fewer than two subjects, which leaves nobody to judge by.
    """
    count = len(np.unique(subjects))
    if count < 2:
        raise InputError(f"parameters are chosen by leaving training subjects out, and there is {count}; train on more")
    splitter = (
        LeaveOneGroupOut() if inner == "loso" else GroupKFold(min(int(inner), count), shuffle=True, random_state=0)
    )
    return list(splitter.split(subjects, groups=subjects))


class Tables:
    """What models are fitted to and judged by in each inner fold: tables of features, or captures."""

    def __init__(self, features: dict[str, TransformerMixin], X: Corpus, y: np.ndarray, folds: list) -> None:
        self.features = {name: clone(part) for name, part in features.items()}
        self.X = X
        self.y = y
        self.folds = folds
        self.whole: dict[str, pd.DataFrame] = {}
        self.learnt: dict[tuple[str, int], tuple[pd.DataFrame, pd.DataFrame]] = {}
        self.spent: dict[str, float] = {}

    def train(self, name: str | None, fold: int) -> Corpus | pd.DataFrame:
        """What a model is fitted to in an inner fold."""
        return self._part(name, fold, 0)

    def test(self, name: str | None, fold: int) -> Corpus | pd.DataFrame:
        """What it is judged by."""
        return self._part(name, fold, 1)

    def _part(self, name: str | None, fold: int, side: int) -> Corpus | pd.DataFrame:
        part = self.folds[fold][side]
        if not name:
            return self.X[part]
        features = self.features[name]
        if not contract.learns(features):
            if name not in self.whole:
                self.whole[name] = features.fit(self.X, self.y).transform(self.X)
            return self.whole[name].iloc[part]
        if (name, fold) not in self.learnt:
            train, test = self.folds[fold]
            fitted = features.fit(self.X[train], self.y[train])
            self.learnt[name, fold] = fitted.transform(self.X[train]), fitted.transform(self.X[test])
        return self.learnt[name, fold][side]

    def alone(self, name: str | None, fold: int) -> list[Corpus | pd.DataFrame]:
        """A few of what is judged, one by one."""
        judged = self.test(name, fold)
        rows = judged.iloc if isinstance(judged, pd.DataFrame) else judged
        return [rows[[i % len(judged)]] for i in range(TIMED)]

    def milliseconds(self, name: str | None) -> float:
        """Time to compute the features of one capture."""
        if not name:
            return 0.0
        if name not in self.spent:
            self._part(name, 0, 0)  # fits it
            some = np.linspace(0, len(self.X) - 1, TIMED).astype(int)
            alone = [self.X[i : i + 1].detached() for i in some]
            self.spent[name] = milliseconds_of(self.features[name].transform, alone)
        return self.spent[name]


def milliseconds_of(call: Callable, each: Iterable[object]) -> float:
    """Median time of a call, once with each of some arguments."""
    times = []
    for one in each:
        started = time.perf_counter()
        call(one)
        times.append((time.perf_counter() - started) * 1000)
    return float(np.median(times))
