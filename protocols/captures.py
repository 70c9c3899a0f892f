"""Splits by capture: a test subject's other captures are trained on, so scores are optimistic for a new person.

On CoST this is worth about ten points of accuracy (docs/notes/systems.md, protocols); every label states it.
"""

import numpy as np
from sklearn.model_selection import StratifiedKFold, StratifiedShuffleSplit

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.protocols.subjects import Folds


class CaptureKFold:
    """K stratified folds of captures (Hughes et al. 2015 used 10); subjects are mixed.

    Args:
        folds: number of folds.
        seed: random seed of the shuffle.
    """

    def __init__(self, folds: int = 10, seed: int = 0) -> None:
        self.folds = folds
        self.seed = seed

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.folds}-fold, subjects mixed"

    def get_n_splits(self, X: object = None, y: object = None, groups: object = None) -> int:
        """Number of folds."""
        return self.folds

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) capture indices, every class spread over all folds.

        Raises:
            InputError: a class has fewer captures than there are folds, or fewer than two folds.
        """
        y = X.gestures if y is None else np.asarray(y)
        names, counts = np.unique(y.astype(str), return_counts=True)
        if self.folds < 2 or counts.min() < self.folds:
            rare, most = names[counts.argmin()], counts.min()
            what = (
                f"give 2 to {most} folds"
                if most > 1
                else f'two are needed; leave it out with where="gesture != {rare!r}"'
            )
            raise InputError(
                f"protocol.folds={self.folds}: gesture {rare} of {X.name} has {most} captures here; {what}"
            )
        splitter = StratifiedKFold(self.folds, shuffle=True, random_state=self.seed)
        yield from splitter.split(np.zeros(len(y)), y)


class Holdout:
    """A stratified split of captures, 65 / 35 as in van Wingerden et al. 2014; subjects are mixed.

    Args:
        test: share of captures that is tested.
        seed: random seed of the draw.
    """

    def __init__(self, test: float = 0.35, seed: int = 0) -> None:
        self.test = test
        self.seed = seed

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{1 - self.test:.0%} / {self.test:.0%} hold-out, subjects mixed"

    def get_n_splits(self, X: object = None, y: object = None, groups: object = None) -> int:
        """Return 1."""
        return 1

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield the one (train, test) pair of capture indices.

        Raises:
            InputError: the share leaves a side without a capture of some class.
        """
        y = X.gestures if y is None else np.asarray(y)
        if not 0 < self.test < 1:
            raise InputError(f"protocol.test={self.test}: give a share between 0 and 1, such as 0.35")
        splitter = StratifiedShuffleSplit(1, test_size=self.test, random_state=self.seed)
        try:
            yield from splitter.split(np.zeros(len(y)), y)
        except ValueError as e:
            raise InputError(f"protocol=holdout test={self.test} on {X.name}: {e}") from e
