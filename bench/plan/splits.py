"""What the harness may ask of a protocol. scikit-learn's splitters are protocols as they are.

A protocol is an object with ``split(X, y, groups)`` over a `Corpus`, its classes and its subjects, which yields (train,
test) capture positions. It may also have

- ``label(corpus)``: the words that stand in every row of results; else its class name, with ``subjects mixed`` where
  captures of a subject are on both sides of a fold;
- ``official_split(corpus)``: whether its folds are those of a publication, where there is such a split at all.

Whether subjects are mixed, and how many captures are tested by those trained on, is seen from the folds themselves.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from bench.corpora.corpus import Corpus


class Splitter(Protocol):
    """What a protocol must have."""

    def split(self, X: Corpus, y: np.ndarray, groups: np.ndarray) -> Iterable[tuple[np.ndarray, np.ndarray]]:
        """Training and test captures of each fold, by position."""


def label(protocol: Splitter, corpus: Corpus, mixes_subjects: bool) -> str:
    """The protocol in words."""
    own = getattr(protocol, "label", None)
    return own(corpus) if own else type(protocol).__name__ + (", subjects mixed" if mixes_subjects else "")


def official_split(protocol: Splitter, corpus: Corpus) -> bool | None:
    """Whether its folds are those that were published, None where there is nothing of the kind."""
    own = getattr(protocol, "official_split", None)
    return own(corpus) if own else None
