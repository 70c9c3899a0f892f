"""Stored corpora: a folder each in the user's data folder, mapped when it is opened."""

from __future__ import annotations

import copyreg
import hashlib
import json
import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError


def reopen(path: Path, digest: str, index: np.ndarray, target: str) -> Corpus:
    """Map a stored corpus again in another process, so that frames never travel."""
    corpus = open_folder(path)
    if corpus.digest != digest:
        raise InputError(f"{path} was replaced by another corpus while it was in use; start the command again")
    return replace(corpus[index], target=target)


def _reduced(corpus: Corpus) -> tuple:
    """How a corpus travels to another process: a stored one by its address, so that frames never do."""
    if corpus.path is None:
        return object.__reduce_ex__(corpus, 2)
    return reopen, (corpus.path, corpus.digest, corpus.index, corpus.target)


copyreg.pickle(Corpus, _reduced)


def content_digest(corpus: Corpus) -> str:
    """SHA-256 over frames, lengths, captures, rate and scale of a whole corpus."""
    h = hashlib.sha256()
    h.update(repr((corpus.frames.shape, corpus.frames.dtype.str, corpus.rate_hz, corpus.full_scale)).encode())
    h.update(np.ascontiguousarray(corpus.frames).data)
    h.update(np.ascontiguousarray(corpus.lengths, dtype=np.int64).data)
    h.update(corpus.captures.to_csv(index=False).encode())
    return h.hexdigest()


def home() -> Path:
    """The user's data folder: imported corpora and cached features (``TOUCHBENCH_HOME`` overrides)."""
    if override := os.environ.get("TOUCHBENCH_HOME"):
        return Path(override)
    from platformdirs import user_data_path

    return user_data_path("touchbench")


def write_folder(corpus: Corpus, folder: Path) -> None:
    """Store a whole corpus as a folder, written beside its name and renamed; a folder that is there already stays.

    Raises:
        OSError: the folder cannot be written.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        np.save(beside / "frames.npy", np.ascontiguousarray(corpus.frames))
        np.save(beside / "lengths.npy", np.asarray(corpus.lengths, dtype=np.int64))
        corpus.captures.to_parquet(beside / "captures.parquet", index=False)
        meta = {
            "name": corpus.name,
            "digest": content_digest(corpus),
            "rate_hz": corpus.rate_hz,
            "full_scale": corpus.full_scale,
            "info": corpus.info,
        }
        (beside / "corpus.json").write_text(json.dumps(meta, indent=1))
        if not folder.exists():  # names are made of content hashes, so the same content is there already
            beside.rename(folder)
    except OSError:
        if not folder.exists():  # else another process was faster by a moment
            raise
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def open_folder(folder: Path) -> Corpus:
    """Map a stored corpus.

    Raises:
        InputError: the folder does not hold a complete corpus.
    """
    try:
        meta = json.loads((folder / "corpus.json").read_text())
        frames = np.load(folder / "frames.npy", mmap_mode="r")
        lengths = np.load(folder / "lengths.npy")
        captures = pd.read_parquet(folder / "captures.parquet")
    except (OSError, ValueError) as e:
        raise InputError(f"{folder} is not a complete corpus ({e}); import it again") from e
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
    return Corpus(frames.view(np.ndarray), starts, lengths, captures, path=folder, **meta)
