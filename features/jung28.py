"""The 28 features of Jung et al. 2014 (ICMI), as described in Jung et al. 2017, section 4.1."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.features.base import FeatureSet, check_choice
from bench.features.signals import Touch, feature_table

PEAKS = {"crossings": "f22_peaks_mean_plus_sd", "maxima": "f22_peaks"}  # name of feature 22


class Jung28(FeatureSet):
    """Pressure, contact area, temporal peaks, displacement and duration.

    The numbers are the paper's, for 8 x 8 taxels.

    ===== ======================== =================================================================
    1     mean pressure            over taxels and time, sensor value
    2     maximum pressure         sensor value
    3     pressure variability     mean over time of the summed absolute change of the taxels,
                                   sensor value
    4-11  mean pressure per row    top to bottom, sensor value
    12-19 mean pressure per column left to right, sensor value
    20    mean contact area        mean share of taxels above half of the frame's maximum
    21    contact area at the peak the same in the frame with the highest mean pressure
    22    temporal peaks 1         upward crossings of mean + 1 SD of the summed pressure (see
                                   below)
    23    temporal peaks 2         upward crossings of the mean of the summed pressure
    24-25 displacement, rows       mean and sum over time of the centre of mass's absolute step,
                                   rows
    26-27 displacement, columns    the same in columns
    28    duration                 frames
    ===== ======================== =================================================================

    Row and column features follow the grid.

    Args:
        area: ``frame`` or ``capture``: features 20 and 21 count taxels above half of its maximum;
            the paper leaves it open.
        peaks: ``crossings``: feature 22 as above. ``maxima``: frames whose mean pressure is greater
            than both neighbours', as in 2017. The text of 2014 describes another count; mean + 1 SD
            is our reading.
    """

    def __init__(self, area: str = "frame", peaks: str = "crossings") -> None:
        self.area = area
        self.peaks = peaks

    def check(self) -> None:
        """Raise an InputError for wrong parameters, before anything is run."""
        check_choice("area", self.area, ("frame", "capture"))
        check_choice("peaks", self.peaks, [*PEAKS])

    def keeps(self, frames: int, taxels: int) -> int:
        """Summed pressure of each frame, to compare with its mean, and two frames.

        The whole capture if features 20 and 21 need its maximum.
        """
        if self.area == "capture":
            return super().keeps(frames, taxels)
        return frames + 2 * taxels

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        self.check()
        return feature_table(
            corpus, _feature_names(*corpus.grid, self.peaks), self._feature_columns
        )

    def _feature_columns(self, touch: Touch) -> list[np.ndarray]:
        if self.peaks == "maxima":
            peaks = touch.count_local_maxima(touch.total)
        else:
            peaks = mean_plus_sd_crossings(touch)
        return columns_1_to_28(touch, self.area, peaks)


@cache
def _feature_names(rows: int, cols: int, peaks: str) -> pd.Index:
    return pd.Index(names_1_to_28(rows, cols, "displacement", PEAKS[peaks]))


def mean_plus_sd_crossings(touch: Touch) -> np.ndarray:
    """Feature 22 of 2014: upward crossings of mean + 1 SD of the summed pressure [captures]."""
    level = touch.mean(touch.total) + np.sqrt(touch.variance(touch.total))
    return touch.count_upward_crossings(touch.total, level)


def names_1_to_28(rows: int, cols: int, movement: str, peaks: str) -> list[str]:
    """Names of features 1-28 on a grid, with the word for movement in 24-27 and the name of 22."""
    return [
        *("f01_mean_pressure", "f02_max_pressure", "f03_pressure_variability"),
        *(f"f04_row{i}_pressure" for i in range(1, rows + 1)),
        *(f"f12_col{i}_pressure" for i in range(1, cols + 1)),
        *("f20_contact_area", "f21_peak_contact_area", peaks, "f23_mean_crossings"),
        *(f"f24_row_{movement}_mean", f"f25_row_{movement}_sum"),
        *(f"f26_col_{movement}_mean", f"f27_col_{movement}_sum"),
        "f28_duration",
    ]


def columns_1_to_28(touch: Touch, area: str, peaks: np.ndarray) -> list[np.ndarray]:
    """Features 1-28 as arrays [captures] or [captures, n], with ``peaks`` as feature 22."""
    rows, cols = touch.grid
    highest = np.maximum.reduceat(touch.peak, touch.starts)
    contact = touch.area
    if area == "capture":
        contact = touch.share_above(highest[touch.capture_of_frame] * 0.5)
    mean_total = touch.mean(touch.total)
    distance = touch.sum(np.abs(touch.travel))
    return [
        mean_total / touch.taxels,
        highest,
        touch.step_mean(touch.change),
        touch.mean(touch.rows) / cols,
        touch.mean(touch.cols) / rows,
        touch.mean(contact),
        touch.value_at_highest_total(contact),
        peaks,
        touch.count_upward_crossings(touch.total, mean_total),
        distance[:, 0] / touch.step_counts,
        distance[:, 0],
        distance[:, 1] / touch.step_counts,
        distance[:, 1],
        touch.lengths,
    ]
