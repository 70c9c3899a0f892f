"""Feature tables in the data folder: computed once per corpus, shared by folds and models.

The name of a table is a hash of all that its values depend on. Each file has a digest; a damaged
one is computed again.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from sklearn.base import BaseEstimator

from bench.corpora.corpus import Corpus, unblind
from bench.corpora.folder import open_folder
from bench.features.signals import capture_blocks
from bench.ground.digests import check_parquet, write_parquet_with_digest
from bench.ground.scratch import data_folder, remove_path, write_then_rename
from bench.ground.source import loaded_code_digest

BLOCK_VALUES = 1 << 24  # sensor values of captures whose features are computed at once
KEPT_BYTES = 1 << 26  # of a file whose table stays in memory for the next fold
pa.set_memory_pool(pa.system_memory_pool())  # which returns freed memory at once
PIECE_COLUMNS = ("of capture", "piece")  # columns that identify the rows of a table after steps


def load_or_extract(features: BaseEstimator, X: Corpus) -> pd.DataFrame:
    """Features of each capture [captures, n_features]; of a stored corpus, loaded if stored."""
    stored, visible = unblind(X), features.conditions
    table = _load_or_store(features, stored, stored.steps)
    if table is None:
        return features.extract(X.blind(visible))
    if not stored.steps:
        return table.iloc[stored.index].reset_index(drop=True)
    pieces = pd.MultiIndex.from_arrays([stored.index, stored.piece])
    rows = pd.MultiIndex.from_frame(table[[*PIECE_COLUMNS]]).get_indexer(pieces)
    return table.iloc[rows].drop(columns=[*PIECE_COLUMNS])


def load_after_steps(features: BaseEstimator, X: Corpus, steps: tuple) -> pd.DataFrame | None:
    """Features of all captures of a stored corpus after steps, with `PIECE_COLUMNS`, else None."""
    stored = unblind(X)
    return None if stored.steps or not steps else _load_or_store(features, stored, steps)


def _load_or_store(features: BaseEstimator, stored: Corpus, steps: tuple) -> pd.DataFrame | None:
    """Load the table of all captures after steps, or extract and store it.

    None for captures that belong to no stored corpus, and if the table cannot be stored.
    """
    if not stored.digest or stored.path is None:
        return None
    path = _table_path(features, stored.digest, steps)
    table = _load_table(path)
    if table is None:
        table = _extract_and_store(features, stored, steps, path)
    pa.default_memory_pool().release_unused()  # of the columns that Arrow read or wrote
    return table


def _extract_and_store(
    features: BaseEstimator, stored: Corpus, steps: tuple, path: Path
) -> pd.DataFrame | None:
    """Extract the table of all captures after steps, and store it; None if it cannot be stored."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
    corpus = open_folder(stored.path) if os.access(path.parent, os.W_OK) else None
    # Another corpus may have replaced the one that is mapped.
    if corpus is None or corpus.digest != stored.digest:
        return None
    table = _extract_blocks(features, corpus.blind(features.conditions), steps)
    table.to_parquet(buffer := BytesIO(), index=False)
    with suppress(OSError):  # a full disk only costs time
        if path.exists() and not path.is_file():
            remove_path(path)
        with write_then_rename(path) as part, part.open("wb") as file:
            write_parquet_with_digest(buffer.getbuffer(), file)
    return table


def cache_key(features: BaseEstimator, digest: str, steps: tuple = ()) -> str:
    """Hash of corpus, steps, class, parameters and source code."""
    name, parameters, own_code = features.cache_identity()
    code = loaded_code_digest(own_code, *(code for step in steps for code in step.code_objects()))
    parts = (digest, name, repr(parameters), code, repr(steps))
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


def _table_path(features: BaseEstimator, digest: str, steps: tuple) -> Path:
    return data_folder() / "features" / f"{cache_key(features, digest, steps)}.parquet"


def _load_table(path: Path) -> pd.DataFrame | None:
    """Load a stored table; None if there is none, or a damaged one."""
    try:
        is_large = path.is_file() and path.stat().st_size > KEPT_BYTES
        return _read_table.__wrapped__(path) if is_large else _read_table(path)
    except Exception:  # pyarrow raises a dozen types for damaged bytes
        return None


@lru_cache(maxsize=4)
def _read_table(path: Path) -> pd.DataFrame:
    if not path.is_file():  # a pipe would wait
        raise FileNotFoundError(path)
    with path.open("rb") as file:
        check_parquet(file.read())
        file.seek(0)
        return pd.read_parquet(file)


def _extract_blocks(features: BaseEstimator, corpus: Corpus, steps: tuple) -> pd.DataFrame:
    """Extract the features of all captures in blocks; after steps, with `PIECE_COLUMNS`.

    The table lies in memory column by column, as one that is loaded. Matrix products round by this
    order, so a fit would otherwise depend on whether its features were stored before.
    """
    tables, pieces = [], []
    for block in (capture_blocks(corpus) if steps else capture_blocks(corpus, BLOCK_VALUES)) or [
        slice(0, 0)
    ]:
        part = corpus[block]
        for step in steps:
            part = step(part)
        tables.append(features.extract(part))
        pieces.append((unblind(part).index, unblind(part).piece))
    table = {name: np.concatenate([part[name].to_numpy() for part in tables]) for name in tables[0]}
    if steps:
        table |= dict(
            zip(PIECE_COLUMNS, map(np.concatenate, zip(*pieces, strict=True)), strict=True)
        )
    return pd.DataFrame(table)
