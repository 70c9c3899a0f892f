"""The 54 features of Jung, Poel, Poppe and Heylen 2017.

J Multimodal User Interfaces 11:81-96, section 4.1.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.features.base import FeatureSet, check_choice
from bench.features.jung28 import PEAKS, columns_1_to_28, names_1_to_28
from bench.features.signals import Touch, feature_table, row_sums

BINS = 8
NAMES_29_TO_43 = (
    *(f"f{29 + i}_values_bin{i + 1}" for i in range(BINS)),
    *("f37_spatial_peaks_mean", "f38_spatial_peaks_variance"),
    *("f39_peak_distance", "f40_peak_distance_change"),
    *("f41_row_derivative", "f42_col_derivative", "f43_derivative"),
)
EDGE_DEGREES = 5.0
SHORTEST_STEP = 1e-6  # taxels


class Jung54(FeatureSet):
    """Features 1-28 of `Jung28`, with another count of temporal peaks, and 26 more.

    The numbers are for 8 x 8 taxels.

    ===== ======================= ==================================================================
    22    temporal peaks 1        frames whose mean pressure is greater than both neighbours', count
    29-36 pressure distribution   shares of all values in 8 equal bins from 0 to full scale
    37-38 spatial peaks           mean and variance over time of their number; a peak is a local
                                  maximum above 0.75 of feature 2
    39    peak distance           mean distance of peaks from the centre of mass, taxels
    40    change of peak distance mean absolute change of the frame's mean peak distance, taxels
    41-42 row / column derivative mean absolute change of row / column means, sensor value
    43    derivative              mean absolute change of the taxels, sensor value
    44    variance                over taxels and time, sensor value squared
    45-48 direction of movement   shares of steps of the centre of mass towards up-right, up-left,
                                  down-left, down-right; both sides of the angle by 5 degrees count
                                  half
    49-52 magnitude of movement   mean, SD, sum and range of the length of these steps, taxels
    53-54 periodicity             frequency of the largest amplitude of the centre of mass's row /
                                  column, Hz
    ===== ======================= ==================================================================

    By definition f43 = f3 / taxels, f1 is the mean of the row and of the column pressures, and
    f29-36 sum to 1.

    Args:
        area: ``frame`` or ``capture``: features 20 and 21 count taxels above half of its maximum;
            the paper leaves it open.
    """

    def __init__(self, area: str = "frame") -> None:
        self.area = area

    def check(self) -> None:
        """Raise an InputError for wrong parameters, before anything is run."""
        check_choice("area", self.area, ("frame", "capture"))

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        self.check()
        return feature_table(corpus, feature_names(*corpus.grid), self._feature_columns)

    def _feature_columns(self, touch: Touch) -> list[np.ndarray]:
        columns = columns_1_to_28(touch, self.area, touch.count_local_maxima(touch.total))
        change = columns[2] / touch.taxels
        peaks = spatial_peak_columns(touch, columns[1])[:-1]
        return [
            *columns,
            *touch.histogram(BINS),
            *peaks,
            *derivative_columns(touch),
            change,
            _overall_variance(touch),
            *_movement_columns(touch),
            touch.dominant_frequency(touch.centre),
        ]


@cache
def feature_names(rows: int, cols: int) -> pd.Index:
    """Names of the features on a grid."""
    names = [
        *names_1_to_28(rows, cols, "travel", PEAKS["maxima"]),
        *NAMES_29_TO_43,
        *("f44_variance", "f45_up_right", "f46_up_left", "f47_down_left", "f48_down_right"),
        *("f49_step_mean", "f50_step_sd", "f51_step_sum", "f52_step_range"),
        *("f53_row_frequency", "f54_col_frequency"),
    ]
    return pd.Index(names)


def spatial_peak_columns(touch: Touch, highest: np.ndarray) -> list[np.ndarray]:
    """Features 37-40, and the mean absolute change over time of the number of peaks."""
    frame, row, col = touch.find_spatial_peaks(0.75 * highest[touch.capture_of_frame])
    count = np.bincount(frame, minlength=len(touch.total)).astype(np.float64)
    middle = touch.centre[frame]
    distance = np.hypot(row + 1 - middle[:, 0], col + 1 - middle[:, 1])
    summed = np.bincount(frame, weights=distance, minlength=len(count))
    mean_distance = summed / np.maximum(count, 1)
    has_change = (count > 0) & (np.append(0, count[:-1]) > 0)
    has_change[touch.starts] = False
    change = touch.sum(np.abs(touch.frame_differences(mean_distance)) * has_change)
    return [
        touch.mean(count),
        touch.variance(count),
        touch.sum(summed) / np.maximum(touch.sum(count), 1),
        change / np.maximum(touch.sum(has_change), 1),
        touch.step_mean(np.abs(touch.frame_differences(count))),
    ]


def derivative_columns(touch: Touch) -> list[np.ndarray]:
    """Features 41 and 42."""
    changes = [row_sums(np.abs(touch.frame_differences(side))) for side in (touch.rows, touch.cols)]
    return [touch.step_mean(change) / touch.taxels for change in changes]


def _overall_variance(touch: Touch) -> np.ndarray:
    samples = touch.lengths * touch.taxels
    mean = touch.sum(touch.total) / samples
    rounded_mean = mean.astype(touch.frames.dtype)
    centred = touch.frames - rounded_mean[touch.capture_of_frame, None]
    square = touch.sum(np.einsum("ij,ij->i", centred, centred)) / samples
    return square - (mean - rounded_mean) ** 2  # which matters where values hardly vary


def _movement_columns(touch: Touch) -> list[np.ndarray]:
    down, right = touch.travel.T
    length = np.hypot(down, right)
    moving = length > SHORTEST_STEP
    angle = np.degrees(np.arctan2(-down, right))  # rows are counted downwards
    shares = np.zeros((len(length), 4))
    for side in (-EDGE_DEGREES, EDGE_DEGREES):
        quadrant = ((angle + side) // 90).astype(np.int64) % 4
        shares[np.arange(len(length)), quadrant] += 0.5 * moving
    longest = np.maximum.reduceat(length, touch.starts)
    steps = length.copy()
    steps[touch.starts[touch.lengths > 1]] = np.inf  # a first frame is no step
    shortest = np.minimum.reduceat(steps, touch.starts)
    return [
        (touch.sum(shares).T / touch.step_counts).T,
        touch.step_mean(length),
        np.sqrt(touch.step_variance(length)),
        touch.sum(length),
        longest - shortest,
    ]
