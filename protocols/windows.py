"""Windows of captures dealt to folds at random, as in papers that cut captures before splitting."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.windows import Windows
from bench.errors import check_value
from bench.protocols.captures import split_stratified
from bench.protocols.subjects import CaptureSplitter

# Further training windows (none), and tested ones, at most one of each capture.
Parts = list[tuple[np.ndarray, np.ndarray]]
Folds = Iterator[tuple[np.ndarray, np.ndarray, Parts]]


@dataclass(eq=False, repr=False)
class WindowKFold(CaptureSplitter):
    """K stratified folds of windows; other, maybe overlapping windows of a capture are trained on.

    This is optimistic even for the same person, and every label says so. A capture gets the mean
    probability of all its windows, each predicted in the fold that tests it. To compare with other
    protocols, give the system windows of the same length there (``model.window=``).

    Args:
        seconds: length of a window; a shorter capture is one window.
        hop: seconds from the beginning of one window to that of the next; 0 is half a window.
        folds: number of folds.
        seed: random seed of the shuffle.
    """

    seconds: float = 1.0
    hop: float = 0.0
    folds: int = 10
    seed: int = 0

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        hop = f", hop {self.hop:g} s" if self.hop else ""
        windows = f"{self.folds}-fold of {self.seconds:g} s windows{hop}"
        return f"{windows}, optimistic: subjects mixed, captures mixed"

    def joined(self, corpus: Corpus) -> Corpus:
        """The windows of all captures; no frame is copied.

        Raises:
            InputError: a length is out of its range.
        """
        is_valid = 0 < self.seconds < np.inf
        check_value("protocol.seconds", self.seconds, is_valid, "seconds above 0")
        check_value("protocol.hop", self.hop, 0 <= self.hop < np.inf, "seconds above 0, or 0")
        return Windows(self.seconds, self.hop)(corpus)

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) indices of windows, and parts of test with one window per capture.

        Raises:
            InputError: a class has fewer windows than there are folds, or fewer than two folds.
        """
        for train, test in split_stratified(X, y, self.folds, self.seed):
            order = np.argsort(X.index[test], kind="stable")
            index = X.index[test][order]
            number = np.empty(len(test), dtype=int)  # of the window among those of its capture
            number[order] = np.arange(len(test)) - np.searchsorted(index, index)
            parts = [test[number == part] for part in range(number.max() + 1)]
            yield train, test, [(test[:0], part) for part in parts]
