"""The sizes that the pages of a parquet file say they unpack to; its footer may say less."""

from __future__ import annotations

from pathlib import Path
from typing import Any

_WINDOW = 4096  # bytes in which a page's header nearly always ends
_LONGEST = 1 << 20
_DEEPEST = 16


def unpacked(path: Path, metadata: Any, enough: int) -> int:
    """Bytes that all pages unpack to; counting stops above ``enough``.

    Args:
        path: the file.
        metadata: its footer, a pyarrow ``FileMetaData``.
        enough: more need not be counted.

    Raises:
        ValueError: a page's header is damaged.
    """
    total = 0
    with open(path, "rb") as f:
        for group in range(metadata.num_row_groups):
            chunks = metadata.row_group(group)
            for chunk in map(chunks.column, range(metadata.num_columns)):
                at = chunk.data_page_offset
                if chunk.has_dictionary_page and chunk.dictionary_page_offset:
                    at = min(at, chunk.dictionary_page_offset)
                end = at + chunk.total_compressed_size
                while at < end and total <= enough:
                    f.seek(at)
                    header = f.read(_WINDOW)
                    try:
                        large, packed, length = _page(header)
                    except IndexError:
                        large, packed, length = _page(header + f.read(_LONGEST))
                    total += large
                    at += length + packed
    return total


def _page(data: bytes) -> tuple[int, int, int]:
    """Sizes of a page, unpacked and packed, and the length of its header."""
    reader = _Compact(data)
    sizes = {}
    for field, kind in reader.fields():
        if field in (2, 3) and kind == 5:
            sizes[field] = reader.signed()
        else:
            reader.skip(kind, _DEEPEST)
    if len(sizes) < 2 or min(sizes.values()) < 0:
        raise ValueError("a page without a size")
    return sizes[2], sizes[3], reader.at


class _Compact:
    """Thrift's compact protocol, as much of it as skipping needs. Data that ends too early raise an `IndexError`."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def unsigned(self) -> int:
        number = shift = 0
        while shift < 70:
            byte = self.byte()
            number |= (byte & 127) << shift
            if byte < 128:
                return number
            shift += 7
        raise ValueError("a number without an end")

    def signed(self) -> int:
        number = self.unsigned()
        return number >> 1 ^ -(number & 1)

    def fields(self) -> Any:
        """Number and type of each field of a struct; what it holds must be read or skipped in between."""
        field = 0
        while head := self.byte():
            field = field + (head >> 4) if head >> 4 else self.signed()
            yield field, head & 15

    def skip(self, kind: int, depth: int) -> None:
        """Pass over a value."""
        if depth < 0:
            raise ValueError("structs in structs")
        if kind in (1, 2):  # a truth value is its type
            return
        if kind == 3:
            self.at += 1
        elif kind in (4, 5, 6):
            self.unsigned()
        elif kind == 7:
            self.at += 8
        elif kind == 8:
            length = self.unsigned()
            self.at += length
        elif kind == 12:
            for _, inner in self.fields():
                self.skip(inner, depth - 1)
        else:  # no list, set or map stands in a page's header
            raise ValueError(f"a field of type {kind}")
