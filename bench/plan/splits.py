"""What the harness may ask of a protocol. scikit-learn's splitters are protocols as they are.

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
    """What a protocol must have."""

    def split(self, X: Corpus, y: np.ndarray, groups: np.ndarray) -> Iterable[tuple[np.ndarray, np.ndarray]]:
        """Training and test captures of each fold, by position."""


def label(protocol: Splitter, corpus: Corpus, mixes_subjects: bool, name: str, seed: object = None) -> str:
    """The protocol in words, which tell runs on other splits apart.

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
    """What is known of the person whom a fold tests.

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
    """Of each fold what is known of its person; None for ever where a protocol tells nothing of the kind."""
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
    """What the protocol splits: the captures themselves, or they and others."""
    joined = getattr(protocol, "joined", None)
    return corpus if joined is None else joined(corpus)


def official_split(protocol: Splitter, corpus: Corpus) -> bool | None:
    """Whether its folds are those that were published, None where there is nothing of the kind."""
    official = getattr(protocol, "official_split", None)
    return official(corpus) if official else None
