"""Signals of ragged captures that feature sets share: one value per frame, then one per capture.

A `Touch` holds a run of captures as one array of frames. Its properties are signals, float64 [frames] or [frames, n];
its methods reduce signals to [captures]. Steps (differences between consecutive frames) are 0 in the first frame of a
capture. What a capture gets does not depend, to the last bit, on the captures that it is computed with: a count such
as that of temporal peaks would turn a rounding error into a whole peak.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from itertools import pairwise, product

import numpy as np
import pandas as pd
from scipy.fft import rfft

from bench.corpora.corpus import Corpus, storage


class Touch:
    """Frames of some captures of a corpus, and values computed from single frames.

    Attributes:
        frames: float32 (integer corpora, while it holds sums over the taxels exactly) or float64 [frames, taxels].
        integer: True if sensor values are whole numbers.
        values: values compared with thresholds [frames, taxels]: integers unchanged, otherwise ``frames``.
        lengths: int64 [captures].
        first: int64 [captures], position of each capture's first frame.
    """

    def __init__(self, corpus: Corpus) -> None:
        self.grid = corpus.grid
        self.full_scale = corpus.full_scale
        self.rate_hz = corpus.rate_hz
        self.lengths = corpus.lengths
        self.first = np.cumsum(corpus.lengths) - corpus.lengths
        stored, starts = storage(corpus)
        begin, end = starts[0], starts[0] + self.lengths.sum()
        if np.array_equal(starts, begin + self.first):
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
    def capture(self) -> np.ndarray:
        """Capture that each frame belongs to, int64 [frames]."""
        return np.repeat(np.arange(len(self.lengths)), self.lengths)

    @cached_property
    def steps(self) -> np.ndarray:
        """Number of steps of each capture, at least 1 so that one can divide by it."""
        return np.maximum(self.lengths - 1, 1)

    def sum(self, signal: np.ndarray) -> np.ndarray:
        """Sum over the frames of each capture."""
        return np.add.reduceat(signal, self.first, axis=0, dtype=np.float64)

    def mean(self, signal: np.ndarray) -> np.ndarray:
        """Mean over the frames of each capture."""
        return (self.sum(signal).T / self.lengths).T

    def variance(self, signal: np.ndarray) -> np.ndarray:
        """Population variance over the frames of each capture."""
        return self.mean((signal - self.mean(signal)[self.capture]) ** 2)

    def ascending(self, signals: np.ndarray) -> np.ndarray:
        """Signals [n, frames] with the values of each capture in ascending order."""
        ordered = signals.copy()
        for first, length in zip(self.first.tolist(), self.lengths.tolist(), strict=True):
            # a radix sort of 16-bit integers, three times as fast as the default
            ordered[:, first : first + length].sort(
                axis=1, kind="stable" if signals.itemsize == 2 else None
            )
        return ordered

    def step_mean(self, signal: np.ndarray) -> np.ndarray:
        """Mean over the steps of each capture of a signal that is 0 in first frames; 0 for one frame."""
        return self.sum(signal) / self.steps

    def step(self, signal: np.ndarray) -> np.ndarray:
        """Difference to the frame before, 0 in the first frame of a capture."""
        change = np.empty_like(signal)
        change[0] = 0
        np.subtract(signal[1:], signal[:-1], out=change[1:])
        change[self.first] = 0
        return change

    @cached_property
    def _sums(self) -> np.ndarray:
        """Sums of each row and column of each frame [frames, rows + cols]."""
        if self.integer:  # exact, so that the order in which a matrix product adds does not matter
            return (self.frames @ _membership(*self.grid, self.frames.dtype)).astype(np.float64)
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
        return weighted(self.rows)

    @cached_property
    def peak(self) -> np.ndarray:
        """Largest value of each frame."""
        return self.values.max(axis=1).astype(np.float64)

    @cached_property
    def change(self) -> np.ndarray:
        """Sum over the taxels of the absolute step."""
        step = self.step(self.frames)
        np.abs(step, out=step)
        return weighted(step).astype(np.float64)

    @cached_property
    def centre(self) -> np.ndarray:
        """Centre of mass [frames, 2], row and column counted from 1; the middle where nothing is pressed."""
        pressed = self.total > 0
        middle = (np.array(self.grid) + 1) / 2
        sides = (self.rows, self.cols)
        moment = np.stack(
            [weighted(side, np.arange(1.0, side.shape[1] + 1)) for side in sides], axis=1
        )
        return np.where(
            pressed[:, None], moment / np.where(pressed, self.total, 1)[:, None], middle
        )

    @cached_property
    def travel(self) -> np.ndarray:
        """Step of the centre of mass [frames, 2] in rows and columns."""
        return self.step(self.centre)

    @cached_property
    def area(self) -> np.ndarray:
        """Share of taxels above half of the frame's largest value."""
        return self.share_above(self.peak * 0.5)

    def share_above(self, threshold: np.ndarray) -> np.ndarray:
        """Share of the taxels of each frame above a threshold per frame."""
        return np.count_nonzero(self.values > self.limit(threshold)[:, None], axis=1) / self.taxels

    def distribution(self, bins: int) -> list[np.ndarray]:
        """Share of a capture's values in each of equal bins from 0 to full scale, one array [captures] per bin."""
        samples = self.lengths * self.taxels
        above = [samples]
        for i in range(1, bins):
            edge = self.full_scale * i / bins
            limit = self.values.dtype.type(np.ceil(edge) if self.integer else edge)
            above.append(self.sum(np.count_nonzero(self.values >= limit, axis=1)))
        above.append(np.zeros_like(samples))
        return [(low - high) / samples for low, high in zip(above[:-1], above[1:], strict=True)]

    def limit(self, threshold: np.ndarray) -> np.ndarray:
        """Thresholds (not negative) in the type of ``values``: a whole number exceeds t if it exceeds floor(t)."""
        return np.floor(threshold).astype(self.values.dtype) if self.integer else threshold

    def spatial_peaks(self, threshold: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local maxima above a threshold per frame.

        A taxel is a maximum if it is greater than those of its 8 neighbours that come before it in reading order and
        not less than those after it, so that a plateau counts by its first taxel.

        Returns:
            Frame, row and column (from 0) of every peak.
        """
        rows, cols = self.grid
        wide = cols + 1
        # With a border of zeros to the right and below, a neighbour is a fixed distance away in one flat array, across
        # rows and frames. Nothing at 0 is above a threshold, so the border is no peak and hides none.
        bordered = np.zeros((len(self.values), rows + 1, wide), dtype=self.values.dtype)
        bordered[:, :rows, :cols] = self.values.reshape(-1, rows, cols)
        keep = (bordered > self.limit(threshold)[:, None, None]).ravel()
        flat = bordered.ravel()
        for distance in (1, wide - 1, wide, wide + 1):
            wins = flat[:-distance] >= flat[distance:]
            keep[:-distance] &= wins
            keep[distance:] &= ~wins
        frame, taxel = np.divmod(np.flatnonzero(keep), (rows + 1) * wide)
        return frame, *np.divmod(taxel, wide)

    def at_highest(self, signal: np.ndarray) -> np.ndarray:
        """Value of a signal in the first frame with the highest total of each capture."""
        highest = np.maximum.reduceat(self.total, self.first)
        frames = np.flatnonzero(self.total == highest[self.capture])
        _, position = np.unique(self.capture[frames], return_index=True)
        return signal[frames[position]]

    def local_maxima(self, signal: np.ndarray) -> np.ndarray:
        """Number of frames with a value greater than both neighbours in time."""
        up = self.step(signal) > 0
        down = np.zeros(len(signal), dtype=bool)
        down[:-1] = signal[1:] < signal[:-1]
        down[self.first + self.lengths - 1] = False
        return self.sum(up & down)

    def upward_crossings(self, signal: np.ndarray, threshold: np.ndarray) -> np.ndarray:
        """Number of steps from at or below a threshold per capture to above it."""
        above = signal > threshold[self.capture]
        crossing = np.zeros(len(signal), dtype=bool)
        crossing[1:] = above[1:] & ~above[:-1]
        crossing[self.first] = False
        return self.sum(crossing)

    def dominant_frequency(self, signals: np.ndarray) -> np.ndarray:
        """Frequency in Hz of the largest amplitude of each signal [frames, n] without its mean; 0 if it is constant.

        Of equal amplitudes, as a single impulse has them, the lowest frequency counts; rounding must not choose.
        """
        centred = signals - self.mean(signals)[self.capture]
        moved = np.maximum.reduceat(signals, self.first) - np.minimum.reduceat(signals, self.first)
        bins = np.zeros((len(self.lengths), signals.shape[1]))
        for i, (first, length) in enumerate(
            zip(self.first.tolist(), self.lengths.tolist(), strict=True)
        ):
            if length > 1:
                amplitude = np.abs(rfft(centred[first : first + length], axis=0)[1:])
                bins[i] = (amplitude >= amplitude.max(axis=0) * (1 - 1e-9)).argmax(axis=0) + 1
        return np.where(moved > 1e-9, bins * self.rate_hz / self.lengths[:, None], 0)


def weighted(signal: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Sum over the columns of a signal [frames, n], each times its weight; frame by frame in the same order."""
    if weights is None:
        weights = np.ones(signal.shape[1], dtype=signal.dtype)
    return np.einsum("ij,j->i", signal, weights)


def taxel_names(rows: int, cols: int) -> list[str]:
    """``r1c1``, ``r1c2``, ... in reading order."""
    return [f"r{r}c{c}" for r, c in product(range(1, rows + 1), range(1, cols + 1))]


@cache
def _membership(rows: int, cols: int, dtype: np.dtype) -> np.ndarray:
    """Which rows and columns each taxel belongs to, 0 or 1 [taxels, rows + cols]."""
    sides = [np.kron(np.eye(rows), np.ones((cols, 1))), np.kron(np.ones((rows, 1)), np.eye(cols))]
    return np.concatenate(sides, axis=1).astype(dtype)


def blocks(corpus: Corpus, values: int = 2**20) -> list[slice]:
    """Runs of captures of at most about this many sensor values, so that intermediates stay small.

    A block is never less than one capture.
    """
    group = np.cumsum(corpus.lengths) // max(values // (corpus.grid[0] * corpus.grid[1]), 1)
    edges = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), len(corpus)]
    return [slice(a, b) for a, b in pairwise(edges) if a < b]


def table(
    corpus: Corpus, names: pd.Index, columns: Callable[[Touch], list[np.ndarray]]
) -> pd.DataFrame:
    """Run ``columns(touch)`` over blocks of captures and name its columns."""
    parts = [np.column_stack(columns(Touch(corpus[block]))) for block in blocks(corpus)]
    return pd.DataFrame(np.concatenate([np.empty((0, len(names))), *parts]), columns=names)
