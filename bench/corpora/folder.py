"""Stored corpora: a folder each in the user's data folder, checked and mapped when it is opened.

``frames.npy``, ``lengths.npy`` and ``captures.parquet`` hold the corpus. ``corpus.json`` holds the rest, and under
``info.stored`` size and SHA-256 of each file and a checksum of itself; it never changes. ``seal.json`` holds size,
times and inode of ``frames.npy`` when its SHA-256 was last verified.

Small files are hashed at each opening, frames only when they look different. This finds damage and changes by
accident; who can write into the folder can also write a corpus of their own there.
"""

from __future__ import annotations

import copyreg
import hashlib
import json
import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, unblind
from bench.errors import InputError, one_line
from bench.ground.scratch import data_folder, owner_prefix

SMALL = ("lengths.npy", "captures.parquet")
FILES = ("frames.npy", *SMALL)
FIELDS = ("name", "digest", "rate_hz", "full_scale", "info")  # in corpus.json


class Damaged(Exception):
    """A defect of a stored corpus, in a few words."""


def reopen_corpus(
    path: Path,
    within: Path,
    digest: str,
    index: np.ndarray,
    target: str,
    visible: tuple[str, ...] | None,
) -> Corpus:
    """Map captures of a stored corpus again in another process or machine, from where it lies there."""
    problems = []
    for folder in dict.fromkeys((path, data_folder() / within)):
        try:
            corpus = open_folder(folder)
            if corpus.digest != digest:
                wrong = "was replaced by another corpus while it was in use; start again"
                raise InputError(f"{one_line(folder, 150)} {wrong}")
            corpus = corpus[index].with_target(target)
            return corpus if visible is None else corpus.blind(visible)
        except InputError as e:
            problems.append(e)
    raise problems[0]


def _reduce_corpus(corpus: Corpus) -> str | tuple:
    """How a corpus travels to another process: a stored one by its folder, so that frames never do."""
    seeing, visible = unblind(corpus)
    path = seeing.path
    if path is None or seeing.steps:
        return object.__reduce_ex__(corpus, 2)
    within = path.relative_to(data_folder()) if path.is_relative_to(data_folder()) else path
    return reopen_corpus, (path, within, seeing.digest, seeing.index, seeing.target, visible)


copyreg.pickle(Corpus, _reduce_corpus)


def content_digest(corpus: Corpus) -> str:
    """SHA-256 over frames, lengths, captures, rate and scale of a whole corpus."""
    h = hashlib.sha256()
    numbers = [
        n.item() if isinstance(n, np.generic) else n for n in (corpus.rate_hz, corpus.full_scale)
    ]
    h.update(repr((corpus.frames.shape, corpus.frames.dtype.str, *numbers)).encode())
    h.update(np.ascontiguousarray(corpus.frames).data)
    h.update(np.ascontiguousarray(corpus.lengths, dtype=np.int64).data)
    h.update(corpus.captures.to_csv(index=False).encode())
    return h.hexdigest()


def write_folder(corpus: Corpus, folder: Path, digest: str = "") -> None:
    """Store a whole corpus, whose ``digest`` may be known, as a folder, written beside its name and renamed.

    A folder that is there already stays if it holds the same corpus unharmed; else it is replaced.
    """
    digest = digest or content_digest(corpus)
    folder.parent.mkdir(parents=True, exist_ok=True)
    if _holds(folder, digest):
        return
    with tempfile.TemporaryDirectory(
        prefix=f".{owner_prefix()}", dir=folder.parent, ignore_cleanup_errors=True
    ) as beside:
        new = Path(beside) / "new"
        new.mkdir()
        np.save(new / "frames.npy", np.ascontiguousarray(corpus.frames))
        np.save(new / "lengths.npy", np.asarray(corpus.lengths, dtype=np.int64))
        corpus.captures.to_parquet(new / "captures.parquet", index=False)
        fields = {name: getattr(corpus, name) for name in FIELDS} | {"digest": digest}
        stored = {
            "folder": folder.name,
            "files": {name: _size_and_hash(new / name) for name in FILES},
        }
        fields, stored = json.loads(json.dumps([fields, stored], default=np.generic.item))
        fields["info"]["stored"] = stored | {"sum": _sum(fields, stored)}
        (new / "corpus.json").write_text(json.dumps(fields, indent=1))
        _seal(new, stored["files"]["frames.npy"][1])
        try:
            if os.path.lexists(folder) and not _holds(folder, digest):
                folder.rename(Path(beside) / "old")
            if not os.path.lexists(folder):
                new.rename(folder)
        except OSError:
            if not _holds(folder, digest):  # else another process was faster by a moment
                raise


