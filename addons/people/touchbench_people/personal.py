"""A new person with some calibration captures: leave one subject out, and calibrate on a part of theirs."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.timing import timed_once
from bench.plan.splits import Tested
from bench.protocols.subjects import LOSO, natural_order
from bench.running.fold import fitted, seconds_of
from touchbench_people.adaptation import WEIGHT, adapted, adapts

if TYPE_CHECKING:
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold

Pairs = list[
    tuple[np.ndarray, np.ndarray]
]  # positions of the calibration, and of the captures tested after it
Folds = Iterator[tuple[np.ndarray, np.ndarray, Pairs]]

APART = {"subject", "gesture", "repetition", "split", "skin"}  # columns that are no conditions


class Personal:
    """Train on all other subjects, and on some captures of the tested one (a calibration).

    The captures of a subject are dealt into two halves, class by class. A calibration is drawn from one half and tested
    on the other, and the other way round, so that in each draw every capture is tested once, whatever the number of
    shots; without shots this is leaving one subject out. Draws are nested: with three shots there are the two that two
    have, and one more. Of a class with fewer captures in a half all are taken.

    A system that adapts (`touchbench_people.adaptation`) is fitted to the others once and adapted in each draw; any
    other one is fitted anew to the others and the shots, each ``weight`` times. Without labels it stays as it is.

    Args:
        shots: labelled captures of each class.
        draws: calibrations that are drawn, each tested.
        unlabelled: a whole half, without labels, in place of shots.
        weight: number of times that a shot counts for a system that cannot adapt.
        seed: random seed of halves and draws.
    """

    view = "touchbench_people.page:NewPerson"

    def __init__(
        self,
        shots: int = 0,
        draws: int = 5,
        unlabelled: bool = False,
        weight: int = WEIGHT,
        seed: int = 0,
    ) -> None:
        self.shots = shots
        self.draws = draws
        self.unlabelled = unlabelled
        self.weight = weight
        self.seed = seed

    def check(self) -> None:
        """Refuse parameters that cannot be.

        Raises:
            InputError: one of them.
        """
        for name, least in (("shots", 0), ("draws", 1), ("weight", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"protocol.{name}={getattr(self, name)}: give {least} or more")
        if self.unlabelled and self.shots:
            raise InputError(
                f"protocol.shots={self.shots}: shots have labels; leave them out with protocol.unlabelled=true"
            )

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        half = "half of the captures without labels"
        shots = half if self.unlabelled else f"{self._fewest(corpus)}{self.shots} shots"
        drawn = f", {self.draws} draws" if self.shots else ""
        drawn += f", counted {self.weight} times" if self.shots and self.weight != WEIGHT else ""
        drawn += f", seed {self.seed}" if self.seed and (self.shots or self.unlabelled) else ""
        return f"personal, {shots}{drawn}{self._conditions(corpus)} ({len(set(corpus.subjects))} subjects)"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices, without the shots, subjects in natural order, and pairs of each draw.

        Raises:
            InputError: parameters that cannot be, or there is only one subject.
        """
        self.check()
        folds = LOSO().split(X, y, groups)
        for (train, test), draws in zip(folds, self.calibrations(X, y, groups), strict=True):
            yield train, test, with_shots([*chain.from_iterable(draws)])

    def systems(self, cell: Cell, corpus: Corpus, fold: Fold) -> Iterator[Tested]:
        """The systems of a fold: one, or one for each pair of each draw.

        No tested capture is looked at, nor the label of a calibration capture that is unlabelled.
        """
        general = cell.estimator()
        if not fold.pairs:
            yield Tested(fold.name, general, fold.test, fitted(general, corpus[fold.train]))
            return
        refits = not self.unlabelled and not adapts(general)
        seconds = {} if refits else fitted(general, corpus[fold.train])
        draws = 1 if self.unlabelled else self.draws
        for number, (shots, tested) in enumerate(fold.pairs):
            name = (
                fold.name
                if draws == 1
                else f"{fold.name} draw {1 + number * draws // len(fold.pairs)}"
            )
            if not len(tested):
                continue
            if not len(shots):  # of a person with one capture
                seconds = seconds or fitted(general, corpus[fold.train])
                yield Tested(name, general, tested, seconds)
            elif refits:
                estimator = cell.estimator()
                both = np.concatenate([fold.train, np.repeat(shots, self.weight)])
                yield Tested(name, estimator, tested, fitted(estimator, corpus[both]))
            elif adapts(general):
                part = corpus[shots]
                labels = None if self.unlabelled else part.gestures
                estimator, times, cpu = timed_once(partial(adapted, general, part, labels))
                yield Tested(name, estimator, tested, seconds | seconds_of("adapt", times, cpu))
            else:  # it can do nothing without labels
                yield Tested(name, general, tested, seconds)

    def calibrations(
        self, X: Corpus, y: object = None, groups: np.ndarray | None = None
    ) -> Iterator[list[Pairs]]:
        """For each fold and draw, pairs of indices: calibration captures of the subject, captures tested after them."""
        labels = (X.gestures if y is None else np.asarray(y)).astype(str)
        who = (X.subjects if groups is None else np.asarray(groups)).astype(str)
        for name in natural_order(who):
            captures = np.flatnonzero(who == name)
            parts = [
                captures[labels[captures] == gesture] for gesture in natural_order(labels[captures])
            ]
            halves = self._halves(X, parts)
            if self.unlabelled:
                yield [[(halves[0], halves[1]), (halves[1], halves[0])]]
            elif not self.shots:
                yield []
            else:
                yield [self._draw(X, parts, halves, draw) for draw in range(1, self.draws + 1)]

    def _halves(self, X: Corpus, parts: list[np.ndarray]) -> list[np.ndarray]:
        """The captures of a subject, class by class, in two halves; the odd ones go to either in turn."""
        halves: list[list[np.ndarray]] = [[], []]
        for number, part in enumerate(parts):
            mixed = self._rng(X, part, 0).permutation(part)
            halves[number % 2].append(mixed[::2])
            halves[1 - number % 2].append(mixed[1::2])
        return [np.sort(np.concatenate(half)) for half in halves]

    def _draw(
        self, X: Corpus, parts: list[np.ndarray], halves: list[np.ndarray], draw: int
    ) -> Pairs:
        orders = [self._rng(X, part, draw).permutation(part) for part in parts]
        pairs = []
        for half, other in (halves, halves[::-1]):
            shots = [order[np.isin(order, half)][: self.shots] for order in orders]
            pairs.append((np.sort(np.concatenate(shots)), other))
        return pairs

    def _rng(self, X: Corpus, part: np.ndarray, draw: int) -> np.random.Generator:
        """Random numbers of some captures, whichever others there are."""
        return np.random.default_rng([self.seed, draw, *(int(i) for i in X.index[part])])

    def _fewest(self, corpus: Corpus) -> str:
        """``up to``, where a half of some subject holds fewer captures of a class."""
        labels, who = corpus.gestures.astype(str), corpus.subjects.astype(str)
        halves = pd.crosstab(who, labels).to_numpy() // 2
        return "up to " if (halves < self.shots).any() else ""

    def _conditions(self, corpus: Corpus) -> str:
        """Whether a tested capture has the very conditions of one in the other half; nothing where there are none."""
        names = [c for c in corpus.captures if c not in APART and c not in corpus.target.split("+")]
        if not names or not (self.shots or self.unlabelled):
            return ""
        conditions = corpus.captures[names].astype(str).assign(class_=corpus.gestures.astype(str))
        kinds = conditions.agg(" ".join, axis=1).to_numpy()
        halves = [
            pair
            for draws in Personal(unlabelled=True, seed=self.seed).calibrations(corpus)
            for pair in draws[0]
        ]
        same = any(np.isin(kinds[tested], kinds[shots]).any() for shots, tested in halves)
        return ", under the same conditions" if same else ", under other conditions"


def with_shots(pairs: Pairs) -> Pairs:
    """The pairs; none if all of them are without calibration captures."""
    return pairs if any(len(shots) for shots, _ in pairs) else []
