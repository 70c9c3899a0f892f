"""Sequential forward floating selection (SFFS) of columns.

The criterion is the number of correctly classified captures of training subjects who are left out.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.model_selection import GroupKFold
from sklearn.utils.validation import check_is_fitted

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.base import FeatureSet, is_constant

LDA_RIDGE = 1e-3  # of standardised columns
FOLDS = 5
COLUMN_COUNTS = (2, 4, 8, 16, 32)  # to try, with all columns, if as few as possible are wanted
MAX_STEPS_FACTOR = 3  # floating steps at most, as a multiple of the selected columns


class Subset(FeatureSet):
    """The columns of a feature set that SFFS keeps for the training captures.

    Args:
        features: the feature set.
        count: number of columns to keep.
    """

    learns = True

    def __init__(self, features: FeatureSet, count: int) -> None:
        self.features = features
        self.count = count

    def fit(self, X: Corpus, y: object = None) -> Subset:
        """Select the columns on the training captures; without ``y``, classes are the gestures."""
        if self.count < 1:
            raise InputError(f"count={self.count}: keep at least 1 column")
        self.features_ = clone(self.features).fit(X, y)
        self.names_ = select_columns(self.features_.transform(X), X, y, self.count)
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Selected features of each capture [captures, count]."""
        check_is_fitted(self, "names_")
        return self.features_.transform(X)[self.names_]

    def keeps(self, frames: int, taxels: int) -> int:
        """Count the memory of the whole feature set, which is computed for any columns."""
        return self.features.keeps(frames, taxels)


def select_columns(table: pd.DataFrame, X: Corpus, y: object, selected: int) -> pd.Index:
    """Names of the columns of a feature table that SFFS keeps; without ``y``, by the gestures."""
    label = np.unique(X.gestures if y is None else np.asarray(y), return_inverse=True)[1]
    return table.columns[select_positions(table.to_numpy(), label, X.subjects, selected)]


def select_positions(
    values: np.ndarray, label: np.ndarray, subject: np.ndarray, selected: int
) -> np.ndarray:
    """Sorted positions of the columns that SFFS keeps of a table [captures, columns]."""
    fold = assign_folds(label, subject)
    if len(np.unique(label)) < 2 or len(np.unique(fold)) < 2:
        return np.arange(values.shape[1])
    usable = np.flatnonzero(~is_constant(values))
    if not len(usable):
        return np.arange(values.shape[1])
    if len(usable) <= selected:
        return usable
    parts = [Discriminant(values[:, usable], label, fold != i) for i in np.unique(fold)]
    return usable[run_sffs(parts, len(usable), selected)]


def assign_folds(label: np.ndarray, subject: np.ndarray) -> np.ndarray:
    """Fold in which each capture is left out, int [captures]."""
    people = len(np.unique(subject))
    if people == 1:
        return pd.Series(label).groupby(label).cumcount().to_numpy() % FOLDS
    fold = np.empty(len(label), dtype=np.int64)
    for i, (_, test) in enumerate(GroupKFold(min(FOLDS, people)).split(label, groups=subject)):
        fold[test] = i
    return fold


class Discriminant:
    """Linear discriminant analysis on any subset of columns, from the moments of all columns.

    Args:
        values: table [captures, columns].
        label: class of each capture.
        train: captures to learn from, bool [captures]; the others are classified.
    """

    def __init__(self, values: np.ndarray, label: np.ndarray, train: np.ndarray) -> None:
        classes, member = np.unique(label[train], return_inverse=True)
        centre, spread = values[train].mean(axis=0), values[train].std(axis=0)
        varies = ~is_constant(values[train])
        standard = (values - centre) * varies / np.where(varies, spread, 1)
        self.test, self.test_label = standard[~train], label[~train]
        self.classes = classes
        count = np.bincount(member)
        belongs = (member == np.arange(len(classes))[:, None]).astype(np.float64)
        self.means = belongs @ standard[train] / count[:, None]
        within = standard[train] - self.means[member]
        self.covariance = within.T @ within / len(member) + LDA_RIDGE * np.eye(len(centre))
        self.log_prior = np.log(count / len(member))

    def count_hits(self, sets: np.ndarray) -> np.ndarray:
        """Number of correctly classified test captures of each set of columns.

        Args:
            sets: int [sets, size].
        """
        batch = max(2**22 // (len(self.test) * len(self.classes) + sets.shape[1] ** 2), 1)
        batches = [sets[i : i + batch] for i in range(0, len(sets), batch)]
        return np.concatenate([self._count_hits(part) for part in batches])

    def _count_hits(self, sets: np.ndarray) -> np.ndarray:
        means = self.means.T[sets]  # [sets, size, classes]
        weights = np.linalg.solve(self.covariance[sets[:, :, None], sets[:, None, :]], means)
        offset = self.log_prior - (means * weights).sum(axis=1) / 2
        columns, position = np.unique(sets, return_inverse=True)
        # Sets share most columns, so one product with zeros for the others is fastest.
        sparse = np.zeros((len(columns), *offset.shape))
        sparse[position.reshape(sets.shape), np.arange(len(sets))[:, None]] = weights
        score = self.test[:, columns] @ sparse.reshape(len(columns), -1)
        score = score.reshape(-1, *offset.shape)
        score += offset
        return np.count_nonzero(
            self.classes[score.argmax(axis=2)] == self.test_label[:, None], axis=0
        )


def run_sffs(parts: list[Discriminant], columns: int, selected: int) -> np.ndarray:
    """Search with SFFS: sorted positions of the best set of ``selected`` columns that was found."""
    chosen: list[int] = []
    best: dict[int, tuple[int, list[int]]] = {}  # by size: correct captures, and the set
    steps = 0
    while len(chosen) < selected:
        rest = np.setdiff1d(np.arange(columns), chosen)
        repeated = np.tile(chosen, (len(rest), 1)).astype(np.int64)
        hits = _count_hits(parts, np.column_stack([repeated, rest]))
        chosen = [*chosen, int(rest[hits.argmax()])]
        steps += 1
        if len(chosen) not in best or hits.max() > best[len(chosen)][0]:
            best[len(chosen)] = int(hits.max()), chosen
        while len(chosen) > 2 and steps < MAX_STEPS_FACTOR * selected:
            ordered = np.sort(chosen)
            smaller = np.array([np.delete(ordered, i) for i in range(len(ordered))])
            hits = _count_hits(parts, smaller)
            if hits.max() <= best[len(chosen) - 1][0]:
                break
            chosen = smaller[hits.argmax()].tolist()
            steps += 1
            best[len(chosen)] = int(hits.max()), chosen
    return np.sort(best[selected][1])


def _count_hits(parts: list[Discriminant], sets: np.ndarray) -> np.ndarray:
    return np.sum([part.count_hits(sets) for part in parts], axis=0)
