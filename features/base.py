"""What every feature set is: a scikit-learn transformer from captures to a table, computed once per corpus."""

from __future__ import annotations

import hashlib
import os
import tempfile
from functools import lru_cache
from pathlib import Path

import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin

from bench.corpus import Corpus, home, open_folder
from bench.source import source_digest


class FeatureSet(TransformerMixin, BaseEstimator):
    """Turns a `Corpus` into a DataFrame [captures, n_features] with named columns; nothing is learnt.

    A feature set gives ``extract(corpus)``. For a stored corpus the table of all its captures is kept in the data
    folder, under the digest of the corpus, the parameters and the source code that the values depend on, so folds and
    models share it and a change of code or data never meets stale values. A corpus in memory is computed each time.
    """

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        raise NotImplementedError

    def fit(self, X: Corpus, y: object = None) -> FeatureSet:
        """Learn nothing."""
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Features of each capture [captures, n_features]."""
        if not X.digest:
            return self.extract(X)
        path = home() / "features" / f"{self.cache_key(X.digest)}.parquet"
        if path.exists():
            table = _read(path, path.stat().st_mtime_ns)
        else:
            table = self.extract(open_folder(X.path))
            _keep(table, path)
        return table.iloc[X.index].reset_index(drop=True)

    def cache_key(self, digest: str) -> str:
        """Hash of corpus, class, parameters and source code."""
        parts = [digest, type(self).__name__, repr(sorted(self.get_params().items())), source_digest(type(self))]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    def __sklearn_is_fitted__(self) -> bool:
        return True


@lru_cache(maxsize=4)
def _read(path: Path, changed: int) -> pd.DataFrame:
    return pd.read_parquet(path)


def _keep(table: pd.DataFrame, path: Path) -> None:
    """Write beside the final name and rename; where that cannot be done the values are merely computed again."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(prefix=".", dir=path.parent)
        os.close(handle)
        table.to_parquet(beside, index=False)
        os.replace(beside, path)
    except OSError:
        return
