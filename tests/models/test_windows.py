"""Windows and sequences of ragged captures against loops, the counts that papers print, and majority votes."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from bench.models.nets.training import Sequences, Windows
from bench.models.nets.window import votes
from tests.conftest import random_corpus


def loop(frames, length, hop, padding):
    """Start, frames seen and padded values of each window, by counting."""
    windows, start = [], 0
    while True:
        piece = frames[start : start + length]
        padded = np.zeros((length, *frames.shape[1:])) if padding == "zero" else np.stack([frames[-1]] * length)
        padded[: len(piece)] = piece
        windows.append((start, len(piece), padded))
        if start + length >= len(frames):
            return windows
        start += hop


@given(
    st.integers(1, 30),
    st.integers(1, 30),
    st.integers(0, 1000),
    st.sampled_from([(8, 8), (2, 3)]),
    st.sampled_from(["zero", "edge"]),
)
def test_windows_equal_a_loop(length, hop, seed, grid, padding):
    hop = min(hop, length)
    corpus = random_corpus(subjects=1, per_class=2, seed=seed, grid=grid)[np.array([3, 0, 5])]
    windows = Windows(corpus, length, hop, padding)
    expected = [(i, *w) for i, frames in enumerate(corpus) for w in loop(frames, length, hop, padding)]
    assert list(zip(windows.capture, windows.start, windows.seen, strict=True)) == [e[:3] for e in expected]
    order = np.random.default_rng(seed).permutation(len(windows))
    batch = windows.batch(order)
    assert batch.dtype == torch.float32 and batch.shape == (len(order), length, *grid)
    np.testing.assert_allclose(batch.numpy(), np.stack([expected[i][3] for i in order]) / 1023, rtol=1e-6)


@given(st.integers(1, 8), st.integers(1, 8), st.integers(1, 5), st.integers(0, 99))
def test_sequences_equal_a_loop(frames, hop, longest, seed):
    corpus = random_corpus(subjects=1, per_class=2, seed=seed)[np.array([3, 0, 5])]
    windows = Windows(corpus, frames, min(hop, frames))
    sequences = Sequences(windows, longest)
    expected = []
    for capture in range(3):
        mine = np.flatnonzero(windows.capture == capture)
        for piece in [mine[i : i + longest] for i in range(0, len(mine), longest)]:
            end = windows.start[piece[-1]] + windows.seen[piece[-1]]
            expected.append((capture, windows.start[piece[0]], end - windows.start[piece[0]], len(piece), piece))
    columns = zip(sequences.capture, sequences.start, sequences.seen, sequences.steps, strict=True)
    assert list(columns) == [e[:4] for e in expected]
    order = np.random.default_rng(seed).permutation(len(sequences))
    values, steps = sequences.batch(order)
    assert steps.tolist() == [expected[i][3] for i in order]
    assert torch.equal(values, windows.batch(np.concatenate([expected[i][4] for i in order])))


def test_votes_by_hand():
    proba = np.array([[0.9, 0.1], [0.4, 0.6], [0.4, 0.6], [0.2, 0.8], [0.7, 0.3]], dtype=np.float32)
    shares = votes(proba, np.array([3, 2]))
    assert shares.argmax(axis=1).tolist() == [1, 1]  # 2 of 3 against a higher mean; a tie by the mean
    np.testing.assert_allclose(shares.sum(axis=1), 1, rtol=1e-6)
    assert np.array_equal(votes(proba, np.ones(5, dtype=int)), proba)
