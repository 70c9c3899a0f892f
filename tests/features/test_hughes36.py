"""Gesture-level features against loops, hidden Markov models against sums over all paths, and the autoencoder."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import norm

from bench.features import hughes36
from bench.features.hmm import GaussianHMMs
from bench.features.hughes36 import Hughes36, frame_moments
from tests.features.captures import GRIDS, corpus_of, near, strongest


def quick(**parameters):
    return Hughes36(**{"states": 2, "iterations": 2, "epochs": 1, **parameters})


def naive(frames, rate, full_scale):
    """Gesture-level features of one capture."""
    P, T = frames.reshape(len(frames), -1).astype(float), len(frames)
    total, points = P.sum(axis=1), max(T, 64)
    spread = total.std() / P.shape[1]
    waves = [k for k in range(1, points // 2 + 1) if 0.625 <= k * rate / points <= 5]
    wave, size = strongest(total, waves, points)
    tops = [
        np.argwhere(frame == frame.max())[0] + 1 for frame in frames
    ]  # the first in reading order
    logs = [
        np.log(x + 1e-4 * full_scale) for x in ((P - P.min(axis=0)).sum() / T, spread, 2 * size / T)
    ]
    return [logs[0], spread, logs[1], wave * rate / points, logs[2], *np.mean(tops, axis=0), T]


@given(
    st.integers(0, 10_000),
    st.sampled_from(GRIDS),
    st.sampled_from([3.0, 54.0, 100.0, 135.0]),
    st.sampled_from([(0, 1023), (0, 2), (1022, 1023), (0, 0)]),
    st.booleans(),
)
def test_gesture_level_features_equal_loops(seed, grid, rate, levels, real):
    rng = np.random.default_rng(seed)
    full_scale = 1.0 if real else 1023.0
    arrays = [
        rng.integers(levels[0], levels[1] + 1, (rng.integers(1, 100), *grid)) for _ in range(3)
    ]
    arrays = [(a / 1023).astype(np.float32) if real else a.astype(np.uint16) for a in arrays]
    table = quick().extract(corpus_of(arrays, rate=rate, full_scale=full_scale))
    for i, frames in enumerate(arrays):
        near(table.iloc[i], naive(frames, rate, full_scale), rtol=1e-7)


def test_moments_by_hand():
    frames = np.zeros((2, 3, 4), np.uint16)
    frames[0, 1, 2] = 1023  # row 2, column 3
    frames[1, 0, 0], frames[1, 2, 1] = 1023, 2046  # weight 1 at (1, 1), 2 at (3, 2)
    values = frame_moments(corpus_of([frames]))
    near(values[0], [1, 3, 9, 27, 2, 6, 18, 4, 12, 8])
    near(values[1], [3, 5, 9, 17, 7, 13, 25, 19, 37, 55])


def test_the_code_is_that_of_a_network_with_sigmoids():
    frames = np.random.default_rng(0).random((5, 6))
    encoder = hughes36._train_encoder(frames.astype(np.float32), 1, 0)
    assert [w.shape for w, _ in encoder] == [(200, 6), (100, 200), (50, 100), (25, 50), (10, 25)]
    layer = frames.T
    for weight, bias in encoder[:-1]:
        layer = 1 / (1 + np.exp(-(weight @ layer + bias[:, None])))
    near(hughes36._encode_frames(frames, encoder), (encoder[-1][0] @ layer).T + encoder[-1][1])


@pytest.mark.parametrize("grid", [(8, 8), (1, 1)])
def test_everything_is_finite(grid):
    rng = np.random.default_rng(0)
    constant = [np.full((n, *grid), v, np.uint16) for n in (1, 50) for v in (0, 65535)]
    noisy = [rng.integers(0, 65536, (n, *grid)).astype(np.uint16) for n in (1, 3, 70)]
    everything = corpus_of([*constant, *noisy], full_scale=65535.0)
    for arrays, gestures in (
        ([constant[0], constant[2]], ["a", "b"]),  # nothing was ever pressed
        ([*noisy, constant[1]], ["a", "a", "a", "b"]),  # one capture of one frame
    ):
        features = quick(states=3).fit(
            corpus_of(arrays, gestures, full_scale=65535.0), np.array(gestures)
        )
        table = features.transform(everything)
        assert (
            np.isfinite(table).all(axis=None) and table.filter(like="hmm_").min(axis=None) >= -100
        )


def test_likelihoods_are_per_frame_of_what_training_frames_standardise(corpus):
    train, test = corpus[:20], corpus[20:26]
    features = quick(states=3).fit(train, train.gestures)
    table = features.transform(test)
    for kind, models, observe in (
        ("moments", features.models_[0], frame_moments),
        (
            "code",
            features.models_[1],
            lambda c: hughes36._encode_frames(hughes36._scaled_frames(c), features.encoder_),
        ),
    ):
        seen = observe(train)
        for i in range(len(test)):
            frames = (observe(test[i : i + 1]) - seen.mean(axis=0)) / seen.std(axis=0)
            expected = models.log_likelihood(frames, test.lengths[i : i + 1])[0] / test.lengths[i]
            near(table.filter(like=f"hmm_{kind}_").iloc[i], expected.clip(-100), rtol=1e-6)


def paths(models, c, frames):
    """Every path of states through one sequence with its log-probability and that of the frames together."""
    states = len(models.start_[c])
    density = norm.logpdf(frames[:, None], models.mean_[c], np.sqrt(models.variance_[c])).sum(
        axis=2
    )
    for path in itertools.product(range(states), repeat=len(frames)):
        log = np.log(models.start_[c, path[0]]) + sum(density[t, s] for t, s in enumerate(path))
        yield (
            path,
            log + sum(np.log(models.transition_[c, a, b]) for a, b in itertools.pairwise(path)),
        )


@given(st.integers(0, 10_000), st.sampled_from([0.1, 1, 30]))
def test_likelihoods_and_an_iteration_equal_sums_over_all_paths(seed, far):
    rng = np.random.default_rng(seed)
    begin = GaussianHMMs(2, 1)
    begin.start_, begin.transition_ = rng.dirichlet([1, 1], 2), rng.dirichlet([1, 1], (2, 2))
    begin.mean_, begin.variance_ = rng.normal(size=(2, 2, 2)), rng.uniform(0.1, 2, (2, 2, 2))
    lengths, classes = np.array([3, 1, 5, 2, 4, 5, 2]), np.array([1, 0, 1, 0, 0, 1, 1])
    frames = far * rng.normal(size=(lengths.sum(), 2))
    sequences = np.split(frames, np.cumsum(lengths)[:-1])
    every = [[list(paths(begin, c, sequence)) for c in range(2)] for sequence in sequences]
    logs = np.array([[logsumexp([log for _, log in each]) for each in both] for both in every])
    near(begin.log_likelihood(frames, lengths), logs, rtol=1e-9)
    if far > 1:  # one state may have all the weight
        return
    models = GaussianHMMs(2, 1)
    models._initialise_models = lambda parts: vars(models).update(
        {k: v.copy() for k, v in vars(begin).items() if k[-1] == "_"}
    )
    models.fit(frames, lengths, classes)
    for c in range(2):
        mine = np.flatnonzero(classes == c)
        start, moves, weight, first, second = (
            np.zeros(2),
            np.zeros((2, 2)),
            np.zeros(2),
            np.zeros((2, 2)),
            0,
        )
        for i, (path, log) in ((number, one) for number in mine for one in every[number][c]):
            share = np.exp(log - logs[i, c])
            start[path[0]] += share
            for a, b in itertools.pairwise(path):
                moves[a, b] += share
            for t, s in enumerate(path):
                weight[s] += share
                first[s] += share * sequences[i][t]
                second = second + share * np.outer(np.arange(2) == s, sequences[i][t] ** 2)
        assume(weight.min() > 0.01 and moves.sum(axis=1).min() > 0.01)
        mean = first / weight[:, None]
        assert models.history_[0, c] == pytest.approx(logs[mine, c].sum())
        near(models.start_[c], start / start.sum(), atol=2e-6)
        near(models.transition_[c], moves / moves.sum(axis=1, keepdims=True), atol=2e-6)
        near(models.mean_[c], mean)
        near(models.variance_[c], np.maximum(second / weight[:, None] - mean**2, 1e-3), rtol=1e-7)
