"""The system of a fold for the person whom it tests: as it is, adapted, or fitted to some of their captures as well."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench import contract
from bench.work.fold import fitted

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold


@dataclass
class Met:
    """A system that is asked about some captures of a fold.

    Attributes:
        name: of the fold and the draw.
        estimator: fitted.
        tested: positions of the captures.
        metrics: what the fit took, and adapting.
    """

    name: str
    estimator: contract.System
    tested: np.ndarray
    metrics: dict[str, float]


def met(cell: Cell, corpus: Corpus, fold: Fold) -> Iterator[Met]:
    """The systems of a fold: one, or one for each part of each draw of the captures that are known of a person.

    No tested capture is looked at, nor the label of a known one where labels are not known.
    """
    known, train = fold.known, fold.train
    general = cell.estimator()
    if known is None:
        yield Met(fold.name, general, fold.test, fitted(general, corpus[train]))
        return
    alone = contract.adapts(general) or not known.labelled
    spent = fitted(general, corpus[train]) if alone else {}
    for number, draw in enumerate(known.draws, 1):
        name = fold.name if len(known.draws) == 1 else f"{fold.name} draw {number}"
        for shots, tested in draw:
            if not len(tested):
                continue
            if not len(shots):  # of a person with one capture
                if not alone:
                    spent, alone = fitted(general, corpus[train]), True
                yield Met(name, general, tested, spent)
            elif not alone:
                estimator = cell.estimator()
                both = np.concatenate([train, np.repeat(shots, known.weight)])
                yield Met(name, estimator, tested, fitted(estimator, corpus[both]))
            elif contract.adapts(general):
                part = corpus[shots]
                began = time.perf_counter()
                estimator = contract.adapted(general, part, part.gestures if known.labelled else None)
                yield Met(name, estimator, tested, spent | {"adapt_seconds": time.perf_counter() - began})
            else:  # it can do nothing without labels
                yield Met(name, general, tested, spent)
