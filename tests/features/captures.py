"""Small ragged captures for the tests of feature sets."""

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus

GRIDS = [(8, 8), (3, 5), (5, 1), (1, 4), (1, 1)]
# Lowest and highest reading, full scale: typical sensors, and readings that are hard for float32.
LEVELS = {
    "10 bit": (0, 1023, 1023.0),
    "few levels": (0, 3, 60.0),  # 5 % are 3
    "some touch": (40, 120, 1020.0),  # 5 % are 51
    "saturated": (1022, 1023, 1023.0),
    "16 bit": (0, 65535, 65535.0),
    "saturated 16 bit": (65534, 65535, 65535.0),
}


def corpus_of(arrays, gestures=None, rate=100.0, full_scale=1023.0, subject="1", **columns):
    table = pd.DataFrame(
        {"subject": subject, "gesture": gestures or "pat", **columns}, index=range(len(arrays))
    )
    return Corpus.from_captures(arrays, table, rate, full_scale=full_scale)


def row_of(features, frames, rate=100.0, full_scale=1023.0):
    """Features of one capture."""
    return features.fit_transform(corpus_of([np.asarray(frames)], None, rate, full_scale)).iloc[0]


def ragged_frames(seed, grid, low=0, high=1023):
    """Captures of different lengths; some frames are untouched, others partly touched."""
    rng = np.random.default_rng(seed)
    arrays = []
    for length in (2, 18, 1, 3 + seed % 7):
        touched = rng.random((length, *grid)) < 2 * rng.random((length, 1, 1)) - 0.3
        arrays.append((rng.integers(low, high + 1, (length, *grid)) * touched).astype(np.uint16))
    return arrays


def assert_near(values, expected, rtol=1e-5, atol=1e-9):
    values, expected = np.asarray(values, float), np.asarray(expected, float)
    np.testing.assert_allclose(values, expected, rtol=rtol, atol=atol)


def strongest_wave(signal, waves, points):
    """Number and size of the strongest of some waves: the slowest of equal ones; 0 if constant."""
    number, size = 0, 0.0
    for wave in waves if np.ptp(signal) > 1e-9 else []:
        turns = np.exp(-2j * np.pi * wave * np.arange(len(signal)) / points)
        amplitude = abs((signal - signal.mean()) @ turns)
        if amplitude > size * (1 + 1e-9):
            number, size = wave, amplitude
    return number, size
