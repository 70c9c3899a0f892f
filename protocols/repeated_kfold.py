"""K-fold cross-validation of captures several times, each time with other folds."""

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.protocols.captures import CaptureKFold
from bench.protocols.subjects import Folds


class RepeatedKFold:
    """K stratified folds of captures, drawn several times; subjects are mixed, and each capture is tested each time.

    Args:
        folds: number of folds.
        repeats: number of draws.
        seed: random seed of the shuffles.
    """

    def __init__(self, folds: int = 10, repeats: int = 5, seed: int = 0) -> None:
        self.folds = folds
        self.repeats = repeats
        self.seed = seed

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.repeats} times {self.folds}-fold, subjects mixed"

    def get_n_splits(self, X: object = None, y: object = None, groups: object = None) -> int:
        """Number of folds times repeats."""
        return self.folds * self.repeats

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: a class has fewer captures than there are folds, fewer than two folds, or no repeat.
        """
        if self.repeats < 1:
            raise InputError(f"protocol.repeats={self.repeats}: give 1 or more")
        shuffles = np.random.RandomState(self.seed)  # one stream for all repeats, as scikit-learn's
        for _ in range(self.repeats):
            yield from CaptureKFold(self.folds, shuffles).split(X, y)  # type: ignore[arg-type]
