"""A new person with some calibration captures, for each subject in turn."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.timing import time_once
from bench.plan.splits import SystemToTest
from bench.protocols.subjects import LOSO, sort_naturally
from bench.running.fold import fit_timed, seconds_metrics
from touchbench_people.adaptation import SHOT_WEIGHT, adapt_system, can_adapt

if TYPE_CHECKING:
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold

# Positions of calibration captures, and of captures that are tested after them.
Pairs = list[tuple[np.ndarray, np.ndarray]]
Folds = Iterator[tuple[np.ndarray, np.ndarray, Pairs]]

# Columns that are no conditions.
NO_CONDITIONS = {"subject", "gesture", "repetition", "split", "skin"}


class Personal:
    """Train on all other subjects, and on some captures of the tested one (a calibration).

    The captures of a subject are dealt into two halves, class by class. A calibration is drawn from
    one half and tested on the other, and the other way round, so each draw tests every capture
    once, for any number of shots; without shots this is leave-one-subject-out. Draws are nested:
    three shots are two shots and one more. If a half has fewer captures of a class, all are drawn.

    A system that can adapt (`touchbench_people.adaptation`) is fitted to the others once and
    adapted in each draw. Any other system is fitted anew to the others and the shots, each
    ``weight`` times; without labels it does not change.

    Args:
        shots: labelled captures of each class.
        draws: number of calibrations to draw and test.
        unlabelled: use a whole half, without labels, in place of shots.
        weight: number of times that a shot counts for a system that cannot adapt.
        seed: random seed of halves and draws.
    """

    view = "touchbench_people.page:NewPerson"

    def __init__(
        self,
        shots: int = 0,
        draws: int = 5,
        unlabelled: bool = False,
        weight: int = SHOT_WEIGHT,
        seed: int = 0,
    ) -> None:
        self.shots = shots
        self.draws = draws
        self.unlabelled = unlabelled
        self.weight = weight
        self.seed = seed

    def check(self) -> None:
        """Raise an InputError for wrong parameters."""
        for name, least in (("shots", 0), ("draws", 1), ("weight", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"protocol.{name}={getattr(self, name)}: give {least} or more")
        if self.unlabelled and self.shots:
            raise InputError(
                f"protocol.shots={self.shots}: shots have labels; leave them out with "
                "protocol.unlabelled=true"
            )

    def label(self, corpus: Corpus) -> str:
        """Protocol label of results."""
        words = ["personal", self._calibration_label(corpus)]
        if self.shots:
            words.append(f"{self.draws} draws")
        if self.shots and self.weight != SHOT_WEIGHT:
            words.append(f"counted {self.weight} times")
        if self.shots or self.unlabelled:
            words += [f"seed {self.seed}"] if self.seed else []
            words += self._condition_labels(corpus)
        return f"{', '.join(words)} ({len(set(corpus.subjects))} subjects)"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test, pairs) for each subject in natural order.

        ``train`` and ``test`` are capture indices without the shots, ``pairs`` those of all draws.

        Raises:
            InputError: wrong parameters, or there is only one subject.
        """
        self.check()
        folds = LOSO().split(X, y, groups)
        for (train, test), draws in zip(folds, self.calibrations(X, y, groups), strict=True):
            yield train, test, pairs_with_shots([*chain.from_iterable(draws)])

    def systems(self, cell: Cell, corpus: Corpus, fold: Fold) -> Iterator[SystemToTest]:
        """Yield the systems of a fold: one, or one for each pair of each draw.

        They see no tested capture, and no label of an unlabelled calibration capture.
        """
        general = cell.estimator()
        if not fold.pairs:
            yield SystemToTest(
                fold.name, general, fold.test, fit_timed(general, corpus[fold.train])
            )
            return
        refits = not self.unlabelled and not can_adapt(general)
        seconds = {} if refits else fit_timed(general, corpus[fold.train])
        draws = 1 if self.unlabelled else self.draws
        for number, (shots, tested) in enumerate(fold.pairs):
            name = fold.name
            if draws > 1:
                name += f" draw {1 + number * draws // len(fold.pairs)}"
            if not len(tested):
                continue
            if not len(shots):  # the person has one capture
                seconds = seconds or fit_timed(general, corpus[fold.train])
                yield SystemToTest(name, general, tested, seconds)
            elif refits:
                estimator = cell.estimator()
                both = np.concatenate([fold.train, np.repeat(shots, self.weight)])
                yield SystemToTest(name, estimator, tested, fit_timed(estimator, corpus[both]))
            elif can_adapt(general):
                part = corpus[shots]
                labels = None if self.unlabelled else part.gestures
                estimator, times, cpu = time_once(partial(adapt_system, general, part, labels))
                adapt_seconds = seconds_metrics("adapt", times, cpu)
                yield SystemToTest(name, estimator, tested, seconds | adapt_seconds)
            else:  # it cannot use captures without labels
                yield SystemToTest(name, general, tested, seconds)

    def calibrations(
        self, X: Corpus, y: object = None, groups: np.ndarray | None = None
    ) -> Iterator[list[Pairs]]:
        """Yield the pairs of each draw for each subject, as in `Pairs`."""
        labels = (X.gestures if y is None else np.asarray(y)).astype(str)
        subjects = (X.subjects if groups is None else np.asarray(groups)).astype(str)
        for name in sort_naturally(subjects):
            captures = np.flatnonzero(subjects == name)
            own_labels = labels[captures]
            parts = [captures[own_labels == gesture] for gesture in sort_naturally(own_labels)]
            halves = self._deal_halves(X, parts)
            if self.unlabelled:
                yield [[(halves[0], halves[1]), (halves[1], halves[0])]]
            else:
                draws = range(1, self.draws + 1) if self.shots else ()
                yield [self._draw_calibration(X, parts, halves, draw) for draw in draws]

    def _deal_halves(self, X: Corpus, parts: list[np.ndarray]) -> list[np.ndarray]:
        """Deal the captures of a subject into two halves, class by class; odd ones in turn."""
        halves: list[list[np.ndarray]] = [[], []]
        for number, part in enumerate(parts):
            shuffled = self._random_generator(X, part, 0).permutation(part)
            halves[number % 2].append(shuffled[::2])
            halves[1 - number % 2].append(shuffled[1::2])
        return [np.sort(np.concatenate(half)) for half in halves]

    def _draw_calibration(
        self, X: Corpus, parts: list[np.ndarray], halves: list[np.ndarray], draw: int
    ) -> Pairs:
        orders = [self._random_generator(X, part, draw).permutation(part) for part in parts]
        pairs = []
        for half, other in (halves, halves[::-1]):
            shots = [order[np.isin(order, half)][: self.shots] for order in orders]
            pairs.append((np.sort(np.concatenate(shots)), other))
        return pairs

    def _random_generator(self, X: Corpus, part: np.ndarray, draw: int) -> np.random.Generator:
        """Random generator of some captures, independent of other captures."""
        return np.random.default_rng([self.seed, draw, *(int(i) for i in X.index[part])])

    def _calibration_label(self, corpus: Corpus) -> str:
        """Number of shots; "up to" if a half of some subject has fewer captures of a class."""
        if self.unlabelled:
            return "half of the captures without labels"
        halves = pd.crosstab(corpus.subjects.astype(str), corpus.gestures.astype(str)) // 2
        up_to = "up to " if (halves < self.shots).any(axis=None) else ""
        return f"{up_to}{self.shots} shots"

    def _condition_labels(self, corpus: Corpus) -> list[str]:
        """Whether captures in both halves have the same conditions; nothing without conditions."""
        columns = NO_CONDITIONS | {*corpus.target.split("+")}
        names = [name for name in corpus.captures if name not in columns]
        if not names:
            return []
        conditions = corpus.captures[names].astype(str).assign(class_=corpus.gestures.astype(str))
        kinds = conditions.agg(" ".join, axis=1).to_numpy()
        for (pairs,) in Personal(unlabelled=True, seed=self.seed).calibrations(corpus):
            if any(np.isin(kinds[tested], kinds[shots]).any() for shots, tested in pairs):
                return ["under the same conditions"]
        return ["under other conditions"]


def pairs_with_shots(pairs: Pairs) -> Pairs:
    """The pairs, or none if no pair has calibration captures."""
    return pairs if any(len(shots) for shots, _ in pairs) else []
