"""Gesture-level features against loops, the autoencoder, and likelihoods of standardised observations."""

import numpy as np
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
