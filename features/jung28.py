"""The 28 features of Jung et al. 2014 (ICMI), as described in Jung et al. 2017, section 4.1."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.features.base import FeatureSet, one_of
from bench.features.signals import Touch, table

PEAKS = {"crossings": "f22_peaks_mean_plus_sd", "maxima": "f22_peaks"}  # name of feature 22


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

    Row and column features follow the grid.

    Args:
        area: ``frame`` or ``capture``: whose maximum the half of features 20 and 21 refers to; open in the paper.
        peaks: ``crossings`` or ``maxima``: feature 22 as above, or the frames whose mean pressure is greater than both
            neighbours', as in 2017. The text of 2014 had another count than that of 2017; mean + 1 SD is our reading.
    """

    def __init__(self, area: str = "frame", peaks: str = "crossings") -> None:
        self.area = area
        self.peaks = peaks

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run."""
        one_of("area", self.area, ("frame", "capture"))
        one_of("peaks", self.peaks, [*PEAKS])

    def keeps(self, frames: int, taxels: int) -> int:
        """The summed pressure of each frame, which is compared with its mean, and two frames.

        The whole capture where feature 20 needs its maximum.
        """
        return frames + 2 * taxels if self.area == "frame" else super().keeps(frames, taxels)

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        self.check()
        return table(corpus, _names(*corpus.grid, self.peaks), self._columns)

    def _columns(self, touch: Touch) -> list[np.ndarray]:
        peaks = touch.local_maxima(touch.total) if self.peaks == "maxima" else crossings(touch)
        return first_columns(touch, self.area, peaks)


@cache
def _names(rows: int, cols: int, peaks: str) -> pd.Index:
    return pd.Index(first_names(rows, cols, "displacement", PEAKS[peaks]))


def crossings(touch: Touch) -> np.ndarray:
    """Feature 22 of 2014: upward crossings of mean + 1 SD of the summed pressure [captures]."""
    return touch.upward_crossings(
        touch.total, touch.mean(touch.total) + np.sqrt(touch.variance(touch.total))
    )


def first_names(rows: int, cols: int, moved: str, peaks: str) -> list[str]:
    """Names of features 1-28 on a grid; ``moved`` is the word for 24-27, ``peaks`` the name of 22."""
    side = [f"f04_row{i}_pressure" for i in range(1, rows + 1)] + [
        f"f12_col{i}_pressure" for i in range(1, cols + 1)
    ]
    return [
        *("f01_mean_pressure", "f02_max_pressure", "f03_pressure_variability"),
        *side,
        *("f20_contact_area", "f21_peak_contact_area", peaks, "f23_mean_crossings"),
        *(
            f"f24_row_{moved}_mean",
            f"f25_row_{moved}_sum",
            f"f26_col_{moved}_mean",
            f"f27_col_{moved}_sum",
        ),
        "f28_duration",
    ]


def first_columns(touch: Touch, area: str, peaks: np.ndarray) -> list[np.ndarray]:
    """Features 1-28, with feature 22 as ``peaks``, as arrays [captures] or [captures, n]."""
    rows, cols = touch.grid
    highest = np.maximum.reduceat(touch.peak, touch.first)
    covered = touch.area if area == "frame" else touch.share_above(highest[touch.capture] * 0.5)
    travel = np.abs(touch.travel)
    mean_total = touch.mean(touch.total)
    distance = touch.sum(travel)
    return [
        mean_total / touch.taxels,
        highest,
        touch.step_mean(touch.change),
        touch.mean(touch.rows) / cols,
        touch.mean(touch.cols) / rows,
        touch.mean(covered),
        touch.at_highest(covered),
        peaks,
        touch.upward_crossings(touch.total, mean_total),
        distance[:, 0] / touch.steps,
        distance[:, 0],
        distance[:, 1] / touch.steps,
        distance[:, 1],
        touch.lengths,
    ]
