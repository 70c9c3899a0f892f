"""Lines of a text file in blocks of bytes, whatever ends them and however many are blank."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from bench.errors import InputError

BLOCK = 8 << 20  # bytes that are read at once
MOST_LINE = 4 << 20  # bytes
_BLANK = b" \t\n"


@dataclass
class Lines:
    """Some whole lines.

    Attributes:
        first: number of the first.
        count: how many.
        content: their bytes; lines end with line feeds, the last one may.
    """

    first: int
    count: int
    content: bytes


def parts_of(path: Path, label: str) -> Iterator[bytes]:
    """The bytes of a file.

    Raises:
        InputError: it cannot be read; the message begins with ``label``.
    """
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise InputError(f"{label}: cannot be read (a device or a pipe); give a file")
        with open(path, "rb") as f:
            while part := f.read(BLOCK):
                yield part
    except OSError as e:
        raise InputError(f"{label}: cannot be read ({e.strerror}); check the path") from e


def blocks(parts: Iterable[bytes], label: str) -> Iterator[Lines]:
    """The lines of a file but for the blank ones at its end, which cost nothing however many they are.

    Args:
        parts: the bytes of the file.
        label: what messages call it.

    Raises:
        InputError: a line that is too long, or blank ones between blocks.
    """
    first, blank, rest = 1, 0, b""
    for part in chain(parts, [None]):
        if part is None:
            content, rest = rest, b""
        elif end := part.rfind(b"\n") + 1:
            content, rest = b"".join((rest, memoryview(part)[:end])), part[end:]
        else:  # as old Macs end lines; the last byte may be half of another line end
            rest += part
            end = rest.rfind(b"\r", 0, -1) + 1
            content, rest = rest[:end], rest[end:]
            if len(rest) > MOST_LINE:
                raise InputError(
                    f"{label}, line {blank or first}: longer than {MOST_LINE >> 20} MiB; this is not a table"
                )
        if b"\r" in content:
            content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        ended = content.count(b"\n")
        full = ended + (not content.endswith(b"\n"))
        if content[-2:].removesuffix(b"\n")[-1:] in (b"", b" ", b"\t", b"\n"):  # else a copy is spared
            content = content.rstrip(_BLANK)
            full = content.count(b"\n") + 1 if content else 0
        if content and blank:
            raise InputError(f"{label}, line {blank}: blank, but not at the end; delete the line")
        if content:
            yield Lines(first, full, content)
        if ended > full:
            blank = blank or first + full
        first += ended
