"""Tables of features, kept in the data folder: computed once per corpus, shared by folds and models.

A table says in its file what it was computed from, and a checksum of its values. One that is damaged, or another's, is
computed again.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from bench.corpora.corpus import Corpus, origin
from bench.corpora.folder import Damaged, open_folder, stamp
from bench.scratch import home, owner
from bench.source import source_digest
from features.signals import blocks

PIECES = ("of capture", "piece")  # columns of a kept table that tell its rows, where steps were taken


def of_corpus(features: BaseEstimator, X: Corpus) -> pd.DataFrame:
    """Features of each capture [captures, n_features]: kept for a stored corpus, computed for one in memory."""
    known, visible = origin(X), features.conditions
    X = X.blind(visible)
    if not known.digest or known.path is None:
        return features.extract(X)
    about = _about(features, known.digest, known.steps)
    path = _path(about)
    try:
        table = _read(path, about)
    except Exception:  # not there yet, or damaged: pyarrow raises a dozen types where bytes mean nothing
        if not _writable(path.parent):
            return features.extract(X)
        whole = open_folder(known.path)
        if whole.digest != known.digest:  # replaced by another corpus while this one is mapped
            return features.extract(X)
        table = _by_column(_extracted(features, whole.blind(visible), known.steps))
        _keep(table, path, about)
    if not known.steps:
        return table.iloc[known.index].reset_index(drop=True)
    places = pd.MultiIndex.from_arrays([known.index, known.piece])
    rows = pd.MultiIndex.from_frame(table[[*PIECES]]).get_indexer(places)
    return table.iloc[rows].drop(columns=[*PIECES])


def after(features: BaseEstimator, X: Corpus, steps: tuple) -> pd.DataFrame | None:
    """Kept features of what steps make of every capture of a stored corpus, with `PIECES`; None if there are none."""
    known = origin(X)
    if not known.digest or known.path is None or known.steps or not steps:
        return None
    about = _about(features, known.digest, steps)
    try:
        return _read(_path(about), about)
    except Exception:  # not there, or damaged: as above
        return None


def is_kept(features: BaseEstimator, X: Corpus, steps: tuple = ()) -> bool:
    """Whether what steps make of the captures of a stored corpus has features that are kept."""
    known = origin(X)
    if not known.digest or known.path is None:
        return False
    return _path(_about(features, known.digest, (*known.steps, *steps))).exists()


def _extracted(features: BaseEstimator, whole: Corpus, steps: tuple) -> pd.DataFrame:
    """Features of all captures of a corpus; after steps, with columns that tell of which piece."""
    if not steps:
        return features.extract(whole)
    parts = []
    for block in blocks(whole):
        part = whole[block]
        for step in steps:
            part = step(part)
        known = origin(part)
        parts.append(features.extract(part).assign(**dict(zip(PIECES, (known.index, known.piece), strict=True))))
    return pd.concat(parts, ignore_index=True)


def _by_column(table: pd.DataFrame) -> pd.DataFrame:
    """A table laid out in memory as one that is read back, column by column.

    Matrix products round by this order, so that a fit would else depend on whether its features were kept before.
    """
    return pd.DataFrame({name: np.ascontiguousarray(column) for name, column in table.items()})


def cache_key(features: BaseEstimator, digest: str, steps: tuple = ()) -> str:
    """Hash of corpus, steps, class, parameters and source code."""
    return _key(_about(features, digest, steps))


def _about(features: BaseEstimator, digest: str, steps: tuple) -> tuple[str, ...]:
    """What a table is computed from."""
    kind = type(features)
    said = (digest, kind.__name__, repr(sorted(features.get_params().items())))
    if not steps:
        return *said, source_digest(kind)
    return *said, source_digest(kind, *(code for step in steps for code in step.code())), repr(steps)


def _path(about: tuple[str, ...]) -> Path:
    """Where a table is kept."""
    return home() / "features" / f"{_key(about)}.parquet"


def _key(about: tuple[str, ...]) -> str:
    return hashlib.sha256("\n".join(about).encode()).hexdigest()[:32]


@lru_cache(maxsize=4)
def _read(path: Path, about: tuple[str, ...]) -> pd.DataFrame:
    """A stored table; its name is made of all that it depends on, so it need not be read twice."""
    stamp(path)  # a folder would be read as a table in parts, a pipe would wait for ever
    table = pd.read_parquet(path)
    said, table.attrs = table.attrs, {}
    if said != {"about": list(about), "sum": _sum(table)}:
        raise Damaged(f"{path.name} differs from what was kept")
    return table


def _sum(table: pd.DataFrame) -> str:
    """SHA-256 of the names, types and values of a table; what is no number is one value, whatever its bits."""
    h = hashlib.sha256(repr([(name, str(kind)) for name, kind in table.dtypes.items()]).encode())
    h.update(repr(len(table)).encode())
    for name in table:
        values = table[name].to_numpy()
        if values.dtype.kind == "f" and (nothing := np.isnan(values)).any():
            values = np.where(nothing, np.nan, values)
        h.update(values.tobytes() if values.dtype.kind in "biuf" else repr(values.tolist()).encode())
    return h.hexdigest()


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _keep(table: pd.DataFrame, path: Path, about: tuple[str, ...]) -> None:
    """Write beside the final name and rename; where that cannot be done the values are merely computed again."""
    beside = None
    try:
        handle, beside = tempfile.mkstemp(prefix=f".{owner()}", dir=path.parent)
        os.close(handle)
        said = table.copy(deep=False)
        said.attrs = {"about": about, "sum": _sum(table)}
        said.to_parquet(beside, index=False)
        os.replace(beside, path)
    except OSError:  # such as a full disk
        if beside:
            Path(beside).unlink(missing_ok=True)
