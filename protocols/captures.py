"""Splits by capture: a test subject's other captures are trained on, so scores are optimistic for a new person.

On CoST this is worth about ten points of accuracy (docs/notes/systems.md, protocols); every label states it.
"""

import numpy as np
from sklearn.model_selection import LeaveOneOut, StratifiedKFold, StratifiedShuffleSplit

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.protocols.subjects import Folds, sort_naturally


def split_stratified(X: Corpus, y: object, folds: int, seed: int | np.random.RandomState) -> Folds:
    """Stratified folds of captures, shuffled.

    Raises:
        InputError: a class has fewer captures than there are folds, or fewer than two folds.
    """
    y = X.gestures if y is None else np.asarray(y)
    rare, most = _find_rarest(y)
    if folds < 2 or most < folds:
        what = (
            f"give 2 to {most} folds" if most > 1 else f"two are needed; {_exclusion_advice(rare)}"
        )
        raise InputError(
            f"protocol.folds={folds}: gesture {rare} of {X.name} has {most} captures here; {what}"
        )
    yield from StratifiedKFold(folds, shuffle=True, random_state=seed).split(np.zeros(len(y)), y)


def _find_rarest(y: np.ndarray) -> tuple[str, int]:
    """The class with the fewest captures, and their number."""
    names, counts = np.unique(y.astype(str), return_counts=True)
    return names[counts.argmin()], counts.min()


def _exclusion_advice(gesture: str) -> str:
    return f'leave it out with where="gesture != {gesture!r}"'


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
        """Yield (train, test) capture indices, every class spread over all folds; `split_stratified` says what is refused."""
        yield from split_stratified(X, y, self.folds, self.seed)


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
        """Yield (train, test) capture indices; refuses no repeat, and as `split_stratified` does."""
        if self.repeats < 1:
            raise InputError(f"protocol.repeats={self.repeats}: give 1 or more")
        shuffles = np.random.RandomState(self.seed)  # one stream for all repeats, as scikit-learn's
        for _ in range(self.repeats):
            yield from split_stratified(X, y, self.folds, shuffles)


class Within:
    """K stratified folds of the captures of each subject; a system is trained on captures of this subject alone.

    Cang et al. 2015 printed accuracies of this protocol.

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
        """Yield (train, test) capture indices, subjects in natural order; `split_stratified` says what is refused."""
        groups = np.asarray(X.subjects if groups is None else groups)
        y = X.gestures if y is None else np.asarray(y)
        for name in sort_naturally(groups):
            own = np.flatnonzero(groups == name)
            try:
                for train, test in split_stratified(X[own], y[own], self.folds, self.seed):
                    yield own[train], own[test]
            except InputError as e:
                raise InputError(f"protocol=within, subject {name}: {e}") from e


class LeaveOneCapture:
    """Train on all captures but one, so on others of the same subject; a fold for each capture takes long."""

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"leave one capture out ({len(corpus)} captures), subjects mixed"

    def get_n_splits(self, X: Corpus, y: object = None, groups: object = None) -> int:
        """Number of captures."""
        return len(X)

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: a class has a single capture, which no fold could train on.
        """
        y = X.gestures if y is None else np.asarray(y)
        rare, fewest = _find_rarest(y)
        if fewest < 2:
            one = f"gesture {rare} of {X.name} has 1 capture here"
            raise InputError(f"protocol=leave_one_capture: {one}; {_exclusion_advice(rare)}")
        yield from LeaveOneOut().split(np.zeros(len(y)))


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
            raise InputError(
                f"protocol.test={self.test}: give a share between 0 and 1, such as 0.35"
            )
        splitter = StratifiedShuffleSplit(1, test_size=self.test, random_state=self.seed)
        try:
            yield from splitter.split(np.zeros(len(y)), y)
        except ValueError as e:
            raise InputError(f"protocol=holdout test={self.test} on {X.name}: {e}") from e
