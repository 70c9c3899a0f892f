"""Splits by subject: none is on both sides."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from sklearn.model_selection import GroupKFold

from bench.corpora.corpus import Corpus
from bench.errors import InputError

Folds = Iterator[tuple[np.ndarray, np.ndarray]]  # positions of training and of test captures


def sort_naturally(names: np.ndarray) -> list[str]:
    """Distinct names, integers first and by value: 1, 2, 10 rather than 1, 10, 2."""
    return sorted(set(names), key=lambda s: (not s.isdecimal(), int(s) if s.isdecimal() else 0, s))


class CaptureSplitter:
    """Base of the protocols, with what scikit-learn's searches need."""

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Iterator:
        """Yield (train, test) capture indices."""
        raise NotImplementedError

    def get_n_splits(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> int:
        """Number of folds."""
        return sum(1 for _ in self.split(X, y, groups))


class LOSO(CaptureSplitter):
    """Leave one subject out: a fold for each subject."""

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"LOSO ({len(set(corpus.subjects))} subjects)"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices, subjects in natural order.

        Raises:
            InputError: there is only one subject.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        names = sort_naturally(groups)
        if len(names) < 2:
            fact = f"{X.name} has {len(names)} subject here, two are needed to leave one out"
            raise InputError(f"{fact}; widen where= or use protocol=kfold")
        for name in names:
            test = groups == name
            yield np.flatnonzero(~test), np.flatnonzero(test)


@dataclass(eq=False, repr=False)
class Pairs(CaptureSplitter):
    """Leave two subjects out together: a fold for each pair of a certain distance.

    A choice for one of the two by the accuracy on the other depends on no capture of the first.

    Args:
        apart: places between the two, in natural order and from the last subject on to the first.
    """

    apart: int = 1

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"two left out, {self.apart} apart ({len(set(corpus.subjects))} subjects)"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices, pairs in natural order of their first subject.

        Raises:
            InputError: fewer than three subjects, or no two are that far apart.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        names = sort_naturally(groups)
        count = len(names)
        if count < 3 or not 1 <= self.apart <= count // 2:
            advice = f"give 1 to {count // 2}" if count > 2 else "three are needed; widen where="
            fact = f"{X.name} has {count} subjects here"
            raise InputError(f"protocol.apart={self.apart}: {fact}; {advice}")
        for i in range(self.apart if 2 * self.apart == count else count):
            test = np.isin(groups, [names[i], names[(i + self.apart) % count]])
            yield np.flatnonzero(~test), np.flatnonzero(test)


@dataclass(eq=False, repr=False)
class SubjectKFold(CaptureSplitter):
    """K folds of whole subjects (scikit-learn's `GroupKFold`).

    Args:
        folds: number of folds, at most the number of subjects.
        seed: random seed of the order in which subjects are dealt to folds.
    """

    folds: int = 10
    seed: int = 0

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"{self.folds}-fold by subject"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: fewer subjects than folds, or fewer than two folds.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        subjects = len(set(groups))
        if self.folds < 2 or self.folds > subjects:
            count, advice = f"{subjects} subjects", f"give 2 to {subjects} folds"
            if subjects == 1:
                count, advice = "1 subject", "two are needed; take protocol=kfold or more captures"
            raise InputError(f"protocol.folds={self.folds}: {X.name} has {count} here; {advice}")
        splitter = GroupKFold(self.folds, shuffle=True, random_state=self.seed)
        yield from splitter.split(groups, groups=groups)


@dataclass(eq=False, repr=False)
class Sessions(CaptureSplitter):
    """Leave one subject out, test each of this subject's sessions, and train on the others.

    Args:
        column: the condition that tells sessions apart.
    """

    column: str = "session"

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"LOSO, other {self.column} ({len(set(corpus.subjects))} subjects)"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices, subjects and sessions in natural order.

        Raises:
            InputError: captures have no such column, or only one subject or session.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        if self.column not in X.captures:
            columns = ", ".join(map(str, X.captures))
            raise InputError(
                f"protocol.column={self.column}: {X.name} has no such column, but {columns}"
            )
        sessions = X.captures[self.column].astype(str).to_numpy(object)
        names = sort_naturally(groups)
        for what, values in (("subject", groups), (self.column, sessions)):
            if len(set(values)) < 2:
                raise InputError(
                    f"protocol=sessions: {X.name} has one {what} here, two are needed; widen where="
                )
        for name in names:
            for session in sort_naturally(sessions[groups == name]):
                test = (groups == name) & (sessions == session)
                train = (groups != name) & (sessions != session)
                yield np.flatnonzero(train), np.flatnonzero(test)
