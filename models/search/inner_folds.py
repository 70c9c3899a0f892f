"""Inner folds of whole training subjects, and the inputs of fitting and judging in each."""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.base import TransformerMixin, clone
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut

from bench import contract
from bench.corpora.corpus import Corpus, untrained_classes
from bench.errors import InputError


def split_subjects(subjects: np.ndarray, inner: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """(train, test) positions of inner folds; no subject is on both sides."""
    count = len(np.unique(subjects))
    if count < 2:
        raise InputError(
            f"parameters are chosen by leaving training subjects out, and there is {count}; train on more"
        )
    splitter = (
        LeaveOneGroupOut()
        if inner == "loso"
        else GroupKFold(min(int(inner), count), shuffle=True, random_state=0)
    )
    return list(splitter.split(subjects, groups=subjects))


def make_inner_folds(X: Corpus, y: np.ndarray, inner: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """The inner folds of captures and their class names."""
    folds = split_subjects(X.subjects.astype(str), inner)
    labels = np.asarray(y).astype(str)
    for train, judged in folds:
        if len(np.unique(labels[train])) < 2:
            what = "one class"
        elif lacking := untrained_classes(labels, train, judged):
            what = f"nobody who shows {lacking[0]}"
        else:
            continue
        raise InputError(
            f"a search leaves training subjects out, which here leaves {what}; choose another inner= than {inner}, or "
            "more captures"
        )
    return folds


def check_search(inner: str, trials: int | None, seconds: float, endless: bool) -> None:
    """Refuse impossible searches; ``endless`` is True if nothing ends one without trials or seconds."""
    if inner != "loso" and not (inner.isdecimal() and int(inner) >= 2):
        raise InputError(f"model.inner={inner}: give a number of subject groups from 2 on, or loso")
    if trials is not None and trials < 1:
        raise InputError(f"model.trials={trials}: give at least 1")
    if not seconds > 0:
        raise InputError(f"seconds={seconds:g}: give a number of seconds above 0")
    if endless and trials is None and seconds == float("inf"):
        raise InputError("this search has no end: give a number of trials, or a budget in seconds")


class FoldInputs:
    """Inputs of fitting and judging in each inner fold: tables of features, or captures."""

    def __init__(
        self, features: dict[str, TransformerMixin], X: Corpus, y: np.ndarray, folds: list
    ) -> None:
        self.features = {name: clone(part) for name, part in features.items()}
        self.X, self.y, self.folds = X, np.asarray(y), folds
        self._kept: dict[tuple[str, int], tuple[pd.DataFrame, ...]] = {}

    def load_input(self, name: str | None, fold: int, side: int) -> Corpus | pd.DataFrame:
        """Input of fitting (side 0) or judging (side 1) in an inner fold; captures without a feature set."""
        part = self.folds[fold][side]
        if not name:
            return self.X[part]
        features, learns = self.features[name], contract.learns(self.features[name])
        key = name, fold if learns else 0
        if key not in self._kept and learns:
            train, test = self.folds[fold]
            fitted = features.fit(self.X[train], self.y[train])
            self._kept[key] = fitted.transform(self.X[train]), fitted.transform(self.X[test])
        elif key not in self._kept:
            self._kept[key] = (features.fit(self.X, self.y).transform(self.X),)
        return self._kept[key][side] if learns else self._kept[key][0].iloc[part]
