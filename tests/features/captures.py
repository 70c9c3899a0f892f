"""Small ragged captures for the tests of feature sets."""

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus

GRIDS = [(8, 8), (3, 5), (5, 1), (1, 4), (1, 1)]
LEVELS = {  # lowest and highest value, full scale: typical sensors, and values that are hard for float32
    "10 bit": (0, 1023, 1023.0),
    "few levels": (0, 3, 60.0),  # 5 % are 3
    "some touch": (40, 120, 1020.0),  # 5 % are 51
    "saturated": (1022, 1023, 1023.0),
    "16 bit": (0, 65535, 65535.0),
    "saturated 16 bit": (65534, 65535, 65535.0),
}


def corpus_of(arrays, gestures=None, rate=100.0, full_scale=1023.0):
    captures = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": gestures or ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, captures, rate, full_scale=full_scale)


def row_of(features, frames, rate=100.0, full_scale=1023.0):
    """Features of one capture."""
    return features.fit_transform(corpus_of([np.asarray(frames)], None, rate, full_scale)).iloc[0]


def ragged(seed, grid, low=0, high=1023, longest=20, lengths=None):
    """Captures of random length; some frames are untouched, others partly touched."""
    rng = np.random.default_rng(seed)
    arrays = []
    for length in rng.integers(1, longest + 1, 3) if lengths is None else lengths:
        touched = rng.random((length, *grid)) < 2 * rng.random((length, 1, 1)) - 0.3
        arrays.append((rng.integers(low, high + 1, (length, *grid)) * touched).astype(np.uint16))
    return arrays


def near(values, expected, rtol=1e-5, atol=1e-9):
    np.testing.assert_allclose(np.asarray(values, float), np.asarray(expected, float), rtol=rtol, atol=atol)
