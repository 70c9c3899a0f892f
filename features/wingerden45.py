"""45 features in the manner of van Wingerden et al. 2014 (features 1-28 of Jung et al. 2014, histogram, dynamics)."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.features.base import FeatureSet
from bench.features.jung28 import PEAKS, crossings, first_columns, first_names
from bench.features.jung54 import BINS, LATER, derivatives, spatial_peaks
from bench.features.signals import Touch, table


class Wingerden45(FeatureSet):
    """The 28 features of 2014 and 17 more; the abstract does not name them.

    Jung et al. 2017 call their features 29-43 slight adaptations of these, so they are taken from there; two measures
    of motion make up the number. The numbers are for 8 x 8 taxels.

    ====== ============================ ===========================================================================
    1-28   as `Jung28`                  feature 22 counts upward crossings of mean + 1 SD of the summed pressure
    29-36  pressure distribution        shares of all values in 8 equal bins from 0 to full scale
    37-40  spatial peaks                mean and variance of their number, their distance from the centre of mass
                                        (taxels) and its mean absolute change
    41-43  derivatives                  mean absolute change of row means, column means and taxels, sensor value
    44     variance of change           over time, of the mean absolute change of the taxels, sensor value squared
    45     change of spatial peaks      mean absolute change over time of their number
    ====== ============================ ===========================================================================
    """

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        return table(corpus, _names(*corpus.grid), _columns)


def _columns(touch: Touch) -> list[np.ndarray]:
    columns = first_columns(touch, "frame", crossings(touch))
    *peaks, peak_change = spatial_peaks(touch, columns[1])
    change = touch.change / touch.taxels
    mean_change = touch.step_mean(change)
    square = (change - mean_change[touch.capture]) ** 2
    square[touch.first] = 0  # a first frame is no step
    return [
        *columns,
        *touch.distribution(BINS),
        *peaks,
        *derivatives(touch),
        mean_change,
        touch.step_mean(square),
        peak_change,
    ]


@cache
def _names(rows: int, cols: int) -> pd.Index:
    first = first_names(rows, cols, "displacement", PEAKS["crossings"])
    return pd.Index([*first, *LATER, "f44_change_variance", "f45_spatial_peaks_change"])
