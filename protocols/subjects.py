"""Splits by subject: none is on both sides."""

from collections.abc import Iterator

import numpy as np
from sklearn.model_selection import GroupKFold

from bench.corpora.corpus import Corpus
from bench.errors import InputError

Folds = Iterator[tuple[np.ndarray, np.ndarray]]  # positions of training and of test captures


def sort_naturally(names: np.ndarray) -> list[str]:
    """Distinct names, those that are whole numbers first and by value: 1, 2, 10, rather than 1, 10, 2."""
    return sorted(set(names), key=lambda s: (not s.isdecimal(), int(s) if s.isdecimal() else 0, s))


class LOSO:
    """Leave one subject out: as many folds as subjects, each tested on one of them."""

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"LOSO ({len(set(corpus.subjects))} subjects)"

    def get_n_splits(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> int:
        """Number of subjects."""
        return len(set(X.subjects if groups is None else groups))

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices, subjects in natural order.

        Raises:
            InputError: there is only one subject.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        names = sort_naturally(groups)
        if len(names) < 2:
            raise InputError(
                f"{X.name} has {len(names)} subject here, two are needed to leave one out; widen where= or use "
                "protocol=kfold"
            )
        for name in names:
            test = groups == name
            yield np.flatnonzero(~test), np.flatnonzero(test)


class SubjectKFold:
    """K folds of whole subjects (scikit-learn's `GroupKFold`).

    Args:
        folds: number of folds, at most the number of subjects.
        seed: order in which subjects are dealt to folds.
    """

    def __init__(self, folds: int = 10, seed: int = 0) -> None:
        self.folds = folds
        self.seed = seed

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.folds}-fold by subject"

    def get_n_splits(self, X: object = None, y: object = None, groups: object = None) -> int:
        """Number of folds."""
        return self.folds

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: fewer subjects than folds, or fewer than two folds.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        subjects = len(set(groups))
        if self.folds < 2 or self.folds > subjects:
            what = (
                f"give 2 to {subjects} folds"
                if subjects > 1
                else "two are needed; take protocol=kfold or more captures"
            )
            raise InputError(
                f"protocol.folds={self.folds}: {X.name} has {subjects} subject{'s' * (subjects > 1)} here; {what}"
            )
        splitter = GroupKFold(self.folds, shuffle=True, random_state=self.seed)
        yield from splitter.split(groups, groups=groups)