def open_folder(folder: Path, key: str = "") -> Corpus:
    """Map a stored corpus, if it is what was stored; ``key`` is the folder's name when it was, where that matters."""
    try:
        fields, stored = _fields(folder, key)
        for name in SMALL:
            _compare(folder / name, *stored["files"][name])
        _check_frames(folder, *stored["files"]["frames.npy"])
        frames = np.load(folder / "frames.npy", mmap_mode="r", allow_pickle=False).view(np.ndarray)
        lengths = np.load(folder / "lengths.npy", allow_pickle=False)
        captures = pd.read_parquet(folder / "captures.parquet")
    except (Damaged, OSError, ValueError) as e:
        raise InputError(
            f"{one_line(folder, 150)} was changed or damaged ({one_line(e)}); import it again"
        ) from e
    return Corpus(frames, np.cumsum(lengths) - lengths, lengths, captures, path=folder, **fields)


def find_damage(folder: Path, key: str = "") -> dict[str, str]:
    """The defect of each file, ``""`` for none: all are read and hashed anew; ``key`` as of `open_folder`."""
    try:
        _, stored = _fields(folder, key)
    except Damaged as e:
        return {"corpus.json": str(e)} | dict.fromkeys(
            FILES, "cannot be checked without corpus.json"
        )
    wrong = dict.fromkeys(("corpus.json", *stored["files"]), "")
    for name, (size, sha256) in stored["files"].items():
        try:
            _compare(folder / name, size, sha256)
        except Damaged as e:
            wrong[name] = str(e)
    if wrong["frames.npy"]:  # however it looks, it is not to be opened again
        with suppress(OSError):
            (folder / "seal.json").unlink()
    return wrong


def _holds(folder: Path, digest: str) -> bool:
    """Whether a corpus is there already, unharmed."""
    try:
        fields, _ = _fields(folder, folder.name)
    except Damaged:
        return False
    return fields["digest"] == digest and not any(find_damage(folder).values())


def _fields(folder: Path, key: str = "") -> tuple[dict, dict]:
    """The contents of ``corpus.json``, and under ``info.stored`` what was stored beside it."""
    try:
        fields = json.loads(small_file(folder / "corpus.json"))
        stored = fields["info"].pop("stored")
        unchanged = stored.pop("sum") == _sum(fields, stored)
    except (ValueError, RecursionError, TypeError, KeyError, AttributeError) as e:
        raise Damaged("corpus.json cannot be read") from e
    if not unchanged:
        raise Damaged("corpus.json differs from what was stored")
    if key and stored["folder"] != key:
        raise Damaged(f"corpus.json was written for {stored['folder'][:40]}")
    return fields, stored


def _sum(fields: dict, stored: dict) -> str:
    return hashlib.sha256(json.dumps([fields, stored], sort_keys=True).encode()).hexdigest()


def _check_frames(folder: Path, size: int, sha256: str) -> None:
    """Compare the frames with what was stored, if they have changed since that was last done."""
    path = folder / "frames.npy"
    with suppress(Damaged, ValueError, RecursionError):
        if json.loads(small_file(folder / "seal.json")) == [sha256, *stamp(path)]:
            return
    _compare(path, size, sha256)
    with suppress(OSError):  # a folder that cannot be written
        _seal(folder, sha256)


def _seal(folder: Path, sha256: str) -> None:
    """Write what the frames look like now; half a seal, after a kill, is none."""
    (folder / "seal.json").write_text(json.dumps([sha256, *stamp(folder / "frames.npy")]))


# Files: read within bounds, as they may be anything


def small_file(path: Path, most: int = 1 << 24) -> bytes:
    """The bytes of a file of at most so many."""
    if (size := stamp(path)[0]) > most:
        raise Damaged(f"{path.name} has {size} bytes")
    try:
        return path.read_bytes()
    except OSError as e:
        raise Damaged(f"{path.name} cannot be read") from e


def stamp(path: Path) -> tuple[int, ...]:
    """Attributes that change with a file: size, times (that of its entry cannot be set back) and inode."""
    try:
        status = path.stat()
    except OSError as e:
        raise Damaged(f"{path.name} is not there") from e
    if not stat.S_ISREG(status.st_mode):  # a pipe would wait for ever
        raise Damaged(f"{path.name} is no file")
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino


def _size_and_hash(path: Path) -> tuple[int, str]:
    with path.open("rb") as file:
        return stamp(path)[0], hashlib.file_digest(file, "sha256").hexdigest()


def _compare(path: Path, size: int, sha256: str) -> None:
    """Read a file of any size to see whether it has this size and hash; another size tells without reading."""
    if (actual := stamp(path)[0]) != size:
        raise Damaged(f"{path.name} has {actual} bytes")
    try:
        if _size_and_hash(path)[1] == sha256:
            return
    except OSError as e:
        raise Damaged(f"{path.name} cannot be read") from e
    raise Damaged(f"{path.name} differs from what was stored")
