"""Scales by source: the values of each corpus are brought to the mean and SD of the tested ones.

The sensors and tasks of studies differ, and a robot knows its sensor. The scale of a source is
learned from its own training captures alone. Values of a source without any are not changed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin

from bench.corpora.corpus import Corpus
from bench.features.base import added_rows, source_of_rows

ADDED_SHARE = 0.35  # of a batch; fixed before the runs of docs/notes/numbers.md
ROUNDING = 1e-9  # share of a mean: a smaller SD is that of a constant


class SourceScales:
    """Scales that bring the values of each source to the mean and SD of all tested ones together.

    Values of the only tested source do not change, nor do those of a source without training rows.

    Args:
        values: training values of each source, by its name [rows, n].
        added: names of sources that are trained on and never tested.

    Attributes:
        maps: factor and shift [n] of each source whose values change.
        changes_tested: True if values of tested sources change, as several are tested.
    """

    def __init__(self, values: Mapping[str, np.ndarray], added: Collection[str] = ()) -> None:
        self.maps: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        tested = [name for name in values if name not in added]
        self.changes_tested = len(tested) > 1
        if len(values) < 2 or not tested:
            return
        wanted_mean, wanted_sd = _mean_and_sd(np.concatenate([values[name] for name in tested]))
        for name in values:
            if [name] != tested:
                mean, sd = _mean_and_sd(values[name])
                factor = np.divide(wanted_sd, sd, out=np.zeros_like(sd), where=sd > 0)
                self.maps[name] = factor, wanted_mean - factor * mean

    def apply(self, values: np.ndarray, sources: np.ndarray) -> np.ndarray:
        """Scaled values [rows, n], float32 if some change; ``sources`` has the name of each row."""
        changed = [name for name in self.maps if (sources == name).any()]
        values = values.astype(np.float32) if changed else values
        for name in changed:
            factor, shift = self.maps[name]
            rows = sources == name
            values[rows] = values[rows] * factor + shift
        return values

    def apply_to_frames(self, X: Corpus) -> Corpus:
        """Captures with scaled readings; the same ones if none changes."""
        if not np.isin(X.sources.astype(str), [*self.maps]).any():
            return X
        readings = X.frames.reshape(len(X.frames), -1)
        scaled = self.apply(readings, np.repeat(X.sources, X.lengths)).reshape(X.frames.shape)
        return X.with_fields(frames=scaled, digest="", path=None)


NO_SCALES = SourceScales({})


def _mean_and_sd(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and SD [n] of values [rows, n]; the SD of constant ones is 0."""
    mean, sd = values.mean(axis=0, dtype=np.float64), values.std(axis=0, dtype=np.float64)
    return mean, np.where(sd > ROUNDING * np.abs(mean), sd, 0.0)


def learn_scales(X: Corpus, read: Callable[[Corpus], np.ndarray]) -> SourceScales:
    """Learn scales from training captures, of which ``read`` returns the values [rows, n]."""
    sources = X.sources.astype(str)
    names = np.unique(sources)
    if len(names) < 2:
        return NO_SCALES
    values = {str(name): read(X[np.flatnonzero(sources == name)]) for name in names}
    return SourceScales(values, {*sources[X.is_added]})


def read_readings(X: Corpus) -> np.ndarray:
    """All readings of captures as one value, so that the taxels keep their differences [n, 1]."""
    return X.frames.reshape(-1, 1)


class SourceScaler(TransformerMixin, BaseEstimator):
    """Brings the features of each source to one mean and SD (`SourceScales`).

    Rows are told apart by the index that feature sets give the captures of joined corpora.
    """

    def fit(self, X: pd.DataFrame | np.ndarray, y: object = None) -> SourceScaler:
        """Learn from a table of training rows."""
        sources, values = source_of_rows(X), np.asarray(X)
        names, self.scales_ = np.unique(sources), NO_SCALES
        if len(names) > 1:
            parts = {str(name): values[sources == name] for name in names}
            self.scales_ = SourceScales(parts, {*sources[added_rows(X)]})
        return self

    def transform(self, X: pd.DataFrame | np.ndarray) -> pd.DataFrame | np.ndarray:
        """The table [rows, n] with scaled values."""
        scaled = self.scales_.apply(np.asarray(X), source_of_rows(X))
        return pd.DataFrame(scaled, X.index, X.columns) if isinstance(X, pd.DataFrame) else scaled


def weigh_added(weights: np.ndarray, is_added: np.ndarray) -> np.ndarray:
    """Weights of rows, of which those of ``also=`` have `ADDED_SHARE` of the sum."""
    if not is_added.any():
        return weights
    factor = ADDED_SHARE / (1 - ADDED_SHARE) * weights[~is_added].sum() / weights[is_added].sum()
    return np.where(is_added, factor * weights, weights)


def count_batches(is_added: np.ndarray, batch: int) -> int:
    """Number of batches of an epoch, a pass over all samples that are not added; at least 1."""
    own = batch - round(ADDED_SHARE * batch) * bool(is_added.any())
    return max(int((~is_added).sum()) // own, 1)


def draw_batches(generator: np.random.Generator, is_added: np.ndarray, batch: int) -> np.ndarray:
    """Draw the batches of an epoch [batches, batch]; added samples are `ADDED_SHARE` of each."""
    batches = count_batches(is_added, batch)
    if not is_added.any():
        return generator.permutation(len(is_added))[: batches * batch].reshape(batches, batch)
    added = round(ADDED_SHARE * batch)
    columns = []
    for rows, count in ((~is_added, batch - added), (is_added, added)):
        passes = -(-batches * count // int(rows.sum()))
        order = [generator.permutation(np.flatnonzero(rows)) for _ in range(passes)]
        columns.append(np.concatenate(order)[: batches * count].reshape(batches, count))
    return np.concatenate(columns, axis=1)
