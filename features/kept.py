"""Tables of features, kept in the data folder: computed once per corpus, shared by folds and models."""

from __future__ import annotations

import hashlib
import os
import tempfile
from functools import lru_cache
from pathlib import Path

import pandas as pd
from sklearn.base import BaseEstimator

from bench.corpora.corpus import Corpus
from bench.corpora.folder import home, open_folder
from bench.source import source_digest


def of_corpus(features: BaseEstimator, X: Corpus) -> pd.DataFrame:
    """Features of each capture [captures, n_features]: kept for a stored corpus, computed for one in memory."""
    if not X.digest or X.path is None:
        return features.extract(X)
    path = home() / "features" / f"{cache_key(features, X.digest)}.parquet"
    try:
        table = _read(path)
    except (OSError, ValueError):  # not there yet, or damaged
        if not _writable(path.parent):
            return features.extract(X)
        whole = open_folder(X.path)
        if whole.digest != X.digest:  # replaced by another corpus while this one is mapped
            return features.extract(X)
        table = features.extract(whole)
        _keep(table, path)
    return table.iloc[X.index].reset_index(drop=True)


def cache_key(features: BaseEstimator, digest: str) -> str:
    """Hash of corpus, class, parameters and source code."""
    kind = type(features)
    parts = [digest, kind.__name__, repr(sorted(features.get_params().items())), source_digest(kind)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


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
