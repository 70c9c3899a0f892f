"""What every feature set is: a scikit-learn transformer from captures to a table, computed once per corpus."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from bench.corpus import Corpus, InputError, home, open_folder
from bench.source import source_digest


class FeatureSet(TransformerMixin, BaseEstimator):
    """Turns a `Corpus` into a DataFrame [captures, n_features] with named columns.

    A feature set gives ``extract(corpus)``, which learns nothing. One that also learns says so with ``learns`` and has
    its own ``fit`` and ``transform``; what it computes without learning it takes from `transform` of this class.

    For a stored corpus the table of all its captures is kept in the data folder, under the digest of the corpus, the
    parameters and the source code that the values depend on, so folds and models share it and a change of code or data
    never meets stale values. A corpus in memory is computed each time.
    """

    learns = False

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        raise NotImplementedError

    def fit(self, X: Corpus, y: object = None) -> FeatureSet:
        """Learn nothing but the names of the features, which follow the grid."""
        self.names_ = self.extract(X[:1]).columns
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Features of each capture [captures, n_features]."""
        if not X.digest or X.path is None:
            return self.extract(X)
        path = home() / "features" / f"{self.cache_key(X.digest)}.parquet"
        try:
            table = _read(path)
        except (OSError, ValueError):  # not there yet, or damaged
            if not _writable(path.parent):
                return self.extract(X)
            whole = open_folder(X.path)
            if whole.digest != X.digest:  # replaced by another corpus while this one is mapped
                return self.extract(X)
            table = self.extract(whole)
            _keep(table, path)
        return table.iloc[X.index].reset_index(drop=True)

    def get_feature_names_out(self, input_features: object = None) -> np.ndarray:
        """Names of the columns, str [n_features], once fitted."""
        check_is_fitted(self, "names_")
        return self.names_.to_numpy(dtype=object)

    def keeps(self, frames: int, taxels: int) -> int:
        """Numbers in memory while the features of a capture of so many frames are computed.

        That is the whole capture, unless a set says that signals of it are enough.
        """
        return frames * taxels

    def cache_key(self, digest: str) -> str:
        """Hash of corpus, class, parameters and source code."""
        parts = [digest, type(self).__name__, repr(sorted(self.get_params().items())), source_digest(type(self))]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    def __sklearn_is_fitted__(self) -> bool:
        return True


def one_of(parameter: str, value: str, known: Iterable[str]) -> None:
    """Check a parameter that has a few values.

    Raises:
        InputError: it is none of them.
    """
    if value not in known:
        raise InputError(f"features.{parameter}={value}: give {' or '.join(known)}")


@lru_cache(maxsize=4)
def _read(path: Path) -> pd.DataFrame:
    """A stored table; its name is made of all that it depends on, so it need not be read twice."""
    return pd.read_parquet(path)


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _keep(table: pd.DataFrame, path: Path) -> None:
    """Write beside the final name and rename; where that cannot be done the values are merely computed again."""
    beside = None
    try:
        handle, beside = tempfile.mkstemp(prefix=".", dir=path.parent)
        os.close(handle)
        table.to_parquet(beside, index=False)
        os.replace(beside, path)
    except OSError:  # such as a full disk
        if beside:
            Path(beside).unlink(missing_ok=True)
