"""Stored corpora: a folder each in the user's data folder, checked and mapped when it is opened.

``frames.npy``, ``lengths.npy`` and ``captures.parquet`` hold the corpus. ``corpus.json`` holds the
rest and, under ``info.stored``, the name of the folder, size and SHA-256 of each file and a
checksum of itself; it never changes. ``seal.json`` holds size, times and inode of ``frames.npy``
when it was last hashed.

Small files are hashed at each opening, frames only if they look different. This finds damage and
accidental changes, not forgery: who can write into the folder can store another corpus there.
"""

from __future__ import annotations

import copyreg
import hashlib
import json
import os
import stat
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, unblind
from bench.errors import InputError, one_line
from bench.ground.scratch import data_folder, hold_path, remove_path

FILES = ("frames.npy", "lengths.npy", "captures.parquet")
FIELDS = ("name", "digest", "rate_hz", "full_scale", "info")  # in corpus.json
MOST_BYTES = 1 << 24  # of a small file


class DamagedCorpus(InputError):
    """A stored corpus is not what was stored."""

    defect = ""  # in a few words, for a table of files


def content_digest(corpus: Corpus) -> str:
    """SHA-256 of frames, lengths, captures, rate and full scale of a whole corpus."""
    sha256 = hashlib.sha256()
    numbers = [
        number.item() if isinstance(number, np.generic) else number
        for number in (corpus.rate_hz, corpus.full_scale)
    ]
    sha256.update(repr((corpus.frames.shape, corpus.frames.dtype.str, *numbers)).encode())
    sha256.update(np.ascontiguousarray(corpus.frames).data)
    sha256.update(np.ascontiguousarray(corpus.lengths, dtype=np.int64).data)
    sha256.update(corpus.captures.to_csv(index=False).encode())
    return sha256.hexdigest()


def write_folder(corpus: Corpus, folder: Path, digest: str = "") -> None:
    """Store a whole corpus as a folder, which is written under another name and then renamed.

    A folder that already holds the same corpus undamaged stays; any other is replaced.

    Args:
        corpus: corpus to store.
        folder: path of the folder.
        digest: the corpus's `content_digest`, if it is known.
    """
    digest = digest or content_digest(corpus)
    folder.parent.mkdir(parents=True, exist_ok=True)
    if _is_stored(folder, corpus.name, digest):
        return
    with hold_path(folder.parent) as scratch:
        new = scratch / "new"
        new.mkdir(parents=True)
        np.save(new / "frames.npy", np.ascontiguousarray(corpus.frames))
        np.save(new / "lengths.npy", np.asarray(corpus.lengths, dtype=np.int64))
        corpus.captures.to_parquet(new / "captures.parquet", index=False)
        fields = {name: getattr(corpus, name) for name in FIELDS} | {"digest": digest}
        files = {name: ((new / name).stat().st_size, _hash_file(new / name)) for name in FILES}
        stored = {"folder": folder.name, "files": files}
        contents = json.dumps([fields, stored], default=np.generic.item)
        fields, stored = json.loads(contents)
        fields["info"]["stored"] = stored | {"sum": _checksum(fields, stored)}
        (new / "corpus.json").write_text(json.dumps(fields, indent=1))
        _write_seal(new, files["frames.npy"][1])
        try:
            if os.path.lexists(folder) and not _is_stored(folder, corpus.name, digest):
                folder.rename(scratch / "old")
            if not os.path.lexists(folder):
                new.rename(folder)
        except OSError:
            if not _is_stored(folder, corpus.name, digest):  # else another process was faster
                raise


def open_folder(folder: Path) -> Corpus:
    """Map a stored corpus.

    Raises:
        DamagedCorpus: a file is missing, or differs from what was stored.
    """
    fields, files = _read_fields(folder)
    sealed = _is_sealed(folder, files["frames.npy"][1])
    for name, (size, sha256) in files.items():
        if name == "frames.npy" and sealed:
            continue
        if defect := _find_defect(folder / name, size, sha256):
            raise damaged_error(folder, defect)
    if not sealed:
        with suppress(OSError):  # the folder may be read-only
            _write_seal(folder, files["frames.npy"][1])
    frames = np.load(folder / "frames.npy", mmap_mode="r", allow_pickle=False).view(np.ndarray)
    lengths = np.load(folder / "lengths.npy", allow_pickle=False)
    captures = pd.read_parquet(folder / "captures.parquet")
    return Corpus(frames, np.cumsum(lengths) - lengths, lengths, captures, path=folder, **fields)


def find_damage(folder: Path) -> dict[str, str]:
    """Read and hash all files of a stored corpus.

    Returns:
        The defect of each file by name, ``""`` for none.
    """
    try:
        _, files = _read_fields(folder)
    except DamagedCorpus as e:
        unchecked = "cannot be checked without corpus.json"
        return {"corpus.json": e.defect} | dict.fromkeys(FILES, unchecked)
    defects = {"corpus.json": ""}
    defects |= {name: _find_defect(folder / name, *file) for name, file in files.items()}
    if defects["frames.npy"]:  # without a seal they are hashed, however the file looks
        with suppress(OSError):
            (folder / "seal.json").unlink()
    return defects


