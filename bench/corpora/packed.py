"""Zip archives that may be damaged or hostile: what is in them, read to the size that they declare."""

from __future__ import annotations

import bz2
import copy
import lzma
import zipfile
import zlib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from bench.corpora.limits import called, check_unpacked, plain, size
from bench.errors import InputError

PART = 1 << 20  # bytes
_MOST_LZMA = 256 << 20  # bytes of its dictionary; zip programs take 64 MiB at most


class Archive:
    """A zip archive, open for as long as it is used as a context.

    Folders and what macOS adds are left out.

    Args:
        path: the file.
        broken: what to say of a damaged one, with a place for the reason: ``not a zip file ({}); get it again``.

    Attributes:
        members: the files in it.

    Raises:
        InputError: it cannot be read, or unpacks to far more than its size.
    """

    def __init__(self, path: Path, broken: str) -> None:
        self.path, self._broken = path, broken
        try:
            self._zip = zipfile.ZipFile(path)
        except Exception as e:  # damage shows as a dozen types: BadZipFile, struct.error, UnicodeDecodeError, ...
            raise self._error(e) from e
        files = [m for m in self._zip.infolist() if not m.filename.endswith("/")]
        self.members = [m for m in files if not by_macos(m.filename)]
        try:
            check_unpacked(sum(m.file_size for m in self.members), path, "pack it without compression")
        except InputError:
            self._zip.close()
            raise

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def _error(self, reason: object) -> InputError:
        return InputError(f"{called(self.path)}: {self._broken.format(plain(reason))}")

    def content(self, member: zipfile.ZipInfo) -> Iterator[bytes]:
        """A member in parts of at most 1 MiB.

        Raises:
            InputError: it is damaged, or not of the size that the archive says.
        """
        left, crc = member.file_size, 0
        try:
            for part in _unpacked(self._packed(member), member.compress_type):
                left -= len(part)
                if left < 0:
                    break
                crc = zlib.crc32(part, crc)
                yield part
        except Exception as e:  # decoders raise whatever damaged bytes lead them to
            raise self._error(e) from e
        if left:
            how = "larger" if left < 0 else "smaller"
            raise self._error(f"{plain(member.filename, 60)} is {how} than it says, {size(member.file_size)}")
        if crc != member.CRC:
            raise self._error(f"the checksum of {plain(member.filename, 60)} is another")

    def _packed(self, member: zipfile.ZipInfo) -> Iterator[bytes]:
        """The bytes of a member as they lie in the archive; zipfile would unpack some of them without a bound."""
        looked = copy.copy(member)
        looked.compress_type, looked.file_size, looked.CRC = zipfile.ZIP_STORED, member.compress_size, None
        with self._zip.open(looked) as f:
            while part := f.read(PART):
                yield part


def _unpacked(parts: Iterator[bytes], packing: int) -> Iterator[bytes]:
    """What packed bytes hold, in parts of at most 1 MiB."""
    if packing == zipfile.ZIP_STORED:
        yield from parts
    elif packing == zipfile.ZIP_DEFLATED:
        deflated = zlib.decompressobj(-15)
        for part in parts:
            full = True
            while full and not deflated.eof:
                found = deflated.decompress(part, PART)
                part, full = deflated.unconsumed_tail, len(found) == PART
                yield found
    elif packing in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        if packing == zipfile.ZIP_BZIP2:
            decoder: bz2.BZ2Decompressor | lzma.LZMADecompressor = bz2.BZ2Decompressor()
        else:  # version and length of the properties, the properties, the data; ``.lzma`` files have a size in between
            first = next(parts, b"")
            decoder = lzma.LZMADecompressor(lzma.FORMAT_ALONE, memlimit=_MOST_LZMA)
            parts = chain([first[4:9] + b"\xff" * 8 + first[9:]], parts)
        for part in parts:
            while not decoder.eof and (part or not decoder.needs_input):
                yield decoder.decompress(part, PART)
                part = b""
    else:
        raise ValueError(f"packed in way {packing}, which is not known")


def by_macos(name: str) -> bool:
    """Whether macOS put this into an archive or a folder, beside the file that is meant."""
    *folders, file = name.split("/")
    return "__MACOSX" in folders or file.startswith("._")
