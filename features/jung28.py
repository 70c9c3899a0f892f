"""The 28 features of Jung et al. 2014 (ICMI), as told in Jung et al. 2017, section 4.1."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpus import Corpus
from features.base import FeatureSet
from features.signals import Touch, table


class Jung28(FeatureSet):
    """Pressure, contact area, temporal peaks, displacement and duration; the numbers are the paper's, for 8 x 8 taxels.

    ====== ============================ ===========================================================================
    1      mean pressure                over taxels and time, sensor value
    2      maximum pressure             sensor value
    3      pressure variability         mean over time of the summed absolute change of the taxels, sensor value
    4-11   mean pressure per row        top to bottom, sensor value
    12-19  mean pressure per column     left to right, sensor value
    20     mean contact area            mean share of taxels above half of the frame's maximum
    21     contact area at the peak     the same in the frame with the highest mean pressure
    22     temporal peaks 1             upward crossings of mean + 1 SD of the summed pressure (see below)
    23     temporal peaks 2             upward crossings of the mean of the summed pressure
    24-25  displacement, rows           mean and sum over time of the centre of mass's absolute step, rows
    26-27  displacement, columns        the same in columns
    28     duration                     frames
    ====== ============================ ===========================================================================

    The text of 2014 is not at hand and defines another feature 22 than the text of 2017; mean + 1 SD is our reading.
    Row and column features follow the grid.
    """

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        names = [*first_names(*corpus.grid)]
        names[names.index("f22_peaks")] = "f22_peaks_mean_plus_sd"
        return table(corpus, names, _columns)


def _columns(touch: Touch) -> list[np.ndarray]:
    mean = touch.mean(touch.total)
    spread = np.sqrt(touch.mean((touch.total - mean[touch.capture]) ** 2))
    return first_columns(touch, touch.upward_crossings(touch.total, mean + spread))


def first_names(rows: int, cols: int) -> list[str]:
    """Names of features 1-28 on a grid."""
    side = [f"f04_row{i}_pressure" for i in range(1, rows + 1)] + [f"f12_col{i}_pressure" for i in range(1, cols + 1)]
    return [
        *("f01_mean_pressure", "f02_max_pressure", "f03_pressure_variability"),
        *side,
        *("f20_contact_area", "f21_peak_contact_area", "f22_peaks", "f23_mean_crossings"),
        *("f24_row_travel_mean", "f25_row_travel_sum", "f26_col_travel_mean", "f27_col_travel_sum", "f28_duration"),
    ]


def first_columns(touch: Touch, peaks: np.ndarray) -> list[np.ndarray]:
    """Features 1-28, with feature 22 given, as arrays [captures] or [captures, n]."""
    rows, cols = touch.grid
    travel = np.abs(touch.travel)
    mean_total = touch.mean(touch.total)
    distance = touch.sum(travel)
    return [
        mean_total / touch.taxels,
        np.maximum.reduceat(touch.peak, touch.first),
        touch.step_mean(touch.change),
        touch.mean(touch.rows) / cols,
        touch.mean(touch.cols) / rows,
        touch.mean(touch.area),
        touch.at_highest(touch.area),
        peaks,
        touch.upward_crossings(touch.total, mean_total),
        distance[:, 0] / touch.steps,
        distance[:, 0],
        distance[:, 1] / touch.steps,
        distance[:, 1],
        touch.lengths,
    ]
