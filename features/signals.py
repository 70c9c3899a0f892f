"""Signals of ragged captures that feature sets share: one value per frame, then one per capture.

A `Touch` holds a run of captures as one array of frames. Per-frame signals are float64 [frames]; ``per_capture_*``
reduce them to [captures]. Steps (differences between consecutive frames) are 0 in the first frame of a capture.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.fft import rfft

from bench.corpus import Corpus


class Touch:
    """Frames of some captures of a corpus, and what can be read off each frame.

    Attributes:
        frames: float32 (integer corpora, whose sums it holds exactly) or float64 [frames, taxels].
        lengths: int64 [captures].
        first: int64 [captures], position of each capture's first frame.
    """

    def __init__(self, corpus: Corpus) -> None:
        self.grid = corpus.grid
        self.full_scale = corpus.full_scale
        self.rate_hz = corpus.rate_hz
        self.lengths = corpus.lengths
        self.first = np.cumsum(corpus.lengths) - corpus.lengths
        begin, end = corpus.starts[0], corpus.starts[0] + self.lengths.sum()
        if np.array_equal(corpus.starts, begin + self.first):
            raw = corpus.frames[begin:end]
        else:
            raw = np.concatenate([corpus[i] for i in range(len(corpus))])
        self.raw = raw.reshape(len(raw), -1)
        self.frames = self.raw.astype(np.float32 if np.issubdtype(raw.dtype, np.integer) else np.float64)

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
        """Sums of each row and column of each frame [frames, rows + cols], by one matrix product."""
        rows, cols = self.grid
        member = np.concatenate(
            [np.kron(np.eye(rows), np.ones((1, cols))), np.kron(np.ones((1, rows)), np.eye(cols))]
        ).T
        return (self.frames @ np.ascontiguousarray(member, dtype=self.frames.dtype)).astype(np.float64)

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
        return self.rows @ np.ones(self.grid[0])

    @cached_property
    def peak(self) -> np.ndarray:
        """Largest value of each frame."""
        return self.frames.max(axis=1)

    @cached_property
    def change(self) -> np.ndarray:
        """Sum over the taxels of the absolute step."""
        step = self.step(self.frames)
        np.abs(step, out=step)
        return (step @ np.ones(self.taxels, dtype=step.dtype)).astype(np.float64)

    @cached_property
    def centre(self) -> np.ndarray:
        """Centre of mass [frames, 2], row and column counted from 1; the middle where nothing is pressed."""
        pressed = self.total > 0
        middle = (np.array(self.grid) + 1) / 2
        moment = np.stack([side @ np.arange(1, side.shape[1] + 1) for side in (self.rows, self.cols)], axis=1)
        return np.where(pressed[:, None], moment / np.where(pressed, self.total, 1)[:, None], middle)

    @cached_property
    def travel(self) -> np.ndarray:
        """Step of the centre of mass [frames, 2] in rows and columns."""
        return self.step(self.centre)

    @cached_property
    def area(self) -> np.ndarray:
        """Share of taxels above half of the frame's largest value."""
        return self.share_above(self.peak * 0.5)

    def share_above(self, threshold: np.ndarray | float) -> np.ndarray:
        """Share of the taxels of each frame above a value (a number, or one per frame)."""
        limit = threshold[:, None].astype(self.frames.dtype) if isinstance(threshold, np.ndarray) else threshold
        return np.count_nonzero(self.frames > limit, axis=1) / self.taxels

    def spatial_peaks(self, threshold: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Local maxima above a threshold per capture.

        A taxel is a maximum if it is greater than those of its 8 neighbours that come before it in reading order and
        not less than those after it, so that a plateau counts by its first taxel.

        Returns:
            Frame and taxel of every peak.
        """
        rows, cols = self.grid
        frame, taxel = np.nonzero(self.frames > threshold[self.capture, None].astype(self.frames.dtype))
        value = self.frames[frame, taxel]
        row, col = np.divmod(taxel, cols)
        keep = np.ones(len(frame), dtype=bool)
        for down, right in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
            r, c = row + down, col + right
            inside = np.flatnonzero((r >= 0) & (r < rows) & (c >= 0) & (c < cols))
            other = self.frames[frame[inside], r[inside] * cols + c[inside]]
            before = down < 0 or (down == 0 and right < 0)
            keep[inside] &= value[inside] > other if before else value[inside] >= other
        return frame[keep], taxel[keep]

    def at_highest(self, signal: np.ndarray) -> np.ndarray:
        """Value of a signal in the first frame with the highest total of each capture."""
        highest = np.maximum.reduceat(self.total, self.first)
        found = np.flatnonzero(self.total == highest[self.capture])
        _, position = np.unique(self.capture[found], return_index=True)
        return signal[found[position]]

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
        """Frequency in Hz of the largest amplitude of each signal [frames, n] without its mean; 0 if it is constant."""
        found = np.zeros((len(self.lengths), signals.shape[1]))
        for i, (first, length) in enumerate(zip(self.first.tolist(), self.lengths.tolist(), strict=True)):
            if length < 2:
                continue
            piece = signals[first : first + length]
            amplitude = np.abs(rfft(piece - piece.mean(axis=0), axis=0))[1:]
            bin_ = amplitude.argmax(axis=0)
            moving = np.ptp(piece, axis=0) > 1e-9
            found[i] = np.where(moving, (bin_ + 1) * self.rate_hz / length, 0)
        return found


def blocks(corpus: Corpus, frames: int = 16384) -> list[np.ndarray]:
    """Capture positions in runs of at most about this many frames, so that intermediates stay in the cache."""
    group = np.cumsum(corpus.lengths) // frames
    return np.split(np.arange(len(corpus)), np.flatnonzero(np.diff(group)) + 1)


def table(corpus: Corpus, names: list[str], columns: Callable[[Touch], list[np.ndarray]]) -> pd.DataFrame:
    """Run ``columns(touch)`` over blocks of captures and name what it gives."""
    parts = [np.column_stack(columns(Touch(corpus[slice(b[0], b[-1] + 1)]))) for b in blocks(corpus)]
    return pd.DataFrame(np.concatenate(parts), columns=names)
