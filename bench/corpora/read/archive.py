"""Folders and archives, which may be damaged or hostile: nothing is unpacked before its sizes are checked."""

from __future__ import annotations

import tarfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.corpora.read.limits import check_unpacked_size, file_name, one_line
from bench.errors import InputError


@contextmanager
def open_zip(path: Path, broken: str) -> Iterator[tuple[zipfile.ZipFile, list[zipfile.ZipInfo]]]:
    """A zip archive and the files in it, without folders and additions of macOS.

    Any error within the context is that of a damaged file: the message ``broken``, with a place for the reason. Files
    packed with bzip2 or LZMA are refused, as ``zipfile`` does not bound their memory.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = [
                m
                for m in archive.infolist()
                if not m.filename.endswith("/") and not _by_macos(m.filename)
            ]
            check_unpacked_size(
                sum(m.file_size for m in members), path, "pack it without compression"
            )
            if any(
                m.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for m in members
            ):
                raise InputError(
                    f"{file_name(path)}: packed with bzip2 or LZMA; pack it with deflate, the usual way"
                )
            yield archive, members
    except InputError:
        raise
    except (
        Exception
    ) as e:  # damage shows as a dozen types: BadZipFile, zlib.error, struct.error, ...
        raise InputError(f"{file_name(path)}: {broken.format(one_line(e))}") from e


def read_files(
    path: Path, wanted: Callable[[str], object], most: int, give: str
) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the wanted files of a folder, or of a zip or tar archive, each of at most so many bytes.

    Names are without folders, in small letters; ``give`` is what to give instead, for messages.
    """
    broken, seen = "not a readable archive ({}); get it again", set()

    def chosen(name: str, size: int) -> str:
        file = name.rsplit("/", 1)[-1].lower()
        if _by_macos(name) or not wanted(file):
            return ""
        if size > most:
            raise InputError(
                f"{file_name(path)}: {one_line(name)} is larger than {most >> 20} MiB; get it again"
            )
        if file in seen:
            raise InputError(
                f"{file_name(path)}: {one_line(name)} is in it twice; leave only the one that is meant"
            )
        seen.add(file)
        return file

    if path.is_dir():
        for file in path.rglob("*"):
            if file.is_file() and (
                name := chosen(file.relative_to(path).as_posix(), file.stat().st_size)
            ):
                yield name, file.read_bytes()
    elif not path.is_file():
        raise InputError(f"{one_line(path, 160)}: there is no such file or folder; give {give}")
    elif tarfile.is_tarfile(path):
        try:
            with tarfile.open(path) as archive:
                members = [
                    (name, m) for m in archive if m.isfile() and (name := chosen(m.name, m.size))
                ]
                check_unpacked_size(
                    sum(m.size for _, m in members), path, "unpack it and give the folder"
                )
                for name, member in members:
                    content = archive.extractfile(member)
                    yield name, content.read() if content else b""
        except (tarfile.TarError, EOFError, OSError) as e:
            raise InputError(f"{file_name(path)}: {broken.format(one_line(e))}") from e
    else:
        with open_zip(path, broken) as (packed, entries):
            for entry in entries:
                if name := chosen(entry.filename, entry.file_size):
                    yield name, packed.read(entry)


def _by_macos(name: str) -> bool:
    """Return True for a file that macOS added to an archive or a folder."""
    *folders, file = name.split("/")
    return "__MACOSX" in folders or file.startswith("._")