def damaged_error(folder: Path, defect: str) -> DamagedCorpus:
    """The error of opening a damaged corpus."""
    reason = f"was changed or damaged ({defect}); import it again"
    error = DamagedCorpus(f"{one_line(folder, 150)} {reason}")
    error.defect = defect
    return error


def read_small_file(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Read a plain file that should be small.

    Raises:
        OSError: it is missing, larger, or no plain file, such as a pipe, which would wait.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f"{path.name} is no plain file")
    if status.st_size > most_bytes:
        raise OSError(f"{path.name} has {status.st_size} bytes")
    return path.read_bytes()


def _is_stored(folder: Path, name: str, digest: str) -> bool:
    """True if a folder holds the corpus of this name and digest undamaged."""
    try:
        fields, _ = _read_fields(folder)
    except InputError:
        return False
    is_same = fields["name"] == name and fields["digest"] == digest
    return is_same and not any(find_damage(folder).values())


def _read_fields(folder: Path) -> tuple[dict, dict[str, list]]:
    """Contents of ``corpus.json``, and size and SHA-256 of the other files by name."""
    try:
        fields = json.loads(read_small_file(folder / "corpus.json"))
        stored = fields["info"].pop("stored")
        unchanged = stored.pop("sum") == _checksum(fields, stored)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as e:
        raise damaged_error(folder, "corpus.json cannot be read") from e
    if not unchanged:
        raise damaged_error(folder, "corpus.json differs from what was stored")
    written_for = stored.get("folder", folder.name)  # one version stored none
    if written_for != folder.name:
        raise damaged_error(folder, f"corpus.json was written for {written_for[:40]}")
    return fields, stored["files"]


def _checksum(fields: dict, stored: dict) -> str:
    return hashlib.sha256(json.dumps([fields, stored], sort_keys=True).encode()).hexdigest()


def _make_seal(folder: Path, sha256: str) -> list:
    """SHA-256, size, times (ctime cannot be set back) and inode of the frames."""
    status = (folder / "frames.npy").stat()
    return [sha256, status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]


def _write_seal(folder: Path, sha256: str) -> None:
    seal = folder / "seal.json"
    if os.path.lexists(seal) and (seal.is_symlink() or not seal.is_file()):
        remove_path(seal)  # a pipe would wait
    seal.write_text(json.dumps(_make_seal(folder, sha256)))


def _is_sealed(folder: Path, sha256: str) -> bool:
    """True if the frames look as they did when they were last hashed."""
    try:
        seal = json.loads(read_small_file(folder / "seal.json"))
        return seal == _make_seal(folder, sha256)
    except (OSError, ValueError, RecursionError):  # a kill may leave half a seal
        return False


def _find_defect(path: Path, size: int, sha256: str) -> str:
    """The defect of a file that should have this size and hash, ``""`` for none."""
    try:
        if (found := path.stat().st_size) != size:
            return f"{path.name} has {found} bytes instead of {size}"
        unchanged = _hash_file(path) == sha256
    except OSError as e:
        return f"{path.name} cannot be read ({e.strerror})"
    return "" if unchanged else f"{path.name} differs from what was stored"


def _hash_file(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# How a corpus travels to another process or machine: by its folder, so frames stay where they are


def _reduce_corpus(corpus: Corpus) -> str | tuple:
    """Pickle a stored corpus by its folder; one in memory, or after steps, with its frames."""
    labelled, visible = unblind(corpus), corpus.visible
    path = labelled.path
    if path is None or labelled.steps:
        return object.__reduce_ex__(corpus, 2)
    within = path.relative_to(data_folder()) if path.is_relative_to(data_folder()) else path
    fields = (labelled.digest, labelled.index, labelled.target, visible)
    return reopen_corpus, (path, within, *fields)


def reopen_corpus(
    path: Path,
    within: Path,
    digest: str,
    index: np.ndarray,
    target: str,
    visible: tuple[str, ...] | None,
) -> Corpus:
    """Map captures of a stored corpus in another process, or on a machine with another data folder.

    Args:
        path: folder of the corpus on the machine that stored it.
        within: its path within that machine's data folder.
        digest: digest that the corpus must have.
        index: positions of the captures.
        target: columns of the class.
        visible: columns of a blind corpus; None for one with labels.
    """
    errors = []
    for folder in dict.fromkeys((path, data_folder() / within)):
        try:
            corpus = open_folder(folder)
            if corpus.digest != digest:
                reason = "was replaced by another corpus while it was in use; start again"
                raise InputError(f"{one_line(folder, 150)} {reason}")
            corpus = corpus[index].with_target(target)
            return corpus if visible is None else corpus.blind(visible)
        except InputError as e:
            errors.append(e)
    raise errors[0]


copyreg.pickle(Corpus, _reduce_corpus)
