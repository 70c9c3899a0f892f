"""Zip archives that may be damaged or hostile: their directory is checked before anything is unpacked."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.corpora.read.limits import called, check_unpacked, plain
from bench.errors import InputError


@contextmanager
def opened(path: Path, broken: str) -> Iterator[tuple[zipfile.ZipFile, list[zipfile.ZipInfo]]]:
    """A zip archive and the files in it, without folders and additions of macOS.

    Any error within the context is that of a damaged file: the message ``broken``, with a place for the reason.

    Raises:
        InputError: it cannot be read, or unpacks to far more than its size, or with bzip2 or LZMA, whose memory
            ``zipfile`` does not bound.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if not m.filename.endswith("/") and not by_macos(m.filename)]
            check_unpacked(sum(m.file_size for m in members), path, "pack it without compression")
            if any(m.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for m in members):
                raise InputError(f"{called(path)}: packed with bzip2 or LZMA; pack it with deflate, the usual way")
            yield archive, members
    except InputError:
        raise
    except Exception as e:  # damage shows as a dozen types: BadZipFile, zlib.error, struct.error, ...
        raise InputError(f"{called(path)}: {broken.format(plain(e))}") from e


def by_macos(name: str) -> bool:
    """Return True for a file that macOS added to an archive or a folder."""
    *folders, file = name.split("/")
    return "__MACOSX" in folders or file.startswith("._")
