"""Gesture-level features against loops, the autoencoder, and likelihoods of standardised observations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.features import hughes36
from bench.features.hughes36 import Hughes36, moments
from tests.features.captures import GRIDS, corpus_of, near


def quick(**parameters):
    return Hughes36(**{"states": 2, "iterations": 2, "epochs": 1, **parameters})


def naive(frames, rate, full_scale):
    """Gesture-level features of one capture."""
    P, T = frames.reshape(len(frames), -1).astype(float), len(frames)
    total, floor = P.sum(axis=1), 1e-4 * full_scale
    spread = total.std() / P.shape[1]
    points, best, frequency = max(T, 64), 0.0, 0.0
    for k in range(1, points // 2 + 1):
        if 0.625 <= k * rate / points <= 5:
            wave = sum((total[t] - total.mean()) * np.exp(-2j * np.pi * k * t / points) for t in range(T))
            if abs(wave) > best * (1 + 1e-9) and np.ptp(total) > 1e-9 * full_scale:
                best, frequency = abs(wave), k * rate / points
    tops = [np.argwhere(frame == frame.max())[0] + 1 for frame in frames]  # the first in reading order
    logs = [np.log(x + floor) for x in ((P - P.min(axis=0)).sum() / T, spread, 2 * best / T)]
    return [logs[0], spread, logs[1], frequency, logs[2], *np.mean(tops, axis=0), T]


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
    arrays = [rng.integers(levels[0], levels[1] + 1, (rng.integers(1, 100), *grid)) for _ in range(3)]
    arrays = [(a / 1023).astype(np.float32) if real else a.astype(np.uint16) for a in arrays]
    table = quick().extract(corpus_of(arrays, rate=rate, full_scale=full_scale))
    for i, frames in enumerate(arrays):
        near(table.iloc[i], naive(frames, rate, full_scale), rtol=1e-7)


def test_moments_by_hand():
    frames = np.zeros((2, 3, 4), np.uint16)
    frames[0, 1, 2] = 1023  # row 2, column 3
    frames[1, 0, 0], frames[1, 2, 1] = 1023, 2046  # weight 1 at (1, 1), 2 at (3, 2)
    values = moments(corpus_of([frames]))
    near(values[0], [1, 3, 9, 27, 2, 6, 18, 4, 12, 8])
    near(values[1], [3, 5, 9, 17, 7, 13, 25, 19, 37, 55])


def test_the_code_is_that_of_a_network_with_sigmoids():
    frames = np.random.default_rng(0).random((5, 6))
    encoder = hughes36._encoder(frames.astype(np.float32), 1, 0)
    assert [w.shape for w, _ in encoder] == [(200, 6), (100, 200), (50, 100), (25, 50), (10, 25)]
    layer = frames.T
    for weight, bias in encoder[:-1]:
        layer = 1 / (1 + np.exp(-(weight @ layer + bias[:, None])))
    near(hughes36._code(frames, encoder), (encoder[-1][0] @ layer).T + encoder[-1][1])


@pytest.mark.parametrize("grid", [(8, 8), (1, 1)])
@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_everything_is_finite(grid, kind):
    rng = np.random.default_rng(0)
    constant = [np.full((n, *grid), v, kind) for n in (1, 2, 50) for v in (0, 7, 65535)]
    noisy = [rng.integers(0, 65536, (n, *grid)).astype(kind) for n in (1, 3, 70)]
    everything = corpus_of([*constant, *noisy], full_scale=65535.0)
    for arrays, gestures in (
        ([*constant, *noisy], ["a", "b"] * 6),
        ([np.zeros((n, *grid), kind) for n in (1, 4)], ["a", "b"]),  # nothing was ever pressed
        ([*noisy, constant[2]], ["a", "a", "a", "b"]),  # one capture of one frame
    ):
        features = quick(states=3).fit(corpus_of(arrays, gestures, full_scale=65535.0), np.array(gestures))
        table = features.transform(everything)
        assert np.isfinite(table).all(axis=None) and table.filter(like="hmm_").min(axis=None) >= -100


def test_likelihoods_are_per_frame_of_what_training_frames_standardise(corpus):
    train, test = corpus[:20], corpus[20:]
    features = quick(states=3).fit(train, train.gestures)
    table = features.transform(test)
    for kind, models, observe in (
        ("moments", features.models_[0], moments),
        ("code", features.models_[1], lambda c: hughes36._code(hughes36._values(c), features.encoder_)),
    ):
        seen = observe(train)
        for i in range(len(test)):
            frames = (observe(test[i : i + 1]) - seen.mean(axis=0)) / seen.std(axis=0)
            expected = models.log_likelihood(frames, test.lengths[i : i + 1])[0] / test.lengths[i]
            near(table.filter(like=f"hmm_{kind}_").iloc[i], expected.clip(-100), rtol=1e-6)
