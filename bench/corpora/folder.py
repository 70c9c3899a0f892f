"""Stored corpora: a folder each in the user's data folder, checked and mapped when it is opened.

``frames.npy``, ``lengths.npy`` and ``captures.parquet`` hold the corpus. ``corpus.json`` holds the rest, and under
``info.stored`` size and SHA-256 of each file and a checksum of itself; it never
changes. ``seal.json`` says what ``frames.npy`` looked like (size, times, inode) when its SHA-256 was last found right.

Small files are hashed at each opening, frames only when they look different. This finds damage and changes by
accident; who can write into the folder can also write a corpus of their own there.
"""

from __future__ import annotations

import copyreg
import hashlib
import io
import json
import math
import os
import re
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, unblinded
from bench.corpora.files import Damaged, clear, compare, sha256_of, short, small_file, stamp, write_text
from bench.errors import InputError
from bench.scratch import home, owner

SMALL = ("lengths.npy", "captures.parquet")
FILES = ("frames.npy", *SMALL)
ABOUT = ("name", "digest", "rate_hz", "full_scale", "info")  # in corpus.json
HASH = "[0-9a-f]{64}"
_seen: set[tuple] = set()  # what was verified in folders that cannot be written, so that no seal can tell


@dataclass(frozen=True)
class Address:
    """Where a stored corpus is found again, by another process or on another machine.

    Attributes:
        path: of its folder.
        within: the same, from the data folder on, which may lie elsewhere there; None for a folder that is not in it.
        digest: of the corpus.
    """

    path: Path
    within: Path | None
    digest: str

    def open(self) -> Corpus:
        """Map it, from a folder of that name, if it is the same corpus.

        Raises:
            InputError: it is in none of them, or damaged.
        """
        refused = None
        for folder in dict.fromkeys((self.path, home() / (self.within or self.path))):
            try:
                corpus = open_folder(folder)
            except InputError as e:
                refused = refused or e
                continue
            if corpus.digest == self.digest:
                return corpus
            refused = refused or InputError(
                f"{short(folder)} was replaced by another corpus while it was in use; start the command again"
            )
        raise refused or InputError(f"{short(self.path)} is not there; import it again")


def address(corpus: Corpus) -> Address:
    """Where a stored corpus is found again.

    Raises:
        ValueError: it is not stored.
    """
    if corpus.path is None:
        raise ValueError(f"{corpus.name} is not stored")
    within = corpus.path.relative_to(home()) if corpus.path.is_relative_to(home()) else None
    return Address(corpus.path, within, corpus.digest)


def reopen(where: Address, index: np.ndarray, target: str, visible: tuple[str, ...] | None) -> Corpus:
    """Map captures of a stored corpus again in another process, so that frames never travel."""
    corpus = where.open()[index].with_target(target)
    return corpus if visible is None else corpus.blind(visible)


def _reduced(corpus: Corpus) -> str | tuple:
    """How a corpus travels to another process: a stored one by its address, so that frames never do."""
    whole, visible = unblinded(corpus)
    if whole.path is None or whole.steps:
        return object.__reduce_ex__(corpus, 2)
    return reopen, (address(whole), whole.index, whole.target, visible)


copyreg.pickle(Corpus, _reduced)


def content_digest(corpus: Corpus) -> str:
    """SHA-256 over frames, lengths, captures, rate and scale of a whole corpus."""
    h = hashlib.sha256()
    numbers = [n.item() if isinstance(n, np.generic) else n for n in (corpus.rate_hz, corpus.full_scale)]
    h.update(repr((corpus.frames.shape, corpus.frames.dtype.str, *numbers)).encode())
    h.update(np.ascontiguousarray(corpus.frames).data)
    h.update(np.ascontiguousarray(corpus.lengths, dtype=np.int64).data)
    h.update(corpus.captures.to_csv(index=False).encode())
    return h.hexdigest()


def write_folder(corpus: Corpus, folder: Path, digest: str = "") -> None:
    """Store a whole corpus as a folder, written beside its name and renamed.

    A folder that is there already stays if it holds the same corpus unharmed; else it is replaced.

    Args:
        corpus: what to store.
        folder: where.
        digest: its `content_digest`, if that is known.

    Raises:
        OSError: the folder cannot be written.
    """
    digest = digest or content_digest(corpus)
    folder.parent.mkdir(parents=True, exist_ok=True)
    clear(folder.parent)
    if _holds(folder, digest):
        return
    beside, aside = (Path(tempfile.mkdtemp(prefix=f".{owner()}", dir=folder.parent)) for _ in range(2))
    try:
        np.save(beside / "frames.npy", np.ascontiguousarray(corpus.frames))
        np.save(beside / "lengths.npy", np.asarray(corpus.lengths, dtype=np.int64))
        corpus.captures.to_parquet(beside / "captures.parquet", index=False)
        about = {n: getattr(corpus, n) for n in ABOUT} | {"digest": digest}
        _seal_all(beside, about, folder.name, {n: sha256_of(beside / n) for n in FILES})
        if os.path.lexists(folder) and not _holds(folder, digest):
            folder.rename(aside / "old")
        if not os.path.lexists(folder):
            beside.rename(folder)
    except OSError:
        if not _holds(folder, digest):  # else another process was faster by a moment
            raise
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        shutil.rmtree(aside, ignore_errors=True)


def _holds(folder: Path, digest: str) -> bool:
    """Whether a corpus is there already, unharmed."""
    try:
        about, _ = _about(folder)
    except Damaged:
        return False
    return about["digest"] == digest and not any(verified(folder, folder.name).values())


