"""45 features in the manner of van Wingerden et al. 2014."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.features.base import FeatureSet
from bench.features.jung28 import PEAKS, columns_1_to_28, mean_plus_sd_crossings, names_1_to_28
from bench.features.jung54 import BINS, NAMES_29_TO_43, derivative_columns, spatial_peak_columns
from bench.features.signals import Touch, feature_table


class Wingerden45(FeatureSet):
    """The 28 features of Jung et al. 2014 and 17 more: histogram, spatial peaks, dynamics.

    Jung et al. 2017 call their features 29-43 slight adaptations of these, so they are taken from
    there; two measures of motion make up the number. The numbers are for 8 x 8 taxels.

    ===== ======================= ==================================================================
    1-28  as `Jung28`             feature 22 counts upward crossings of mean + 1 SD of the summed
                                  pressure
    29-36 pressure distribution   shares of all values in 8 equal bins from 0 to full scale
    37-40 spatial peaks           mean and variance of their number, their distance from the centre
                                  of mass (taxels) and its mean absolute change
    41-43 derivatives             mean absolute change of row means, column means and taxels, sensor
                                  value
    44    variance of change      over time, of the mean absolute change of the taxels, sensor value
                                  squared
    45    change of spatial peaks mean absolute change over time of their number
    ===== ======================= ==================================================================
    """

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        return feature_table(corpus, _feature_names(*corpus.grid), _feature_columns)


def _feature_columns(touch: Touch) -> list[np.ndarray]:
    columns = columns_1_to_28(touch, "frame", mean_plus_sd_crossings(touch))
    *peaks, peak_change = spatial_peak_columns(touch, columns[1])
    change = touch.change / touch.taxels
    return [
        *columns,
        *touch.histogram(BINS),
        *peaks,
        *derivative_columns(touch),
        touch.step_mean(change),
        touch.step_variance(change),
        peak_change,
    ]


@cache
def _feature_names(rows: int, cols: int) -> pd.Index:
    first = names_1_to_28(rows, cols, "displacement", PEAKS["crossings"])
    return pd.Index([*first, *NAMES_29_TO_43, "f44_change_variance", "f45_spatial_peaks_change"])
