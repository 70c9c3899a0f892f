"""Signals of ragged captures that feature sets share: one value per frame, then one per capture.

A `Touch` holds consecutive captures as one array of frames. Its properties are signals, float64
[frames] or [frames, n]; its methods reduce signals to [captures]. Steps (differences between
consecutive frames) are 0 in the first frame of a capture. The values of a capture do not depend, to
the last bit, on the captures computed with it: counts, such as that of temporal peaks, would turn a
rounding error into a whole peak.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from itertools import pairwise, product

import numpy as np
import pandas as pd
from scipy.fft import rfft

from bench.corpora.corpus import Corpus, shared_frames


class Touch:
    """Frames of some captures of a corpus, and signals computed from single frames.

    Attributes:
        frames: float32 (integer corpora, while it holds sums over the taxels exactly) or float64
            [frames, taxels].
        integer: True if readings are whole numbers.
        values: readings to compare with thresholds [frames, taxels]: unchanged integers, otherwise
            ``frames``.
        lengths: int64 [captures].
        starts: int64 [captures], position of each capture's first frame.
    """

    def __init__(self, corpus: Corpus) -> None:
        self.grid = corpus.grid
        self.full_scale = corpus.full_scale
        self.rate_hz = corpus.rate_hz
        self.lengths = corpus.lengths
        self.starts = np.cumsum(corpus.lengths) - corpus.lengths
        stored, starts = shared_frames(corpus)
        begin, end = starts[0], starts[0] + self.lengths.sum()
        if np.array_equal(starts, begin + self.starts):
            raw = stored[begin:end]
        else:
            raw = np.concatenate([corpus[i] for i in range(len(corpus))])
        raw = raw.reshape(len(raw), -1)
        self.integer = raw.dtype.kind in "iu"
        exact = self.integer and corpus.full_scale * raw.shape[1] <= 2**24
        self.frames = raw.astype(np.float32 if exact else np.float64)
        self.values = raw if self.integer else self.frames

    @property
    def taxels(self) -> int:
        """Number of taxels."""
        return self.frames.shape[1]

    @cached_property
    def capture_of_frame(self) -> np.ndarray:
        """Capture that each frame belongs to, int64 [frames]."""
        return np.repeat(np.arange(len(self.lengths)), self.lengths)

    @cached_property
    def step_counts(self) -> np.ndarray:
        """Number of steps of each capture, at least 1 for divisions."""
        return np.maximum(self.lengths - 1, 1)

    def sum(self, signal: np.ndarray) -> np.ndarray:
        """Sum over the frames of each capture."""
        return np.add.reduceat(signal, self.starts, axis=0, dtype=np.float64)

    def mean(self, signal: np.ndarray) -> np.ndarray:
        """Mean over the frames of each capture."""
        return (self.sum(signal).T / self.lengths).T

    def variance(self, signal: np.ndarray) -> np.ndarray:
        """Population variance over the frames of each capture."""
        return self.mean((signal - self.mean(signal)[self.capture_of_frame]) ** 2)

    def value_range(self, signal: np.ndarray) -> np.ndarray:
        """Range over the frames of each capture."""
        highest = np.maximum.reduceat(signal, self.starts)
        return highest - np.minimum.reduceat(signal, self.starts)

    def sorted_within_captures(self, signals: np.ndarray) -> np.ndarray:
        """Signals [n, frames] with the values of each capture in ascending order."""
        ordered = signals.copy()
        # A radix sort of 16-bit integers is three times as fast as the default.
        kind = "stable" if signals.itemsize == 2 else None
        for start, length in zip(self.starts.tolist(), self.lengths.tolist(), strict=True):
            ordered[:, start : start + length].sort(axis=1, kind=kind)
        return ordered

    def step_mean(self, signal: np.ndarray) -> np.ndarray:
        """Mean over the steps of each capture of a signal of steps; 0 for one frame."""
        return self.sum(signal) / self.step_counts

    def step_variance(self, signal: np.ndarray) -> np.ndarray:
        """Population variance over the steps of each capture; 0 for one frame."""
        square = (signal - self.step_mean(signal)[self.capture_of_frame]) ** 2
        square[self.starts] = 0  # a first frame is no step
        return self.step_mean(square)

    def frame_differences(self, signal: np.ndarray) -> np.ndarray:
        """Difference to the frame before, 0 in the first frame of a capture."""
        change = np.empty_like(signal)
        change[0] = 0
        np.subtract(signal[1:], signal[:-1], out=change[1:])
        change[self.starts] = 0
        return change

    @cached_property
    def _sums(self) -> np.ndarray:
        """Sums of each row and column of each frame [frames, rows + cols]."""
        if self.integer:  # sums are exact: the order of additions in a matrix product has no effect
            membership = _row_and_column_matrix(*self.grid, self.frames.dtype)
            return (self.frames @ membership).astype(np.float64)
        frames = self.frames.reshape(-1, *self.grid)
        return np.concatenate([frames.sum(axis=2), frames.sum(axis=1)], axis=1)

    @property
    def rows(self) -> np.ndarray:
        """Sum of each row [frames, rows]."""
        return self._sums[:, : self.grid[0]]

    @property
    def cols(self) -> np.ndarray:
        """Sum of each column [frames, cols]."""
        return self._sums[:, self.grid[0] :]

    @cached_property
    def total(self) -> np.ndarray:
        """Sum over the taxels of each frame."""
        return row_sums(self.rows)

    @cached_property
    def peak(self) -> np.ndarray:
        """Largest reading of each frame."""
        return self.values.max(axis=1).astype(np.float64)

    @cached_property
    def change(self) -> np.ndarray:
        """Sum over the taxels of the absolute step."""
        step = self.frame_differences(self.frames)
        np.abs(step, out=step)
        return row_sums(step).astype(np.float64)

    @cached_property
    def centre(self) -> np.ndarray:
        """Centre of mass [frames, 2], row and column from 1; the middle if nothing is pressed."""
        pressed = self.total > 0
        middle = (np.array(self.grid) + 1) / 2
        sides = (self.rows, self.cols)
        positions = [np.arange(1.0, side.shape[1] + 1) for side in sides]
        moment = np.stack(list(map(row_dot_products, sides, positions)), axis=1)
        divisor = np.where(pressed, self.total, 1)[:, None]
        return np.where(pressed[:, None], moment / divisor, middle)

    @cached_property
    def travel(self) -> np.ndarray:
        """Step of the centre of mass [frames, 2], in rows and columns."""
        return self.frame_differences(self.centre)

    @cached_property
    def area(self) -> np.ndarray:
        """Share of taxels above half of the frame's largest reading."""
        return self.share_above(self.peak * 0.5)

    def share_above(self, threshold: np.ndarray) -> np.ndarray:
        """Share of the taxels of each frame above a threshold per frame."""
        above = self.values > self.as_threshold(threshold)[:, None]
        return np.count_nonzero(above, axis=1) / self.taxels

    def histogram(self, bins: int) -> list[np.ndarray]:
        """Share of each capture's readings in equal bins from 0 to full scale, an array per bin."""
        samples = self.lengths * self.taxels
        above = [samples]
        for i in range(1, bins):
            edge = self.full_scale * i / bins
            limit = self.values.dtype.type(np.ceil(edge) if self.integer else edge)
            above.append(self.sum(np.count_nonzero(self.values >= limit, axis=1)))
        above.append(np.zeros_like(samples))
        return [(low - high) / samples for low, high in zip(above[:-1], above[1:], strict=True)]

    def as_threshold(self, threshold: np.ndarray) -> np.ndarray:
        """Thresholds (not negative) in the type of ``values``.

        A whole number exceeds t if it exceeds floor(t).
        """
        if not self.integer:
            return threshold
        return np.floor(threshold).astype(self.values.dtype)

    def find_spatial_peaks(self, threshold: np.ndarray) -> tuple[np.ndarray, ...]:
        """Find local maxima above a threshold per frame.

        A taxel is a maximum if it exceeds its neighbours (of 8) that come before it in reading
        order, and is not less than those after it, so a plateau counts once, by its first taxel.

        Returns:
            Frame, row and column (from 0) of every peak.
        """
        rows, cols = self.grid
        wide = cols + 1
        # With a border of zeros to the right and below, each neighbour is at a fixed distance in
        # one flat array, across rows and frames. Zeros are above no threshold, so the border is no
        # peak and hides none.
        bordered = np.zeros((len(self.values), rows + 1, wide), dtype=self.values.dtype)
        bordered[:, :rows, :cols] = self.values.reshape(-1, rows, cols)
        keep = (bordered > self.as_threshold(threshold)[:, None, None]).ravel()
        flat = bordered.ravel()
        for distance in (1, wide - 1, wide, wide + 1):
            wins = flat[:-distance] >= flat[distance:]
            keep[:-distance] &= wins
            keep[distance:] &= ~wins
        frame, taxel = np.divmod(np.flatnonzero(keep), (rows + 1) * wide)
        return frame, *np.divmod(taxel, wide)

    def value_at_highest_total(self, signal: np.ndarray) -> np.ndarray:
        """Value of a signal in the first frame with the highest total of each capture."""
        highest = np.maximum.reduceat(self.total, self.starts)
        frames = np.flatnonzero(self.total == highest[self.capture_of_frame])
        _, position = np.unique(self.capture_of_frame[frames], return_index=True)
        return signal[frames[position]]

    def count_local_maxima(self, signal: np.ndarray) -> np.ndarray:
        """Number of frames of each capture whose value exceeds both neighbours in time."""
        up = self.frame_differences(signal) > 0
        down = np.zeros(len(signal), dtype=bool)
        down[:-1] = signal[1:] < signal[:-1]
        down[self.starts + self.lengths - 1] = False
        return self.sum(up & down)

    def count_upward_crossings(self, signal: np.ndarray, threshold: np.ndarray) -> np.ndarray:
        """Number of steps of each capture from at or below its threshold to above it."""
        above = signal > threshold[self.capture_of_frame]
        crossing = np.zeros(len(signal), dtype=bool)
        crossing[1:] = above[1:] & ~above[:-1]
        crossing[self.starts] = False
        return self.sum(crossing)

    def dominant_frequency(self, signals: np.ndarray) -> np.ndarray:
        """Frequency (Hz) of the largest amplitude of each signal [frames, n]; 0 if it is constant.

        Means are removed first. Of equal amplitudes, such as those of an impulse, the lowest
        frequency counts: rounding must not choose.
        """
        centred = signals - self.mean(signals)[self.capture_of_frame]
        bins = np.zeros((len(self.lengths), signals.shape[1]))
        for i in np.flatnonzero(self.lengths > 1):
            part = centred[self.starts[i] : self.starts[i] + self.lengths[i]]
            amplitude = np.abs(rfft(part, axis=0)[1:])
            bins[i] = (amplitude >= amplitude.max(axis=0) * (1 - 1e-9)).argmax(axis=0) + 1
        varies = self.value_range(signals) > 1e-9
        return np.where(varies, bins * self.rate_hz / self.lengths[:, None], 0)


