"""The interface of a protocol. scikit-learn's splitters work unchanged.

A protocol is an object with ``split(X, y, groups)``. It gets a `Corpus`, its classes and its
subjects, and yields the positions of training and test captures. It may also have

- ``label(corpus)``: the words for it in every row of results. By default its name with the
  parameters that are not the default, and ``subjects mixed`` if a fold trains and tests a subject;
- ``official_split(corpus)``: whether its folds are those of a publication, if there are such folds;
- ``joined(corpus)``: the captures to split, if these are more than those of ``data=``, or windows;
- ``systems(cell, corpus, fold)``: the fitted systems of a fold, each a `SystemToTest`. By default
  one, fitted to the training captures. ``split`` may then yield (train, test, pairs). Each pair has
  the further training captures of one system and the captures it is tested on. Without
  ``systems``, pairs are parts of ``test`` that are predicted one after the other;
- ``view``: ``module:class`` of what the report shows of its runs.

The folds themselves tell whether subjects are mixed, and how many captures are tested for each
training capture.
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


class SystemToTest(NamedTuple):
    """A fitted system and the captures of a fold that it predicts."""

    name: str  # of the fold, or of a part of it
    estimator: contract.System
    tested: np.ndarray  # positions of the captures
    metrics: dict[str, float]  # costs of fitting
