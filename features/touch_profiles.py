"""The features of touch, and how the pressure of rows and columns goes on and moves."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, shared_frames
from bench.features.touch import TouchFeatures, equal_length_batches

PROFILE_LAGS_S = (0.0, 0.02, 0.04, 0.06, 0.08, 0.11, 0.15, 0.2, 0.28, 0.37)
MOVED_LAGS_S = (0.02, 0.04, 0.08, 0.15, 0.28)  # also with the lines on both sides
# Lag in seconds, and lines from the earlier to the later one; at no lag both sides are the same.
PROFILE_PAIRS = (
    *((lag, 0) for lag in PROFILE_LAGS_S),
    (0.0, 1),
    *((lag, shift) for lag in MOVED_LAGS_S for shift in (1, -1)),
)
COVARIANCE_SCALE = 1.8e-7  # of full scale squared, from which on the logarithm compresses


class TouchProfiles(TouchFeatures):
    """The 427 features of ``touch``, and 42 covariances that noise hardly changes.

    A profile is the mean pressure of each row, or of each column, as shares of full scale. Its
    covariances over time are taken between a line and itself at ten lags from 0 to 370 ms, and
    between a line and the next or previous one at no lag and at five lags from 20 to 280 ms; each
    is the mean over all lines. White noise adds to the first of them alone, and little, as a line
    has many taxels. The values are inverse hyperbolic sines, so logarithms that may be negative.
    """

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture [captures, 469], float32."""
        table = np.zeros((len(corpus), len(profile_names())), dtype=np.float32)
        if len(corpus):
            stored, starts = shared_frames(corpus)
            for rows in equal_length_batches(corpus):
                frames = starts[rows][:, None] + np.arange(corpus.lengths[rows[0]])
                shares = stored[frames].astype(np.float32) / np.float32(corpus.full_scale)
                table[rows] = profile_covariances(shares, corpus.rate_hz)
        covariances = pd.DataFrame(table, columns=profile_names(), copy=False)
        return pd.concat([super().extract(corpus), covariances], axis=1)

    def keeps(self, frames: int, taxels: int) -> int:
        """Count the profiles, of a square grid, besides what ``touch`` keeps."""
        return super().keeps(frames, taxels) + 2 * frames * int(np.ceil(np.sqrt(taxels)))


@cache
def profile_names() -> pd.Index:
    """Names of the covariances, those of rows first."""
    sides = {0: "", 1: "_next", -1: "_previous"}
    names = [f"after_{round(1000 * lag)}_ms{sides[shift]}" for lag, shift in PROFILE_PAIRS]
    return pd.Index([f"{lines}_{name}" for lines in ("rows", "cols") for name in names])


def pair_frames(rate_hz: float) -> list[int]:
    """Lags of `PROFILE_PAIRS` in frames."""
    return [max(1, round(lag * rate_hz)) if lag else 0 for lag, _ in PROFILE_PAIRS]


def profile_covariances(shares: np.ndarray, rate_hz: float) -> np.ndarray:
    """Covariances [captures, 42] of captures of equal length.

    Args:
        shares: shares of full scale [captures, frames, rows, cols].
        rate_hz: frames per second.
    """
    columns = []
    for axis in (3, 2):
        profile = shares.mean(axis=axis, dtype=np.float64)
        profile -= profile.mean(axis=1, keepdims=True)
        frames, lines = profile.shape[1:]
        for lag, (_, shift) in zip(pair_frames(rate_hz), PROFILE_PAIRS, strict=True):
            pairs = max(frames - lag, 0) * (lines - abs(shift))
            earlier = profile[:, : max(frames - lag, 0), max(-shift, 0) : lines - max(shift, 0)]
            later = profile[:, lag:, max(shift, 0) : lines - max(-shift, 0)]
            sums = np.einsum("wfl,wfl->w", earlier, later)
            columns.append(np.arcsinh(sums / max(pairs, 1) / COVARIANCE_SCALE))
    return np.column_stack(columns)
