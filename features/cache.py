"""Tables of features, kept in the data folder: computed once per corpus, shared by folds and models.

A table says in its file what it was computed from, and a checksum of its values. One that is damaged, or another's, is
computed again.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from bench.corpora.corpus import Corpus, origin
from bench.corpora.folder import Damaged, open_folder, stamp
from bench.features.signals import blocks
from bench.ground.scratch import home, replacing
from bench.ground.source import source_digest

BLOCK = 1 << 24  # sensor values of captures whose features are computed at once
_source: Callable[..., str] = lru_cache(maxsize=64)(
    source_digest
)  # code that is loaded does not change
PIECES = (
    "of capture",
    "piece",
)  # columns of a kept table that tell its rows, where steps were taken


def of_corpus(features: BaseEstimator, X: Corpus) -> pd.DataFrame:
    """Features of each capture [captures, n_features]: kept for a stored corpus, computed for one in memory."""
    stored, visible = origin(X), features.conditions
    X = X.blind(visible)
    if not stored.digest or stored.path is None:
        return features.extract(X)
    contents = _contents(features, stored.digest, stored.steps)
    if (table := _kept(contents)) is None:
        corpus = open_folder(stored.path) if _writable(_path(contents).parent) else None
        if (
            corpus is None or corpus.digest != stored.digest
        ):  # replaced by another corpus while this one is mapped
            return features.extract(X)
        table = _extracted(features, corpus.blind(visible), stored.steps)
        _keep(table, contents)
    if not stored.steps:
        return table.iloc[stored.index].reset_index(drop=True)
    pieces = pd.MultiIndex.from_arrays([stored.index, stored.piece])
    rows = pd.MultiIndex.from_frame(table[[*PIECES]]).get_indexer(pieces)
    return table.iloc[rows].drop(columns=[*PIECES])


def after(features: BaseEstimator, X: Corpus, steps: tuple) -> pd.DataFrame | None:
    """Cached features after some steps, of every capture of a stored corpus, with `PIECES`; None if there are none."""
    stored = origin(X)
    if not stored.digest or stored.path is None or stored.steps or not steps:
        return None
    return _kept(_contents(features, stored.digest, steps))


def _kept(contents: tuple[str, ...]) -> pd.DataFrame | None:
    """The table that was computed from these; None if there is none, or a damaged one."""
    try:
        return _read(_path(contents), contents)
    except Exception:  # pyarrow raises a dozen types where bytes mean nothing
        return None


def _extracted(features: BaseEstimator, corpus: Corpus, steps: tuple) -> pd.DataFrame:
    """Features of all captures of a corpus, computed in blocks; after steps, with columns that tell of which piece.

    The table is laid out in memory as one that is read back, column by column. Matrix products round by this order, so
    that a fit would else depend on whether its features were kept before.
    """
    tables, pieces = [], []
    for block in (blocks(corpus) if steps else blocks(corpus, BLOCK)) or [slice(0, 0)]:
        part = corpus[block]
        for step in steps:
            part = step(part)
        tables.append(features.extract(part))
        pieces.append((origin(part).index, origin(part).piece))
    table = {name: np.concatenate([part[name].to_numpy() for part in tables]) for name in tables[0]}
    if steps:
        table |= dict(zip(PIECES, map(np.concatenate, zip(*pieces, strict=True)), strict=True))
    return pd.DataFrame(table)


def cache_key(features: BaseEstimator, digest: str, steps: tuple = ()) -> str:
    """Hash of corpus, steps, class, parameters and source code."""
    return _path(_contents(features, digest, steps)).stem


def _contents(features: BaseEstimator, digest: str, steps: tuple) -> tuple[str, ...]:
    """What a table is computed from."""
    kind = type(features)
    code = _source(kind, *(code for step in steps for code in step.code()))
    return digest, kind.__name__, repr(sorted(features.get_params().items())), code, repr(steps)


def _path(contents: tuple[str, ...]) -> Path:
    """Where a table is kept."""
    return (
        home() / "features" / f"{hashlib.sha256(repr(contents).encode()).hexdigest()[:32]}.parquet"
    )


@lru_cache(maxsize=4)
def _read(path: Path, contents: tuple[str, ...]) -> pd.DataFrame:
    """A stored table; its name is made of all that it depends on, so it need not be read twice."""
    stamp(path)  # a folder would be read as a table in parts, a pipe would wait for ever
    table = pd.read_parquet(path)
    attributes, table.attrs = table.attrs, {}
    if attributes != {"about": list(contents), "sum": _sum(table)}:
        raise Damaged(f"{path.name} differs from what was kept")
    return table


def _sum(table: pd.DataFrame) -> str:
    """SHA-256 of the names, types and values of a table; what is no number is one value, whatever its bits."""
    kinds = repr([(name, str(kind)) for name, kind in table.dtypes.items()])
    rows = pd.util.hash_pandas_object(table, index=False).to_numpy()
    return hashlib.sha256(kinds.encode() + rows.tobytes()).hexdigest()


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _keep(table: pd.DataFrame, contents: tuple[str, ...]) -> None:
    """Write a table; where that cannot be done, such as on a full disk, the values are merely computed again."""
    signed = table.copy(deep=False)
    signed.attrs = {"about": contents, "sum": _sum(table)}
    with suppress(OSError), replacing(_path(contents)) as beside:
        signed.to_parquet(beside, index=False)
