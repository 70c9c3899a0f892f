"""Zip archives that may be damaged or hostile: what is in them, read to the size that they declare."""

from __future__ import annotations

import copy
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from bench.corpora.limits import called, check_unpacked, plain, size
from bench.errors import InputError

PART = 1 << 20  # bytes
_PIECE = {zipfile.ZIP_STORED: PART, zipfile.ZIP_DEFLATED: PART}
_SMALL_PIECE = 4096  # other packings unpack a piece in one go, 7000 times as large at worst


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
        files = [m for m in self._zip.infolist() if not m.is_dir() and not by_macos(m.filename)]
        self.members = files
        check_unpacked(sum(m.file_size for m in files), path, "pack it without compression")

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def _error(self, reason: object) -> InputError:
        return InputError(f"{called(self.path)}: {self._broken.format(plain(reason))}")

    def content(self, member: zipfile.ZipInfo) -> Iterator[bytes]:
        """A member in parts of about 1 MiB.

        Raises:
            InputError: it is damaged, or not of the size that the archive says.
        """
        looked = copy.copy(member)
        looked.file_size += 1  # zipfile reads to the declared size and no further; one byte more shows a lie
        looked.CRC = None  # of the declared size; compared here
        piece = _PIECE.get(member.compress_type, _SMALL_PIECE)
        left, crc, gathered = member.file_size, 0, []
        try:
            with self._zip.open(looked) as f:
                while data := f.read(piece):
                    left -= len(data)
                    if left < 0:
                        break
                    crc = zlib.crc32(data, crc)
                    gathered.append(data)
                    if len(gathered) * piece >= PART:
                        yield b"".join(gathered)
                        gathered = []
        except Exception as e:  # decoders raise whatever damaged bytes lead them to
            raise self._error(e) from e
        if left:
            how = "larger" if left < 0 else "smaller"
            name = plain(member.filename, 60)
            raise self._error(f"{name} is {how} than it says, {size(member.file_size)}")
        if crc != member.CRC:
            raise self._error(f"the checksum of {plain(member.filename, 60)} is another")
        yield b"".join(gathered)


def by_macos(name: str) -> bool:
    """Whether macOS put this into an archive or a folder, beside the file that is meant."""
    *folders, file = name.split("/")
    return "__MACOSX" in folders or file.startswith("._")
