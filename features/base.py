"""The base of feature sets: scikit-learn transformers from captures to a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeGuard

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from bench.corpora.corpus import COPY, Corpus, unblind
from bench.errors import HiddenError, InputError
from bench.features.cache import load_or_extract

# Values that vary by less are constant up to rounding, in single precision and in C, too.
RELATIVE_ROUNDING = 1e-6  # share of the largest magnitude
ABSOLUTE_ROUNDING = 1e-12
SOURCE_LEVELS = ["capture", "copy", "source", "added"]  # of the index of tables; the first two, too


def is_constant(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Return True for features that are constant up to rounding, bool [n_features]."""
    values = np.asarray(X)
    lowest, highest = (v.astype(np.float64) for v in (values.min(axis=0), values.max(axis=0)))
    rounding = RELATIVE_ROUNDING * np.maximum(np.abs(lowest), np.abs(highest))
    return highest - lowest <= np.maximum(rounding, ABSOLUTE_ROUNDING)


class FeatureSet(TransformerMixin, BaseEstimator):
    """Turns a `Corpus` into a DataFrame [captures, n_features] with named columns.

    A feature set has ``extract(corpus)``, which learns nothing. One that learns has ``learns =
    True`` and its own ``fit`` and ``transform``; it takes what it computes without learning from
    `extracted_table`.

    The table of a stored corpus is computed once and stored in the data folder
    (`bench.features.cache`), so folds and models share it. Its key has the digest of the corpus,
    the parameters and the source code, so it is never stale. Features of a corpus in memory are
    computed each time.

    Attributes:
        learns: True if values depend on the training captures.
        conditions: columns of the captures that it needs besides frames (`bench.contract`).
    """

    learns = False
    conditions: tuple[str, ...] = ()

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        raise NotImplementedError

    def fit(self, X: Corpus, y: object = None) -> FeatureSet:
        """Learn the names of the features, which follow the grid, and nothing else."""
        self.names_ = self.extract(X[:1].blind(self.conditions)).columns
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Features of each capture [captures, n_features].

        Pieces and copies of captures (`bench.models.steps`) have capture and copy as their index.
        """
        return self.extracted_table(X)

    def extracted_table(self, X: Corpus) -> pd.DataFrame:
        """Table of `extract`, loaded or computed; scikit-learn's set_output does not change it."""
        table = load_or_extract(self, X)
        stored = unblind(X)
        if stored.steps:
            table = table.set_axis(capture_copy_index(stored.index, stored.piece // COPY))
        return index_by_source(table, stored)

    def cache_identity(self) -> tuple[str, object, type | Callable]:
        """What its values depend on besides captures: name, parameters and code."""
        return type(self).__name__, sorted(self.get_params().items()), type(self)

    def get_feature_names_out(self, input_features: object = None) -> np.ndarray:
        """Names of the columns, str [n_features], once fitted."""
        check_is_fitted(self, "names_")
        return self.names_.to_numpy(dtype=object)

    def keeps(self, frames: int, taxels: int) -> int:
        """Numbers in memory while the features of a capture are computed.

        By default the whole capture; a set that needs only signals of it overrides this.
        """
        return frames * taxels

    def __sklearn_is_fitted__(self) -> bool:
        return not self.learns or any(name.endswith("_") for name in vars(self))


class FunctionFeatures(FeatureSet):
    """A user's function as a feature set; it learns nothing, so its table is stored like ours.

    Args:
        function: function of a `Corpus` that returns a row of numbers for each capture: an array
            [captures, n_features] or a table.
        parameters: its further arguments.
    """

    def __init__(self, function: Callable[..., object], parameters: dict[str, object]) -> None:
        self.function, self.parameters = function, parameters

    @property
    def conditions(self) -> tuple[str, ...]:
        """Columns that the function declares to need, in its attribute ``conditions``."""
        return getattr(self.function, "conditions", ())

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Call the function: features of each capture [captures, n_features].

        Raises:
            InputError: it returns no row of numbers for each capture.
        """
        values, name = self.function(corpus, **self.parameters), self.function.__name__
        if not isinstance(values, pd.DataFrame):
            try:
                values = np.asarray(values)
            except ValueError as e:
                counts = [np.size(row) for row in values]
                raise InputError(
                    f"{name} returns rows of {min(counts)} to {max(counts)} numbers; give each "
                    "capture the same features"
                ) from e
            if values.ndim not in (1, 2):
                raise InputError(
                    f"{name} returns an array of shape {values.shape}; give [captures, features]"
                )
        table = pd.DataFrame(values).rename(columns=str).reset_index(drop=True)
        if len(table) != len(corpus):
            raise InputError(
                f"{name} returns {len(table)} rows for {len(corpus)} captures; return a row for "
                "each"
            )
        if not table.columns.is_unique:
            twice = table.columns[table.columns.duplicated()][0]
            raise InputError(f"{name} returns two features named {twice!r}; rename one")
        for column in table:
            if table[column].dtype.kind not in "biuf":
                raise InputError(
                    f"{name} returns {table[column].iloc[0]!r} as feature {column}; give numbers"
                )
        return table

    def check_captures(self, X: Corpus) -> None:
        """Refuse a function that fails on captures, or gives no capture a value of some feature."""
        name = self.function.__name__
        try:
            is_missing = self.extract(X.blind(self.conditions)).isna().all()
        except InputError as e:
            raise InputError(f"features={e}") from e
        except HiddenError as e:
            raise InputError(f"features={name}: {e}") from e
        except Exception as e:  # a function of the user's may raise anything
            raise InputError(f"features={name}: it raises {type(e).__name__}: {e}") from e
        if is_missing.any():
            raise InputError(
                f"features={name}: feature {is_missing.idxmax()} is NaN for a capture of every "
                "class; repair it or leave it out"
            )

    def cache_identity(self) -> tuple[str, object, type | Callable]:
        """Name, parameters and code of the function."""
        return self.function.__name__, sorted(self.parameters.items()), self.function


def is_stateless(features: object) -> bool:
    """Return True for a feature set whose table is what it extracts, whatever it is fitted to."""
    if not isinstance(features, FeatureSet):
        return False
    kind = type(features)
    return kind.fit is FeatureSet.fit and kind.transform is FeatureSet.transform


def capture_copy_index(capture: np.ndarray, copy: np.ndarray) -> pd.MultiIndex:
    """Index of a table by capture and copy; three times as fast as ``MultiIndex.from_arrays``."""
    captures, capture_codes = np.unique(capture, return_inverse=True)
    copies, copy_codes = np.unique(copy, return_inverse=True)
    return pd.MultiIndex(
        [captures, copies],
        [capture_codes, copy_codes],
        names=["capture", "copy"],
        verify_integrity=False,
    )


def has_capture_copy_index(X: pd.DataFrame | np.ndarray) -> TypeGuard[pd.DataFrame]:
    """Return True for a table whose index has capture and copy."""
    return isinstance(X, pd.DataFrame) and X.index.names[:2] == SOURCE_LEVELS[:2]


def index_by_source(
    table: pd.DataFrame, X: Corpus, rows: np.ndarray | slice = slice(None)
) -> pd.DataFrame:
    """Add the sources of captures of joined corpora to the index; other tables stay.

    Args:
        table: features.
        X: captures, not blind.
        rows: position in ``X`` of the capture of each row.
    """
    if not X.is_joined:
        return table
    levels = [X.index[rows], X.piece[rows] // COPY]
    if has_capture_copy_index(table):
        levels = [table.index.get_level_values(name) for name in SOURCE_LEVELS[:2]]
    levels += [X.sources[rows], X.is_added[rows]]
    return table.set_axis(pd.MultiIndex.from_arrays(levels, names=SOURCE_LEVELS))


def without_sources(X: pd.DataFrame | np.ndarray) -> pd.DataFrame | np.ndarray:
    """The table without the sources in its index, for a system with one scale."""
    if has_capture_copy_index(X) and "source" in X.index.names:
        return X.droplevel(SOURCE_LEVELS[2:])
    return X


def source_of_rows(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Corpus that each row comes from, str [rows]; without `index_by_source` all the same."""
    if has_capture_copy_index(X) and "source" in X.index.names:
        return X.index.get_level_values("source").to_numpy(dtype=object).astype(str)
    return np.full(len(X), "")


def added_rows(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Return True for rows of captures of ``also=``, bool [rows]."""
    if has_capture_copy_index(X) and "added" in X.index.names:
        return np.asarray(X.index.get_level_values("added"), dtype=bool)
    return np.zeros(len(X), dtype=bool)


def capture_of_rows(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Capture of each row, numbered from 0; without an index by capture, each row is one."""
    if not has_capture_copy_index(X):
        return np.arange(len(X))
    return np.unique(X.index.get_level_values("capture"), return_inverse=True)[1]


def undamaged_rows(X: pd.DataFrame | np.ndarray) -> np.ndarray:
    """Return True for rows of undamaged captures, bool [rows]."""
    if not has_capture_copy_index(X):
        return np.ones(len(X), dtype=bool)
    return np.asarray(X.index.get_level_values("copy") == 0)


def check_choice(parameter: str, value: str, values: Sequence[str]) -> None:
    """Raise an InputError for a parameter that has none of its possible values."""
    if value not in values:
        raise InputError(f"features.{parameter}={value}: give {' or '.join(values)}")
