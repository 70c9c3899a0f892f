"""Gesture-level features against loops, hidden Markov models against sums over all paths."""

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
from tests.features.captures import GRIDS, assert_near, corpus_of, strongest_wave


def quick_hughes36(**parameters):
    return Hughes36(**{"states": 2, "iterations": 2, "epochs": 1, **parameters})


def gesture_level_features(frames, rate, full_scale):
    """Features g1-g8 of one capture."""
    P, T = frames.reshape(len(frames), -1).astype(float), len(frames)
    total, points = P.sum(axis=1), max(T, 64)
    spread = total.std() / P.shape[1]
    waves = [k for k in range(1, points // 2 + 1) if 0.625 <= k * rate / points <= 5]
    wave, size = strongest_wave(total, waves, points)
    maxima = [np.argwhere(frame == frame.max())[0] + 1 for frame in frames]  # in reading order
    level = (P - P.min(axis=0)).sum() / T
    logs = np.log(np.array([level, spread, 2 * size / T]) + 1e-4 * full_scale)
    return [logs[0], spread, logs[1], wave * rate / points, logs[2], *np.mean(maxima, axis=0), T]


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
    shapes = [(rng.integers(1, 100), *grid) for _ in range(3)]
    arrays = [rng.integers(levels[0], levels[1] + 1, shape).astype(np.uint16) for shape in shapes]
    if real:
        arrays = [(array / 1023).astype(np.float32) for array in arrays]
    table = quick_hughes36().extract(corpus_of(arrays, rate=rate, full_scale=full_scale))
    for i, frames in enumerate(arrays):
        assert_near(table.iloc[i], gesture_level_features(frames, rate, full_scale), rtol=1e-7)


def test_moments_by_hand():
    frames = np.zeros((2, 3, 4), np.uint16)
    frames[0, 1, 2] = 1023  # row 2, column 3
    frames[1, 0, 0], frames[1, 2, 1] = 1023, 2046  # weight 1 at (1, 1), 2 at (3, 2)
    values = frame_moments(corpus_of([frames]))
    assert_near(values[0], [1, 3, 9, 27, 2, 6, 18, 4, 12, 8])
    assert_near(values[1], [3, 5, 9, 17, 7, 13, 25, 19, 37, 55])


def test_the_code_is_that_of_a_network_with_sigmoids():
    frames = np.random.default_rng(0).random((5, 6))
    encoder = hughes36._train_encoder(frames.astype(np.float32), 1, 0)
    assert [w.shape for w, _ in encoder] == [(200, 6), (100, 200), (50, 100), (25, 50), (10, 25)]
    layer = frames.T
    for weight, bias in encoder[:-1]:
        layer = 1 / (1 + np.exp(-(weight @ layer + bias[:, None])))
    assert_near(
        hughes36._encode_frames(frames, encoder), (encoder[-1][0] @ layer).T + encoder[-1][1]
    )


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
        corpus = corpus_of(arrays, gestures, full_scale=65535.0)
        table = quick_hughes36(states=3).fit(corpus, np.array(gestures)).transform(everything)
        assert np.isfinite(table).all(axis=None)
        assert table.filter(like="hmm_").min(axis=None) >= -100


def test_likelihoods_are_per_frame_of_what_training_frames_standardise(corpus):
    train, test = corpus[:20], corpus[20:26]
    features = quick_hughes36(states=3).fit(train, train.gestures)
    table = features.transform(test)
    observers = features._observation_functions()
    for kind, models, observe in zip(("moments", "code"), features.models_, observers, strict=True):
        seen = observe(train)
        for i in range(len(test)):
            frames = (observe(test[i : i + 1]) - seen.mean(axis=0)) / seen.std(axis=0)
            expected = models.log_likelihood(frames, test.lengths[i : i + 1])[0] / test.lengths[i]
            assert_near(table.filter(like=f"hmm_{kind}_").iloc[i], expected.clip(-100), rtol=1e-6)


def paths(models, c, frames):
    """Every path of states through a sequence, with the log-probability of path and frames."""
    states, sd = len(models.start_[c]), np.sqrt(models.variance_[c])
    density = norm.logpdf(frames[:, None], models.mean_[c], sd).sum(axis=2)
    for path in itertools.product(range(states), repeat=len(frames)):
        log = np.log(models.start_[c, path[0]]) + sum(density[t, s] for t, s in enumerate(path))
        moves = [models.transition_[c, a, b] for a, b in itertools.pairwise(path)]
        yield path, log + np.sum(np.log(moves))


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
    likelihood = lambda some_paths: logsumexp([log for _, log in some_paths])  # noqa: E731
    logs = np.array([list(map(likelihood, both)) for both in every])
    assert_near(begin.log_likelihood(frames, lengths), logs, rtol=1e-9)
    if far > 1:  # one state may have all the weight
        return
    models = GaussianHMMs(2, 1)
    start_values = {k: v.copy() for k, v in vars(begin).items() if k[-1] == "_"}
    models._initialise_models = lambda parts: vars(models).update(start_values)
    models.fit(frames, lengths, classes)
    for c in range(2):
        mine = np.flatnonzero(classes == c)
        start, weight, moves, first = (np.zeros(shape) for shape in (2, 2, (2, 2), (2, 2)))
        second = 0
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
        assert_near(models.start_[c], start / start.sum(), atol=2e-6)
        assert_near(models.transition_[c], moves / moves.sum(axis=1, keepdims=True), atol=2e-6)
        assert_near(models.mean_[c], mean)
        assert_near(
            models.variance_[c], np.maximum(second / weight[:, None] - mean**2, 1e-3), rtol=1e-7
        )
