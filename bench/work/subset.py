"""Training captures of some of the training subjects."""

from __future__ import annotations

import hashlib

import numpy as np

from bench.corpora.corpus import Corpus


def subset(corpus: Corpus, train: np.ndarray, test: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Positions of the training captures of ``count`` training subjects.

    The subjects come in one random order per seed and test subjects, so that fewer are among more, and every system
    learns from the same ones.
    """
    subjects = sorted(set(corpus.subjects[train]))
    drawn = hashlib.sha256(repr((seed, sorted(set(corpus.subjects[test])))).encode()).digest()
    order = np.random.default_rng(int.from_bytes(drawn[:16], "little")).permutation(len(subjects))
    return train[np.isin(corpus.subjects[train], [subjects[i] for i in order[:count]])]
