"""The base of feature sets: a scikit-learn transformer from captures to a table, computed once per corpus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeGuard

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from bench.corpora.corpus import COPY, Corpus, origin
from bench.errors import InputError
from bench.features.cache import of_corpus

FLAT = 1e-9  # what moves by less than this share of its largest magnitude is constant but for rounding,
NOTHING = 1e-15  # and so is what moves by less than this


def constant(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Features that do not vary, bool [n_features]."""
    values = np.asarray(X, dtype=np.float64)
    return np.ptp(values, axis=0) <= np.maximum(FLAT * np.abs(values).max(axis=0), NOTHING)


class FeatureSet(TransformerMixin, BaseEstimator):
    """Turns a `Corpus` into a DataFrame [captures, n_features] with named columns.

    A feature set gives ``extract(corpus)``, which learns nothing. One that also learns has ``learns = True`` and
    its own ``fit`` and ``transform``; what it computes without learning it takes from `unlearnt`.

    For a stored corpus the table of all its captures is kept in the data folder, under the digest of the corpus, the
    parameters and the source code that the values depend on, so folds and models share it and a change of code or data
    never meets stale values. A corpus in memory is computed each time.
    """

    learns = False
    conditions: tuple[
        str, ...
    ] = ()  # columns of the captures that it needs besides frames (`bench.contract`)

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        raise NotImplementedError

    def fit(self, X: Corpus, y: object = None) -> FeatureSet:
        """Learn nothing but the names of the features, which follow the grid."""
        self.names_ = self.extract(X[:1].blind(self.conditions)).columns
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Features of each capture [captures, n_features].

        Those of pieces and copies of captures (`bench.models.steps`) are labelled by capture and copy.
        """
        return self.unlearnt(X)

    def unlearnt(self, X: Corpus) -> pd.DataFrame:
        """The table of `extract`, kept or computed; unlike `transform` never renamed by scikit-learn's set_output."""
        table = of_corpus(self, X)
        stored = origin(X)
        return table.set_axis(labels(stored.index, stored.piece // COPY)) if stored.steps else table

    def get_feature_names_out(self, input_features: object = None) -> np.ndarray:
        """Names of the columns, str [n_features], once fitted."""
        check_is_fitted(self, "names_")
        return self.names_.to_numpy(dtype=object)

    def keeps(self, frames: int, taxels: int) -> int:
        """Numbers in memory while the features of a capture of so many frames are computed.

        That is the whole capture, unless a set says that signals of it are enough.
        """
        return frames * taxels

    def __sklearn_is_fitted__(self) -> bool:
        return True


class OfFunction(TransformerMixin, BaseEstimator):
    """A function of the user's from captures to rows as a feature set; it learns nothing.

    Args:
        function: function of a `Corpus` that gives a row of numbers for each capture: an array [captures, n_features],
            or a table.
        parameters: further arguments.
    """

    def __init__(self, function: Callable[..., object], parameters: dict[str, object]) -> None:
        self.function, self.parameters = function, parameters

    def fit(self, X: Corpus, y: object = None) -> OfFunction:
        """Learn nothing."""
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Rows of the function [captures, n_features].

        Raises:
            InputError: it gives another number of rows.
        """
        table = pd.DataFrame(self.function(X, **self.parameters)).rename(columns=str)
        if len(table) != len(X):
            name = self.function.__name__
            raise InputError(
                f"{name} gives {len(table)} rows for {len(X)} captures; give a row of numbers for each"
            )
        return table

    def __sklearn_is_fitted__(self) -> bool:
        return True


def extracts_alone(features: object) -> bool:
    """Return True for a feature set whose table is what it extracts, whatever it is fitted to."""
    kind = type(features)
    return isinstance(features, FeatureSet) and (kind.fit, kind.transform) == (
        FeatureSet.fit,
        FeatureSet.transform,
    )


def labels(capture: np.ndarray, copy: np.ndarray) -> pd.MultiIndex:
    """Capture and copy of each row of a table; three times as fast as pandas' own way."""
    levels, codes = zip(
        *(np.unique(each, return_inverse=True) for each in (capture, copy)), strict=True
    )
    return pd.MultiIndex(levels, codes, names=["capture", "copy"], verify_integrity=False)


def labelled(X: pd.DataFrame | np.ndarray) -> TypeGuard[pd.DataFrame]:
    """Return True if the index of the rows is their capture and copy."""
    return isinstance(X, pd.DataFrame) and X.index.names == ["capture", "copy"]


def captures_of(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Capture of each row, numbered from 0; each of its own if rows are not labelled."""
    return (
        np.unique(X.index.get_level_values("capture"), return_inverse=True)[1]
        if labelled(X)
        else np.arange(len(X))
    )


def undamaged(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Rows without damage, bool [rows]."""
    return (
        np.asarray(X.index.get_level_values("copy") == 0)
        if labelled(X)
        else np.ones(len(X), dtype=bool)
    )


def one_of(parameter: str, value: str, values: Sequence[str]) -> None:
    """Refuse a parameter that has none of its values."""
    if value not in values:
        raise InputError(f"features.{parameter}={value}: give {' or '.join(values)}")
