"""The 54 features of Jung, Poel, Poppe and Heylen 2017 (J Multimodal User Interfaces 11:81-96, section 4.1)."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.features.base import FeatureSet, one_of
from bench.features.jung28 import PEAKS, first_columns, first_names
from bench.features.signals import Touch, table, weighted

BINS = 8
LATER = (  # names of features 29-43
    *(f"f{29 + i}_values_bin{i + 1}" for i in range(BINS)),
    *(
        "f37_spatial_peaks_mean",
        "f38_spatial_peaks_variance",
        "f39_peak_distance",
        "f40_peak_distance_change",
    ),
    *("f41_row_derivative", "f42_col_derivative", "f43_derivative"),
)
EDGE_DEGREES = 5.0
SHORTEST_STEP = 1e-6  # taxels


class Jung54(FeatureSet):
    """Features 1-28 of `Jung28`, with another temporal peak count, and 26 more; the numbers are for 8 x 8 taxels.

    ====== ============================ ===========================================================================
    22     temporal peaks 1             frames whose mean pressure is greater than both neighbours', count
    29-36  pressure distribution        shares of all values in 8 equal bins from 0 to full scale
    37-38  spatial peaks                mean and variance over time of their number; a peak is a local maximum above
                                        0.75 of feature 2
    39     peak distance                mean distance of peaks from the centre of mass, taxels
    40     change of peak distance      mean absolute change of the frame's mean peak distance, taxels
    41-42  row / column derivative      mean absolute change of row / column means, sensor value
    43     derivative                   mean absolute change of the taxels, sensor value
    44     variance                     over taxels and time, sensor value squared
    45-48  direction of movement        shares of steps of the centre of mass towards up-right, up-left, down-left,
                                        down-right; both sides of the angle by 5 degrees count half
    49-52  magnitude of movement        mean, SD, sum and range of the length of these steps, taxels
    53-54  periodicity                  frequency of the largest amplitude of the centre of mass's row / column, Hz
    ====== ============================ ===========================================================================

    By definition f43 = f3 / taxels, f1 is the mean of the row and of the column pressures, and f29-36 sum to 1.

    Args:
        area: ``frame`` or ``capture``: whose maximum the half of features 20 and 21 refers to; open in the paper.
    """

    def __init__(self, area: str = "frame") -> None:
        self.area = area

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run."""
        one_of("area", self.area, ("frame", "capture"))

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        self.check()
        return table(corpus, names(*corpus.grid), self._columns)

    def _columns(self, touch: Touch) -> list[np.ndarray]:
        columns = first_columns(touch, self.area, touch.local_maxima(touch.total))
        change = columns[2] / touch.taxels
        peaks = spatial_peaks(touch, columns[1])[:-1]
        return [
            *columns,
            *touch.distribution(BINS),
            *peaks,
            *derivatives(touch),
            change,
            _variance(touch),
            *_movement(touch),
            touch.dominant_frequency(touch.centre),
        ]


@cache
def names(rows: int, cols: int) -> pd.Index:
    """Names of the features on a grid."""
    named = [
        *first_names(rows, cols, "travel", PEAKS["maxima"]),
        *LATER,
        *("f44_variance", "f45_up_right", "f46_up_left", "f47_down_left", "f48_down_right"),
        *(
            "f49_step_mean",
            "f50_step_sd",
            "f51_step_sum",
            "f52_step_range",
            "f53_row_frequency",
            "f54_col_frequency",
        ),
    ]
    return pd.Index(named)


def spatial_peaks(touch: Touch, highest: np.ndarray) -> list[np.ndarray]:
    """Features 37-40, and the mean absolute change over time of the number of peaks."""
    frame, row, col = touch.spatial_peaks(0.75 * highest[touch.capture])
    count = np.bincount(frame, minlength=len(touch.total)).astype(np.float64)
    middle = touch.centre[frame]
    distance = np.hypot(row + 1 - middle[:, 0], col + 1 - middle[:, 1])
    summed = np.bincount(frame, weights=distance, minlength=len(count))
    peaks = touch.sum(count)
    per_frame = summed / np.maximum(count, 1)
    both = (count > 0) & (np.append(0, count[:-1]) > 0)
    both[touch.first] = False
    change = touch.sum(np.abs(touch.step(per_frame)) * both) / np.maximum(touch.sum(both), 1)
    count_change = touch.step_mean(np.abs(touch.step(count)))
    return [
        touch.mean(count),
        touch.variance(count),
        touch.sum(summed) / np.maximum(peaks, 1),
        change,
        count_change,
    ]


def derivatives(touch: Touch) -> list[np.ndarray]:
    """Features 41 and 42."""
    sides = (touch.rows, touch.cols)
    return [touch.step_mean(weighted(np.abs(touch.step(side)))) / touch.taxels for side in sides]


def _variance(touch: Touch) -> np.ndarray:
    samples = touch.lengths * touch.taxels
    mean = touch.sum(touch.total) / samples
    near = mean.astype(touch.frames.dtype)
    centred = touch.frames - near[touch.capture, None]
    # float32 misses the mean by a little, which matters where the values hardly vary
    return touch.sum(np.einsum("ij,ij->i", centred, centred)) / samples - (mean - near) ** 2


def _movement(touch: Touch) -> list[np.ndarray]:
    down, right = touch.travel.T
    length = np.hypot(down, right)
    moving = length > SHORTEST_STEP
    angle = np.degrees(np.arctan2(-down, right))  # rows are counted downwards
    shares = np.zeros((len(length), 4))
    for side in (-EDGE_DEGREES, EDGE_DEGREES):
        quadrant = ((angle + side) // 90).astype(np.int64) % 4
        shares[np.arange(len(length)), quadrant] += 0.5 * moving
    mean = touch.step_mean(length)
    square = (length - mean[touch.capture]) ** 2
    square[touch.first] = 0
    longest = np.maximum.reduceat(length, touch.first)
    rest = length.copy()
    rest[touch.first[touch.lengths > 1]] = np.inf  # a first frame is no step
    shortest = np.minimum.reduceat(rest, touch.first)
    direction = (touch.sum(shares).T / touch.steps).T
    return [
        direction,
        mean,
        np.sqrt(touch.step_mean(square)),
        touch.sum(length),
        longest - shortest,
    ]