def open_folder(folder: Path, key: str = "") -> Corpus:
    """Map a stored corpus, if it is what was stored.

    Args:
        folder: where it is.
        key: the name of the folder that it was written for, if that matters.

    Raises:
        InputError: the folder does not hold a complete corpus, unchanged.
    """
    try:
        about, stored = _about(folder)
        if key and stored["folder"] != key:
            raise Damaged(f"it was written for {stored['folder'][:40]}")
        contents = {name: small_file(folder / name, stored["files"][name]) for name in SMALL}
        _check_frames(folder, *stored["files"]["frames.npy"])
        return _corpus(folder, about, contents)
    except Damaged as e:
        raise InputError(f"{short(folder)} was changed or damaged ({e}); import it again") from e


def verified(folder: Path, key: str = "") -> dict[str, str]:
    """What is wrong with each file, ``""`` for nothing: all are read and hashed anew.

    Args:
        folder: of a corpus.
        key: the name of the folder that it was written for, if that matters.
    """
    try:
        _, stored = _about(folder)
    except Damaged as e:
        return {"corpus.json": str(e)} | dict.fromkeys(FILES, "cannot be checked without corpus.json")
    found = dict.fromkeys(("corpus.json", *FILES), "")
    for name, (size, sha256) in stored["files"].items():
        try:
            compare(folder / name, size, sha256)
        except Damaged as e:
            found[name] = str(e)
    if found["frames.npy"]:  # however it looks, it is not to be opened again
        with suppress(OSError):
            (folder / "seal.json").unlink()
    if not any(found.values()):
        try:
            open_folder(folder, key)
        except InputError as e:
            found["corpus.json"] = str(e)
    return found


def _about(folder: Path) -> tuple[dict, dict]:
    """What ``corpus.json`` says, and what was stored beside it."""
    try:
        about = json.loads(small_file(folder / "corpus.json"))
    except (ValueError, RecursionError) as e:
        raise Damaged("corpus.json cannot be read") from e
    if not isinstance(about, dict) or set(about) != set(ABOUT) or not isinstance(about["info"], dict):
        raise Damaged("corpus.json does not say what a corpus is")
    stored = about["info"].pop("stored", None)
    if stored is None:
        raise Damaged("corpus.json does not say what was stored")
    if not isinstance(stored, dict) or stored.pop("sum", None) != _sum(about, stored):
        raise Damaged("corpus.json differs from what was stored")
    numbers = [about["rate_hz"], about["full_scale"]]
    if not (
        all(isinstance(n, int | float) and not isinstance(n, bool) and 0 < n < math.inf for n in numbers)
        and isinstance(about["name"], str)
        and isinstance(about["digest"], str)
        and re.fullmatch(HASH, about["digest"])
    ):
        raise Damaged("corpus.json holds impossible values")
    return about, stored


def _sum(about: dict, stored: dict) -> str:
    return hashlib.sha256(json.dumps([about, stored], sort_keys=True).encode()).hexdigest()


def _check_frames(folder: Path, size: int, sha256: str) -> None:
    """Compare the frames with what was stored, if they have changed since that was last done."""
    path = folder / "frames.npy"
    now = (sha256, *stamp(path))
    with suppress(Damaged, ValueError, RecursionError):
        if json.loads(small_file(folder / "seal.json")) == list(now):
            return
    if (path, *now) in _seen:
        return
    compare(path, size, sha256)
    try:
        clear(folder)
        write_text(folder / "seal.json", json.dumps(now))
    except OSError:
        _seen.add((path, *now))


def _seal_all(folder: Path, about: dict, key: str, files: dict[str, tuple[int, str]]) -> None:
    """Write ``corpus.json`` and ``seal.json`` beside files of these sizes and hashes."""
    about, stored = json.loads(json.dumps([about, {"folder": key, "files": files}], default=np.generic.item))
    about["info"]["stored"] = stored | {"sum": _sum(about, stored)}
    write_text(folder / "corpus.json", json.dumps(about, indent=1))
    write_text(folder / "seal.json", json.dumps([files["frames.npy"][1], *stamp(folder / "frames.npy")]))


def _corpus(folder: Path, about: dict, contents: dict[str, bytes]) -> Corpus:
    """The corpus itself, its parts checked against each other."""
    size = stamp(folder / "frames.npy")[0]
    try:
        frames = np.load(folder / "frames.npy", mmap_mode="r", allow_pickle=False)
        lengths = np.load(io.BytesIO(contents["lengths.npy"]), allow_pickle=False)
        captures = pd.read_parquet(io.BytesIO(contents["captures.parquet"]))
    except Exception as e:  # numpy and pyarrow raise a dozen types where bytes mean nothing
        raise Damaged(f"a file cannot be read: {' '.join(str(e).split())[:60]}") from e
    if not (
        isinstance(frames, np.memmap)
        and frames.ndim == 3
        and frames.offset + frames.nbytes == size
        and frames.size
        and frames.dtype.kind in "uif"
        and isinstance(lengths, np.ndarray)
        and lengths.dtype == np.int64
        and lengths.shape == (len(captures),)
        and lengths.min(initial=1) > 0
        and lengths.sum() == len(frames)
        and {"subject", "gesture"} <= set(captures)
    ):
        raise Damaged("frames, lengths and captures do not fit together")
    starts = np.cumsum(lengths) - lengths
    return Corpus(frames.view(np.ndarray), starts, lengths, captures, path=folder, **about)
