"""The interface of a protocol. scikit-learn's splitters work unchanged.

A protocol is an object with ``split(X, y, groups)`` over a `Corpus`, its classes and its subjects, which yields (train,
test) capture positions. It may also have

- ``label(corpus)``: the words that stand in every row of results; else its name with the parameters that are not the
  default, and ``subjects mixed`` where captures of a subject are on both sides of a fold;
- ``official_split(corpus)``: whether its folds are those of a publication, where there is such a split at all;
- ``joined(corpus)``: the captures that it splits, where these are more than those of ``data=``;
- ``calibrations(X, y, groups)``: of each fold and draw, pairs of positions: captures that are known of the person who
  is tested, and those that are tested then; with ``unlabelled``, whether labels are not known, and ``weight``, how
  often a known capture counts in training.

Whether subjects are mixed, and how many captures are tested by those trained on, is seen from the folds themselves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import repeat
from typing import Protocol

import numpy as np

from bench.corpora.corpus import Corpus


class Splitter(Protocol):
    """The required interface of a protocol."""

    def split(self, X: Corpus, y: np.ndarray, groups: np.ndarray) -> Iterable[tuple[np.ndarray, np.ndarray]]:
        """Training and test captures of each fold, by position."""


def label(protocol: Splitter, corpus: Corpus, mixes_subjects: bool, name: str, seed: object = None) -> str:
    """The protocol in words, distinct for runs on other splits.

    Args:
        protocol: splitter.
        corpus: corpus to split.
        mixes_subjects: True if a fold has captures of one subject on both sides.
        name: name of a protocol without a label, with its parameters.
        seed: seed of the protocol, None for the default; it is appended to a label that lacks it.
    """
    if words := getattr(protocol, "label", None):
        return with_seed(words(corpus), seed)
    return name + (", subjects mixed" if mixes_subjects else "")


def with_seed(label: str, seed: object) -> str:
    """A label that names the seed, if there is one."""
    return label if seed is None or re.search(rf"\bseed {seed}\b", label) else f"{label}, seed {seed}"


@dataclass(frozen=True)
class Calibration:
    """Calibration captures of the tested person in a fold.

    Attributes:
        draws: for each draw, pairs of positions: calibration captures, and captures tested after them. In a draw every
            test capture of the fold is tested once.
        labelled: True if the calibration captures have labels.
        weight: number of times that a calibration capture counts in training.
    """

    draws: tuple[tuple[tuple[np.ndarray, np.ndarray], ...], ...]
    labelled: bool
    weight: int


def calibrations(protocol: Splitter, corpus: Corpus, y: np.ndarray, groups: np.ndarray) -> Iterator[Calibration | None]:
    """Yield the calibration of each fold; None without end for a protocol without any."""
    drawn = getattr(protocol, "calibrations", None)
    if drawn is None:
        yield from repeat(None)
        return
    labelled, weight = not getattr(protocol, "unlabelled", False), getattr(protocol, "weight", 1)
    for draws in drawn(corpus, y, groups):
        pairs = tuple(tuple((np.asarray(shots), np.asarray(tested)) for shots, tested in draw) for draw in draws)
        none = not any(len(shots) for draw in pairs for shots, _ in draw)
        yield None if none else Calibration(pairs, labelled, weight)


def captures(protocol: Splitter, corpus: Corpus) -> Corpus:
    """The captures to split: the corpus itself, or with others."""
    joined = getattr(protocol, "joined", None)
    return corpus if joined is None else joined(corpus)


def official_split(protocol: Splitter, corpus: Corpus) -> bool | None:
    """Return True if its folds are the published ones, None if none were published."""
    official = getattr(protocol, "official_split", None)
    return official(corpus) if official else None
