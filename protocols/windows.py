"""Windows of captures dealt to folds at random, as papers did that cut captures before they split them."""

from collections.abc import Iterator

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.windows import Windows
from bench.errors import InputError
from bench.protocols.captures import split_stratified

Parts = list[
    tuple[np.ndarray, np.ndarray]
]  # no further training windows, and tested ones, none of them of one capture
Folds = Iterator[tuple[np.ndarray, np.ndarray, Parts]]


class WindowKFold:
    """K stratified folds of windows: other windows of a tested capture, which may overlap, are trained on.

    This is optimistic even for the same person, and every label says so. A capture is labelled by the mean
    probability of all its windows, each predicted in the fold that tests it. To compare with other protocols, give the
    system windows of the same length there (``model.window=``).

    Args:
        seconds: length of a window; a shorter capture is one window.
        hop: seconds from the beginning of one window to that of the next; 0 is half a window.
        folds: number of folds.
        seed: random seed of the shuffle.
    """

    def __init__(
        self, seconds: float = 1.0, hop: float = 0.0, folds: int = 10, seed: int = 0
    ) -> None:
        self.seconds = seconds
        self.hop = hop
        self.folds = folds
        self.seed = seed

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        hop = f", hop {self.hop:g} s" if self.hop else ""
        return f"{self.folds}-fold of {self.seconds:g} s windows{hop}, optimistic: subjects mixed, captures mixed"

    def joined(self, corpus: Corpus) -> Corpus:
        """The windows of all captures; no frame is copied.

        Raises:
            InputError: a length that cannot be.
        """
        if not (0 < self.seconds < np.inf and 0 <= self.hop < np.inf):
            raise InputError(
                f"protocol.seconds={self.seconds:g}, protocol.hop={self.hop:g}: give seconds above 0"
            )
        return Windows(self.seconds, self.hop)(corpus)

    def get_n_splits(self, X: object = None, y: object = None, groups: object = None) -> int:
        """Number of folds."""
        return self.folds

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) indices of windows, and the tested ones in parts with one window of a capture each.

        Raises:
            InputError: a class has fewer windows than there are folds, or fewer than two folds.
        """
        for train, test in split_stratified(X, y, self.folds, self.seed):
            order = np.argsort(X.index[test], kind="stable")
            index = X.index[test][order]
            number = np.empty(len(test), dtype=int)  # of the window among those of its capture
            number[order] = np.arange(len(test)) - np.searchsorted(index, index)
            nothing = test[:0]
            yield train, test, [(nothing, test[number == part]) for part in range(number.max() + 1)]
