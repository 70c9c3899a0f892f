"""A system for each person, tested on other captures of this person, as Cang et al. 2015 printed it."""

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.protocols.captures import CaptureKFold
from bench.protocols.subjects import Folds, natural_order


class Within:
    """K stratified folds of the captures of each subject; a system is trained on captures of this subject alone.

    Args:
        folds: number of folds for each subject.
        seed: random seed of the shuffle.
    """

    def __init__(self, folds: int = 5, seed: int = 0) -> None:
        self.folds = folds
        self.seed = seed

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.folds}-fold within each subject, subjects mixed: a system per subject"

    def get_n_splits(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> int:
        """Number of subjects times folds."""
        return self.folds * len(set(X.subjects if groups is None else groups))

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices, subjects in natural order.

        Raises:
            InputError: a subject has fewer captures of a class than there are folds, or fewer than two folds.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        y = X.gestures if y is None else np.asarray(y)
        for name in natural_order(groups):
            own = np.flatnonzero(groups == name)
            try:
                for train, test in CaptureKFold(self.folds, self.seed).split(X[own], y[own]):
                    yield own[train], own[test]
            except InputError as e:
                raise InputError(f"protocol=within, subject {name}: {e}") from e
