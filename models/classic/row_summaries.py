"""Statistics of training rows for `bench.models.classic.lda`, of parts that are merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bench.features.base import capture_of_rows, is_constant, undamaged_rows


@dataclass(frozen=True)
class TrainingStatistics:
    """Statistics of all rows that discriminants learn from; the people add-on updates them.

    Attributes:
        mean, sd: mean and SD of the features [features]; the following ones are of standardised
            features.
        class_means: means of the classes [classes, features].
        weights: total weight of the rows of each class [classes].
        scatter: scatter of the rows about the means of their classes [features, features].
    """

    mean: np.ndarray
    sd: np.ndarray
    class_means: np.ndarray
    weights: np.ndarray
    scatter: np.ndarray


@dataclass(frozen=True)
class RowSummary:
    """Statistics of some training rows, in the units of the features.

    Attributes:
        classes: names of their classes [classes].
        weights: total weight of the rows of each class [classes].
        class_means: means of the classes [classes, features].
        windows: numbers of windows that may decide together [numbers].
        scatters: for each of these, the scatter of the rows about the means of their classes
            [numbers, features, features].
        squares: sums of squares about the means of the classes [features].
        minimum, maximum: extreme values [features].
    """

    classes: np.ndarray
    weights: np.ndarray
    class_means: np.ndarray
    windows: np.ndarray
    scatters: np.ndarray
    squares: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray

    def standardise(self, windows: float) -> TrainingStatistics:
        """Statistics for one of the numbers of windows."""
        mean = self.weights @ self.class_means / self.weights.sum()
        deviations = self.class_means - mean
        sd = np.sqrt((self.squares + self.weights @ deviations**2) / self.weights.sum())
        sd[is_constant(np.stack([self.minimum, self.maximum]))] = np.inf
        scatter = self.scatters[[*self.windows].index(windows)] / sd[:, None] / sd
        return TrainingStatistics(mean, sd, deviations / sd, self.weights, scatter)


def summarise_rows(
    X: pd.DataFrame, y: np.ndarray, windows: Sequence[float], damaged: float
) -> RowSummary:
    """Summarise some training rows of classes ``y`` for some numbers of windows."""
    classes, codes = np.unique(y, return_inverse=True)
    Z = np.asarray(X, dtype=np.float64)
    row_weights = np.where(undamaged_rows(X), 1.0, damaged)
    class_means, weights = mean_by_code(Z, codes, row_weights)
    centred = Z - class_means[codes]
    scatters = weighted_scatter(centred, capture_of_rows(X), row_weights, 1)[None]
    if (more_windows := np.asarray(windows) - 1).any():
        means, capture_weights = mean_by_code(centred, capture_of_rows(X), row_weights)
        between = (means.T * capture_weights) @ means
        scatters = scatters + more_windows[:, None, None] * between
    squares, extremes = row_weights @ centred**2, (Z.min(axis=0), Z.max(axis=0))
    return RowSummary(
        classes, weights, class_means, np.asarray(windows), scatters, squares, *extremes
    )


def merge_summaries(parts: Sequence[RowSummary]) -> RowSummary:
    """Summary of the rows of parts that share no capture."""
    part_classes = np.concatenate([part.classes for part in parts])
    part_means = np.concatenate([part.class_means for part in parts])
    part_weights = np.concatenate([part.weights for part in parts])
    classes, codes = np.unique(part_classes, return_inverse=True)
    class_means, weights = mean_by_code(part_means, codes, part_weights)
    deviations = part_means - class_means[codes]
    windows, between = parts[0].windows, (deviations.T * part_weights) @ deviations
    scatters = windows[:, None, None] * between + sum(part.scatters for part in parts)
    squares = part_weights @ deviations**2 + sum(part.squares for part in parts)
    minimum = np.min([part.minimum for part in parts], axis=0)
    maximum = np.max([part.maximum for part in parts], axis=0)
    return RowSummary(classes, weights, class_means, windows, scatters, squares, minimum, maximum)


def weighted_scatter(
    centred: np.ndarray, captures: np.ndarray, row_weights: np.ndarray, windows: float
) -> np.ndarray:
    """Scatter about class means, that between captures weighted by a number of windows."""
    scatter = (centred.T * row_weights) @ centred
    if windows == 1:
        return scatter
    means, weights = mean_by_code(centred, captures, row_weights)
    return scatter + (windows - 1) * (means.T * weights) @ means


def mean_by_code(
    values: np.ndarray, codes: np.ndarray, row_weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean of the rows of each code [codes, n], and the sum of their weights [codes]."""
    order = np.argsort(codes, kind="stable")
    first = np.flatnonzero(np.diff(codes[order], prepend=-1))
    weights = np.add.reduceat(row_weights[order], first)
    ordered = values[order]
    ordered *= row_weights[order][:, None]
    sums = np.add.reduceat(ordered, first)
    return sums / weights[:, None], weights


@dataclass
class SummaryTree:
    """Summaries of persons, and merged ones of sets of them.

    A set is halved by the bits of its keys, and the halves are kept for the next set. So most of
    them are found again when another person is left out, and what a set gives depends on it alone.
    """

    persons: dict[int, RowSummary] = field(default_factory=dict)
    _halves: dict[tuple[int, int], tuple[tuple[int, ...], RowSummary]] = field(default_factory=dict)

    def merge(self, keys: tuple[int, ...], bit: int = 0) -> RowSummary:
        """Summary of the persons with some keys, which agree in the bits below ``bit``."""
        if len(keys) == 1:
            return self.persons[keys[0]]
        place = bit, keys[0] & ((1 << bit) - 1)
        if self._halves.get(place, ((), None))[0] != keys:
            halves: dict[int, tuple[int, ...]] = {}
            for key in keys:
                side = key >> bit & 1
                halves[side] = (*halves.get(side, ()), key)
            merged = merge_summaries([self.merge(half, bit + 1) for half in halves.values()])
            self._halves[place] = keys, merged
        return self._halves[place][1]
