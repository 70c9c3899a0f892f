"""The interface of a protocol. scikit-learn's splitters work unchanged.

A protocol is an object with ``split(X, y, groups)`` over a `Corpus`, its classes and its subjects, which yields (train,
test) capture positions. It may also have

- ``label(corpus)``: the words that stand in every row of results; else its name with the parameters that are not the
  default, and ``subjects mixed`` where captures of a subject are on both sides of a fold;
- ``official_split(corpus)``: whether its folds are those of a publication, where there is such a split at all;
- ``joined(corpus)``: the captures that it splits, where these are more than those of ``data=``, or their windows;
- ``systems(cell, corpus, fold)``: the fitted systems of a fold, each a `Tested`; else one, fitted to ``train``. Its
  ``split`` may then yield (train, test, pairs): further captures that a system learns from, and those tested after it.
  Without ``systems``, pairs are parts of ``test`` that are predicted one after the other;
- ``view``: ``module:class`` of what the report shows of its runs, with ``holds``, ``section``, ``brief``, ``sheets``.

Whether subjects are mixed, and how many captures are tested by those trained on, is seen from the folds themselves.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np

from bench import contract
from bench.corpora.corpus import Corpus


class Splitter(Protocol):
    """The required interface of a protocol."""

    def split(
        self, X: Corpus, y: np.ndarray, groups: np.ndarray
    ) -> Iterable[tuple[np.ndarray, np.ndarray]]:
        """Training and test captures of each fold, by position."""


class Tested(NamedTuple):
    """A fitted system and the captures of a fold that it predicts."""

    name: str  # of the fold, or of a part of it
    estimator: contract.System
    tested: np.ndarray  # positions of the captures
    metrics: dict[str, float]  # costs of fitting
