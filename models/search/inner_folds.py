"""Inner folds of whole training subjects, and the inputs of fitting and judging in each."""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.base import TransformerMixin, clone
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut

from bench import contract
from bench.corpora.corpus import Corpus, untrained_classes
from bench.errors import InputError, check_value


def split_subjects(subjects: np.ndarray, inner: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """(train, test) positions of inner folds; no subject is on both sides.

    Raises:
        InputError: there is only one subject.
    """
    count = len(np.unique(subjects))
    if count < 2:
        message = "parameters are chosen by leaving training subjects out, and there is only one"
        raise InputError(f"{message}; train on more")
    splitter = LeaveOneGroupOut()
    if inner != "loso":
        splitter = GroupKFold(min(int(inner), count), shuffle=True, random_state=0)
    return list(splitter.split(subjects, groups=subjects))


def split_tested_subjects(X: Corpus, inner: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Inner folds of captures; those of `also=` are in each training side and judge nothing."""
    if not X.is_added.any():
        return split_subjects(X.subjects.astype(str), inner)
    own, added = np.flatnonzero(~X.is_added), np.flatnonzero(X.is_added)
    folds = split_subjects(X.subjects[own].astype(str), inner)
    return [(np.concatenate([own[train], added]), own[judged]) for train, judged in folds]


def tested_subjects(X: Corpus) -> np.ndarray:
    """Subject of each capture as text, "" for captures of `also=`, which judge nothing."""
    return np.where(X.is_added, "", X.subjects.astype(str))


def make_inner_folds(X: Corpus, y: np.ndarray, inner: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Inner folds of captures and their class names.

    Raises:
        InputError: a training side has a single class, or lacks a class of the other side.
    """
    folds = split_tested_subjects(X, inner)
    labels = np.asarray(y).astype(str)
    for train, judged in folds:
        missing = untrained_classes(labels, train, judged)
        is_single = len(np.unique(labels[train])) < 2
        if missing or is_single:
            rest = "one class" if is_single else f"nobody who shows {missing[0]}"
            raise InputError(
                f"a search leaves training subjects out, which here leaves {rest}; choose another "
                f"inner= than {inner}, or more captures"
            )
    return folds


def check_search(inner: str, trials: int | None, seconds: float, is_endless: bool) -> None:
    """Check the budget of a search; ``is_endless`` is True if only trials or seconds end it."""
    is_valid = inner == "loso" or (inner.isdecimal() and int(inner) >= 2)
    check_value("model.inner", inner, is_valid, "a number of subject groups from 2 on, or loso")
    check_value("model.trials", trials, trials is None or trials >= 1, "at least 1")
    check_value("seconds", seconds, seconds > 0, "a number of seconds above 0")
    if is_endless and trials is None and seconds == float("inf"):
        raise InputError("this search has no end: give a number of trials, or a budget in seconds")


class FoldInputs:
    """Inputs of fitting and judging in each inner fold: tables of features, or captures."""

    def __init__(
        self, features: dict[str, TransformerMixin], X: Corpus, y: np.ndarray, folds: list
    ) -> None:
        self.features = {name: clone(part) for name, part in features.items()}
        self.X, self.y, self.folds = X, np.asarray(y), folds
        self._tables: dict[tuple[str, int, int], pd.DataFrame] = {}

    def load_input(self, name: str | None, fold: int, side: int) -> Corpus | pd.DataFrame:
        """Input of fitting (side 0) or judging (side 1): features by name, or captures."""
        rows = self.folds[fold][side]
        if not name:
            return self.X[rows]
        features = self.features[name]
        if not contract.learns(features):
            if (name, 0, 0) not in self._tables:
                self._tables[name, 0, 0] = features.fit(self.X, self.y).transform(self.X)
            return self._tables[name, 0, 0].iloc[rows]
        if (name, fold, side) not in self._tables:
            train, judged = self.folds[fold]
            fitted = features.fit(self.X[train], self.y[train])
            for part, captures in enumerate((train, judged)):  # each without the other's captures
                self._tables[name, fold, part] = fitted.transform(self.X[captures])
        return self._tables[name, fold, side]
