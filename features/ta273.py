"""The 273 features of Ta, Johal, Portaz, Castelli and Vaufreydaz 2015 (ICMI challenge)."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
from scipy.fft import dct, rfft

from bench.corpora.corpus import Corpus
from bench.features.base import FeatureSet, check_choice
from bench.features.signals import Touch, capture_blocks, feature_table, taxel_names

BINS = 16
LEVELS = 16
POINTS = 128
COEFFICIENTS = 20
_CROSSING_NAMES = [f"level{i}_crossings" for i in range(1, LEVELS + 1)]


class Ta273(FeatureSet):
    """40 global features, 3 of each taxel and 41 of the sequence of mean pressure.

    The numbers are for 8 x 8 taxels.

    The paper gives the sizes of these three groups and their subjects: frames, mean and maximum
    pressure and variation around certain values; mean, variation and time above a threshold of a
    channel; Fourier and cosine transform of the sequence. The single features are our reading.

    ======= ========================================================================================
    1-8     frames; mean, maximum, median and SD of all values, mean absolute change of the taxels
            (sensor value); temporal peaks and crossings of its mean by the mean pressure (counts)
    9-24    shares of all values in 16 equal bins from 0 to full scale
    25-40   crossings, per second, of 16 levels by the mean pressure
    41-232  of each taxel: mean and SD over time (sensor value), and the share of frames in which it
            is more than 10 % of full scale above its lowest value
    233-272 the mean pressure at 128 equally spaced moments: magnitudes 1-20 of its Fourier
            transform, divided by 128, then the first 20 coefficients of its orthonormal cosine
            transform (DCT-II), sensor value
    273     frequency of the largest amplitude of the mean pressure, Hz
    ======= ========================================================================================

    Args:
        levels: ``training``: the 16 levels are equally spaced from the 1st to the 99th percentile
            of the mean pressure of all training frames, two numbers that are learned. ``fixed``:
            they are equally spaced between 0 and full scale.
    """

    learns = True

    def __init__(self, levels: str = "training") -> None:
        self.levels = levels

    def check(self) -> None:
        """Raise an InputError for wrong parameters, before anything is run."""
        check_choice("levels", self.levels, ("training", "fixed"))

    def fit(self, X: Corpus, y: object = None) -> Ta273:
        """Learn the levels whose crossings by the mean pressure are counted."""
        self.check()
        if self.levels == "fixed":
            self.levels_ = X.full_scale * np.arange(1, LEVELS + 1) / (LEVELS + 1)
        else:
            self.levels_ = np.linspace(*np.quantile(mean_pressure(X), [0.01, 0.99]), LEVELS)
        self.names_ = _feature_names(*X.grid)
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Features of each capture [captures, n_features]."""
        rates = crossings_per_second(mean_pressure(X), X.lengths, self.levels_, X.rate_hz)
        others = self.extracted_table(X)
        crossings = pd.DataFrame(rates, others.index, _CROSSING_NAMES)
        return pd.concat([others, crossings], axis=1)[self.names_]

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture, without the crossings of levels."""
        return feature_table(corpus, _extracted_names(*corpus.grid), _feature_columns)


def mean_pressure(corpus: Corpus) -> np.ndarray:
    """Mean over the taxels of every frame, captures one after another, float64 [frames]."""
    parts = [Touch(corpus[block]).total for block in capture_blocks(corpus)]
    return np.concatenate([np.empty(0), *parts]) / (corpus.grid[0] * corpus.grid[1])


def crossings_per_second(
    signal: np.ndarray, lengths: np.ndarray, levels: np.ndarray, rate_hz: float
) -> np.ndarray:
    """Rate at which a signal passes each level, up or down, per second [captures, levels].

    Args:
        signal: float64 [frames], captures one after another.
        lengths: frames of each capture.
        levels: levels in ascending order.
        rate_hz: frames per second.
    """
    # Between two frames, each level from the lower to the higher position is crossed once.
    position = np.searchsorted(levels, signal)  # number of levels below the signal
    low, high = np.minimum(position[1:], position[:-1]), np.maximum(position[1:], position[:-1])
    capture = np.repeat(np.arange(len(lengths)), lengths)
    inside = (capture[1:] == capture[:-1]) & (low < high)
    shape = (len(lengths), len(levels) + 1)
    count = np.zeros(shape)
    for edge, sign in ((low, 1), (high, -1)):
        cell = capture[1:][inside] * shape[1] + edge[inside]
        count += sign * np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
    return count.cumsum(axis=1)[:, :-1] * (rate_hz / lengths)[:, None]


def _feature_columns(touch: Touch) -> list[np.ndarray]:
    pressure = touch.total / touch.taxels
    mean_total = touch.mean(touch.total)
    # Totals are whole numbers, so rounding decides nothing.
    above = touch.total > mean_total[touch.capture_of_frame]
    crossed = np.zeros(len(pressure), dtype=bool)
    crossed[1:] = above[1:] != above[:-1]
    crossed[touch.starts] = False
    taxel_mean = touch.mean(touch.frames)
    rounded_mean = taxel_mean.astype(touch.frames.dtype)
    square = touch.frames - rounded_mean[touch.capture_of_frame]
    np.square(square, out=square)
    # The rounding of the mean to float32 matters where values hardly vary.
    taxel_variance = np.maximum(touch.mean(square) - (taxel_mean - rounded_mean) ** 2, 0)
    # Variance of all values: within the taxels and between them.
    variance = taxel_variance.mean(axis=1) + taxel_mean.var(axis=1)
    lowest = np.minimum.reduceat(touch.values, touch.starts, axis=0)
    threshold = touch.as_threshold(np.float64(0.1 * touch.full_scale))
    pressed = touch.values - lowest[touch.capture_of_frame] > threshold
    medians = [np.median(values) for values in np.split(touch.values, touch.starts[1:])]
    resampled = _resample_captures(touch, pressure)
    return [
        touch.lengths,
        mean_total / touch.taxels,
        np.maximum.reduceat(touch.peak, touch.starts),
        np.array(medians, dtype=np.float64),
        np.sqrt(variance),
        touch.step_mean(touch.change) / touch.taxels,
        touch.count_local_maxima(touch.total),
        touch.sum(crossed),
        *touch.histogram(BINS),
        taxel_mean,
        np.sqrt(taxel_variance),
        (np.add.reduceat(pressed, touch.starts, axis=0, dtype=np.int64).T / touch.lengths).T,
        np.abs(rfft(resampled, axis=1)[:, 1 : COEFFICIENTS + 1]) / POINTS,
        dct(resampled, axis=1, norm="ortho")[:, :COEFFICIENTS],
        touch.dominant_frequency(pressure[:, None]),
    ]


def _resample_captures(touch: Touch, signal: np.ndarray) -> np.ndarray:
    """Signal at `POINTS` equally spaced moments of each capture, from first to last frame."""
    moment = np.linspace(0, 1, POINTS) * (touch.lengths - 1)[:, None]
    before = np.minimum(moment.astype(np.int64), np.maximum(touch.lengths - 2, 0)[:, None])
    weight = moment - before
    first = touch.starts[:, None] + before
    second = np.minimum(first + 1, (touch.starts + touch.lengths - 1)[:, None])
    return signal[first] * (1 - weight) + signal[second] * weight


@cache
def _feature_names(rows: int, cols: int) -> pd.Index:
    names = _extracted_names(rows, cols).tolist()
    names[8 + BINS : 8 + BINS] = _CROSSING_NAMES
    return pd.Index(names)


@cache
def _extracted_names(rows: int, cols: int) -> pd.Index:
    taxels = taxel_names(rows, cols)
    names = [
        *("frames", "mean_pressure", "max_pressure", "median_pressure", "pressure_sd"),
        *("derivative", "temporal_peaks", "mean_crossings"),
        *(f"values_bin{i + 1}" for i in range(BINS)),
        *(f"{taxel}_mean" for taxel in taxels),
        *(f"{taxel}_sd" for taxel in taxels),
        *(f"{taxel}_pressed" for taxel in taxels),
        *(f"fft{i}" for i in range(1, COEFFICIENTS + 1)),
        *(f"dct{i}" for i in range(COEFFICIENTS)),
        "frequency",
    ]
    return pd.Index(names)
