"""Captures as series of one length, for classifiers that need equal lengths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.preprocessing import StandardScaler

from bench.corpora.corpus import Corpus
from bench.features.signals import Touch, capture_blocks

CHANNELS = ("signals", "taxels", "both")
CONTACT_SHARE = 0.05  # of full scale, above which a taxel is touched
MIN_FRAMES = 10  # the 9 of a kernel of MiniRocket, and one more for differences


@dataclass(eq=False, repr=False)
class Series(TransformerMixin, BaseEstimator):
    """Resamples each capture linearly to one length; standardises channels over training frames.

    Args:
        channels: ``signals`` for five (summed pressure, row and column of the centre of mass,
            maximum, share of taxels above 5 % of full scale), ``taxels`` for one per taxel, or
            ``both``.
        length: frames of a series; None for the median length of the training captures, at least
            10.

    Attributes:
        level_: mean and SD of each channel.
        length_: frames of a series.
    """

    channels: str = "signals"
    length: int | None = None

    def fit(self, X: Corpus, y: object = None) -> Series:
        """Learn level and length from training captures."""
        self.level_ = StandardScaler()
        for block in capture_blocks(X):
            self.level_.partial_fit(self._compute_channels(Touch(X[block])))
        self.length_ = self.length or max(int(np.median(X.lengths)), MIN_FRAMES)
        return self

    def iter_series(self, X: Corpus) -> Iterator[np.ndarray]:
        """Yield the captures in order, float32 [channels, length_]."""
        for block in capture_blocks(X):
            touch = Touch(X[block])
            signals = (self._compute_channels(touch) - self.level_.mean_) / self.level_.scale_
            for capture in np.split(signals, touch.starts[1:]):
                frames = np.arange(len(capture))
                times = np.linspace(0, len(capture) - 1, self.length_)
                channels = [np.interp(times, frames, channel) for channel in capture.T]
                yield np.stack(channels).astype(np.float32)

    def transform(self, X: Corpus) -> np.ndarray:
        """All captures, float32 [captures, channels, length_]."""
        return np.stack(list(self.iter_series(X)))

    @property
    def channels_(self) -> int:
        """Number of channels."""
        return self.level_.n_features_in_

    def _compute_channels(self, touch: Touch) -> np.ndarray:
        """Channels of some captures, float64 [frames, channels]."""
        parts = [touch.frames] if self.channels != "signals" else []
        if self.channels != "taxels":
            area = touch.share_above(np.full(len(touch.peak), CONTACT_SHARE * touch.full_scale))
            parts += [touch.total, touch.centre, touch.peak, area]
        return np.column_stack(parts).astype(np.float64)