def row_dot_products(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted sum of each row [rows, n], added in the same order however many rows there are."""
    return np.einsum("ij,j->i", values, weights)


def row_sums(values: np.ndarray) -> np.ndarray:
    """Sum of each row [rows, n], added in the same order however many rows there are."""
    return row_dot_products(values, np.ones(values.shape[1], dtype=values.dtype))


def taxel_names(rows: int, cols: int) -> list[str]:
    """``r1c1``, ``r1c2``, ... in reading order."""
    return [f"r{r}c{c}" for r, c in product(range(1, rows + 1), range(1, cols + 1))]


@cache
def _row_and_column_matrix(rows: int, cols: int, dtype: np.dtype) -> np.ndarray:
    """Row and column of each taxel, as 0 or 1 [taxels, rows + cols]."""
    sides = [np.kron(np.eye(rows), np.ones((cols, 1))), np.kron(np.ones((rows, 1)), np.eye(cols))]
    return np.concatenate(sides, axis=1).astype(dtype)


def capture_blocks(corpus: Corpus, values: int = 2**20) -> list[slice]:
    """Slices of consecutive captures of about so many readings, so that intermediates stay small.

    A block has at least one capture.
    """
    group = np.cumsum(corpus.lengths) // max(values // (corpus.grid[0] * corpus.grid[1]), 1)
    edges = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), len(corpus)]
    return [slice(a, b) for a, b in pairwise(edges) if a < b]


def feature_table(
    corpus: Corpus, names: pd.Index, columns: Callable[[Touch], list[np.ndarray]]
) -> pd.DataFrame:
    """Compute ``columns(touch)`` of blocks of captures, as a table with these column names."""
    parts = [np.column_stack(columns(Touch(corpus[block]))) for block in capture_blocks(corpus)]
    return pd.DataFrame(np.concatenate([np.empty((0, len(names))), *parts]), columns=names)
