"""The system of a fold for the person whom it tests: as it is, adapted, or fitted to some of their captures as well."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bench import contract
from bench.timing import timed_once
from bench.work.fold import fitted, seconds_of

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold


@dataclass
class Met:
    """A fitted system and the captures of a fold that it predicts.

    Attributes:
        name: name of the fold and the draw.
        estimator: fitted.
        tested: positions of the captures.
        metrics: costs of fitting and adapting.
    """

    name: str
    estimator: contract.System
    tested: np.ndarray
    metrics: dict[str, float]


def met(cell: Cell, corpus: Corpus, fold: Fold) -> Iterator[Met]:
    """The systems of a fold: one, or one for each part of each draw of a person's calibration captures.

    No tested capture is looked at, nor the label of a calibration capture where the protocol hides labels.
    """
    calibration, train = fold.known, fold.train
    general = cell.estimator()
    if calibration is None:
        yield Met(fold.name, general, fold.test, fitted(general, corpus[train]))
        return
    adapts = contract.adapts(general)
    refits = calibration.labelled and not adapts
    seconds = {} if refits else fitted(general, corpus[train])
    for number, draw in enumerate(calibration.draws, 1):
        name = fold.name if len(calibration.draws) == 1 else f"{fold.name} draw {number}"
        for shots, tested in draw:
            if not len(tested):
                continue
            if not len(shots):  # of a person with one capture
                seconds = seconds or fitted(general, corpus[train])
                yield Met(name, general, tested, seconds)
            elif refits:
                estimator = cell.estimator()
                both = np.concatenate([train, np.repeat(shots, calibration.weight)])
                yield Met(name, estimator, tested, fitted(estimator, corpus[both]))
            elif adapts:
                part = corpus[shots]
                labels = part.gestures if calibration.labelled else None
                estimator, times, cpu = timed_once(partial(contract.adapted, general, part, labels))
                yield Met(name, estimator, tested, seconds | seconds_of("adapt", times, cpu))
            else:  # it can do nothing without labels
                yield Met(name, general, tested, seconds)
