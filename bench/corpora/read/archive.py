"""Folders and archives, which may be damaged or hostile: sizes are checked before unpacking."""

from __future__ import annotations

import tarfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from bench.corpora.read.limits import check_unpacked_size, file_name
from bench.errors import InputError, one_line

BROKEN = "not a readable archive ({}); get it again"
PACKING = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # zipfile does not bound the memory of others


@contextmanager
def open_zip(path: Path, broken: str) -> Iterator[tuple[zipfile.ZipFile, list[zipfile.ZipInfo]]]:
    """Open a zip archive; yield it and the files in it, without folders and additions of macOS.

    Args:
        path: the archive.
        broken: message on any error within the context, with a place for the reason.
    """
    with refuse_damage(path, broken), zipfile.ZipFile(path) as archive:
        members = [
            member
            for member in archive.infolist()
            if not member.is_dir() and not _is_from_macos(member.filename)
        ]
        unpacked = sum(member.file_size for member in members)
        check_unpacked_size(unpacked, path, "pack it without compression")
        if any(member.compress_type not in PACKING for member in members):
            raise InputError(
                f"{file_name(path)}: packed with bzip2 or LZMA; pack it with deflate, the usual way"
            )
        yield archive, members


@contextmanager
def refuse_damage(path: Path, broken: str) -> Iterator[None]:
    """Turn any error of a damaged file into an `InputError`; ``broken`` is as in `open_zip`."""
    try:
        yield
    except InputError:
        raise
    except Exception as e:  # a dozen types: BadZipFile, zlib.error, ArrowInvalid, ...
        raise InputError(f"{file_name(path)}: {broken.format(one_line(e))}") from e


def read_files(
    path: Path, is_wanted: Callable[[str], object], most: int, advice: str
) -> dict[str, bytes]:
    """Read the wanted files of a folder, or of a zip or tar archive.

    Args:
        path: folder or archive.
        is_wanted: function of a file's name without folders, in small letters.
        most: largest number of bytes of a file.
        advice: what to give instead, for messages.

    Returns:
        Contents by name.

    Raises:
        InputError: there is no such archive, it is damaged, or has a file twice or one too large.
    """
    if not (path.is_dir() or path.is_file()):
        raise InputError(f"{one_line(path, 160)}: there is no such file or folder; give {advice}")
    contents: dict[str, bytes] = {}
    with refuse_damage(path, BROKEN):
        for place, size, read in _iter_members(path):
            name = place.rsplit("/", 1)[-1].lower()
            if _is_from_macos(place) or not is_wanted(name):
                continue
            if size > most:
                raise InputError(
                    f"{file_name(path)}: {one_line(place)} is larger than {most >> 20} MiB; "
                    "get it again"
                )
            if name in contents:
                raise InputError(
                    f"{file_name(path)}: {one_line(place)} is in it twice; leave only one"
                )
            contents[name] = read()
    return contents


def _iter_members(path: Path) -> Iterator[tuple[str, int, Callable[[], bytes]]]:
    """Path, size in bytes and reader of each file of a folder or an archive."""
    if path.is_dir():
        for file in filter(Path.is_file, path.rglob("*")):
            yield file.relative_to(path).as_posix(), file.stat().st_size, file.read_bytes
    elif tarfile.is_tarfile(path):
        with tarfile.open(path) as archive:
            members = [member for member in archive if member.isfile()]
            unpacked = sum(member.size for member in members)
            check_unpacked_size(unpacked, path, "unpack it and give the folder")
            for member in members:
                yield member.name, member.size, archive.extractfile(member).read
    else:
        with open_zip(path, BROKEN) as (packed, entries):
            for entry in entries:
                yield entry.filename, entry.file_size, partial(packed.read, entry)


def _is_from_macos(place: str) -> bool:
    """True for a file that macOS added to an archive or a folder."""
    *folders, name = place.split("/")
    return "__MACOSX" in folders or name.startswith("._")
