"""Splits by capture: other captures of a test subject are trained on, so scores are optimistic.

On CoST they are about ten points higher than for a new person (docs/notes/systems.md, protocols);
every label says that subjects are mixed.
"""

from dataclasses import dataclass

import numpy as np
from sklearn.model_selection import LeaveOneOut, StratifiedKFold, StratifiedShuffleSplit

from bench.corpora.corpus import Corpus
from bench.errors import InputError, check_value
from bench.protocols.subjects import CaptureSplitter, Folds, sort_naturally


def split_stratified(X: Corpus, y: object, folds: int, seed: int | np.random.RandomState) -> Folds:
    """Yield shuffled stratified folds of captures.

    Raises:
        InputError: a class has fewer captures than there are folds, or fewer than two folds.
    """
    y = X.gestures if y is None else np.asarray(y)
    rare, count = _find_rarest(y)
    if folds < 2 or count < folds:
        advice = f"give 2 to {count} folds"
        if count < 2:
            advice = f"two are needed; {_exclusion_advice(rare)}"
        fact = f"gesture {rare} of {X.name} has {count} captures here"
        raise InputError(f"protocol.folds={folds}: {fact}; {advice}")
    yield from StratifiedKFold(folds, shuffle=True, random_state=seed).split(np.zeros(len(y)), y)


def _find_rarest(y: np.ndarray) -> tuple[str, int]:
    """The class with the fewest captures, and their number."""
    names, counts = np.unique(y.astype(str), return_counts=True)
    return names[counts.argmin()], counts.min()


def _exclusion_advice(gesture: str) -> str:
    return f'leave it out with where="gesture != {gesture!r}"'


@dataclass(eq=False, repr=False)
class CaptureKFold(CaptureSplitter):
    """K stratified folds of captures (Hughes et al. 2015 used 10); subjects are mixed.

    Args:
        folds: number of folds.
        seed: random seed of the shuffle.
    """

    folds: int = 10
    seed: int = 0

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.folds}-fold, subjects mixed"

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) capture indices; raises as `split_stratified`."""
        yield from split_stratified(X, y, self.folds, self.seed)


@dataclass(eq=False, repr=False)
class RepeatedKFold(CaptureSplitter):
    """K stratified folds of captures, drawn several times; subjects are mixed.

    Args:
        folds: number of folds.
        repeats: number of draws, each of which tests every capture.
        seed: random seed of the shuffles.
    """

    folds: int = 10
    repeats: int = 5
    seed: int = 0

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.repeats} times {self.folds}-fold, subjects mixed"

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) capture indices; raises as `split_stratified`."""
        check_value("protocol.repeats", self.repeats, self.repeats >= 1, "1 or more")
        shuffles = np.random.RandomState(self.seed)  # one stream for all repeats, as scikit-learn's
        for _ in range(self.repeats):
            yield from split_stratified(X, y, self.folds, shuffles)


@dataclass(eq=False, repr=False)
class Within(CaptureSplitter):
    """K stratified folds of the captures of each subject, each with a system of its own.

    Cang et al. 2015 printed accuracies of this protocol.

    Args:
        folds: number of folds for each subject.
        seed: random seed of the shuffle.
    """

    folds: int = 5
    seed: int = 0

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.folds}-fold within each subject, subjects mixed: a system per subject"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices by subject; raises as `split_stratified`."""
        groups = np.asarray(X.subjects if groups is None else groups)
        y = X.gestures if y is None else np.asarray(y)
        for name in sort_naturally(groups):
            rows = np.flatnonzero(groups == name)
            try:
                for train, test in split_stratified(X[rows], y[rows], self.folds, self.seed):
                    yield rows[train], rows[test]
            except InputError as e:
                raise InputError(f"protocol=within, subject {name}: {e}") from e


class LeaveOneCapture(CaptureSplitter):
    """Train on all captures but one, subjects mixed; a fold for each capture takes long."""

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"leave one capture out ({len(corpus)} captures), subjects mixed"

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: a class has a single capture, so a fold would not train on it.
        """
        y = X.gestures if y is None else np.asarray(y)
        rare, count = _find_rarest(y)
        if count < 2:
            fact = f"gesture {rare} of {X.name} has 1 capture here"
            raise InputError(f"protocol=leave_one_capture: {fact}; {_exclusion_advice(rare)}")
        yield from LeaveOneOut().split(np.zeros(len(y)))


@dataclass(eq=False, repr=False)
class Holdout(CaptureSplitter):
    """A stratified split of captures, 65 / 35 as in van Wingerden et al. 2014; subjects are mixed.

    Args:
        test: share of captures that is tested.
        seed: random seed of the draw.
    """

    test: float = 0.35
    seed: int = 0

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{1 - self.test:.0%} / {self.test:.0%} hold-out, subjects mixed"

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield the one (train, test) pair of capture indices.

        Raises:
            InputError: the share leaves a side without a capture of some class.
        """
        y = X.gestures if y is None else np.asarray(y)
        advice = "a share between 0 and 1, such as 0.35"
        check_value("protocol.test", self.test, 0 < self.test < 1, advice)
        splitter = StratifiedShuffleSplit(1, test_size=self.test, random_state=self.seed)
        try:
            yield from splitter.split(np.zeros(len(y)), y)
        except ValueError as e:
            raise InputError(f"protocol=holdout test={self.test} on {X.name}: {e}") from e
