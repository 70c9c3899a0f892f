"""Long CSV files of touch frames: read fast when they are good, explained to the line when they are not."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv

from bench.corpora.read.frame_rows import labels_and_values
from bench.corpora.read.limits import check_conditions, check_file, check_names, plain, quoted, short
from bench.errors import InputError

BLOCK = 8 << 20  # bytes that are read at once
MOST_LINE = 4 << 20  # bytes
_BLANK = b" \t\r\n"
_TEXT, _COUNT, _WHOLE, _NUMBER = pa.dictionary(pa.int32(), pa.string()), pa.int64(), pa.uint16(), pa.float64()
_KINDS = {_COUNT: "a whole number", _WHOLE: "a whole number from 0 to 65535", _NUMBER: "a number"}


class FrameFile:
    """A CSV file with one frame per row.

    Text in UTF-8, a header, as many cells in every line, no line breaks within cells, and blank lines only at the end.
    Lines are parsed in blocks, so what is no table costs a block, whatever it would expand to.

    Args:
        source: path or content.
        label: name of the file in messages.

    Attributes:
        columns: header names without spaces and quotes.
        header: name of the file and number of its first line, for messages.

    Raises:
        InputError: the file is missing, empty or not text.
    """

    def __init__(self, source: Path | bytes, label: str) -> None:
        self.source, self.label, self.header = source, label, f"{label}, line 1"
        with self._opened() as file:
            line = file.readline(MOST_LINE)
        try:
            cells = next(csv.reader([line.decode("utf-8-sig").rstrip("\r\n")], skipinitialspace=True), [])
        except (UnicodeDecodeError, csv.Error) as e:
            raise InputError(
                f"{self.header}: not the header of a CSV file in UTF-8 ({plain(e)}); give the CSV file itself"
            ) from e
        self.columns = [name.strip().strip('"').strip() for name in cells]
        if not any(self.columns):
            raise InputError(f"{self.header}: empty; begin the file with its header")
        check_names(self.columns, self.header)

    def _opened(self) -> BinaryIO:
        if isinstance(self.source, bytes):
            return io.BytesIO(self.source)
        check_file(self.source)
        try:
            return open(self.source, "rb")
        except OSError as e:
            raise InputError(f"{self.label}: cannot be read ({e.strerror}); check the path") from e

    def read(
        self, counts: list[str], channels: list[str], full_scale: float, fractions: bool = False, blank: str = ""
    ) -> tuple[pd.DataFrame, np.ndarray]:
        """Labels and sensor values of every row.

        Args:
            counts: label columns that hold whole numbers; the other label columns are text.
            channels: columns of sensor values, 0..full_scale.
            full_scale: largest value allowed.
            fractions: whether values may have decimals.
            blank: column of text whose cells may be empty.

        Returns:
            Labels [rows], all columns but the channels in file order, and values [rows, channels], uint16 when every
            value is a whole number up to 65535, else float32.

        Raises:
            InputError: a cell that does not fit, with its line and column.
        """
        check_conditions(len(self.columns) - len(channels), self.header)
        types = dict.fromkeys(self.columns, _TEXT) | dict.fromkeys(counts, _COUNT)
        types |= dict.fromkeys(channels, _NUMBER if fractions else _WHOLE)
        return labels_and_values(
            self._batches(types), self.columns, channels, full_scale, f"{self.label}, line", 2, blank
        )

    def _batches(self, types: dict[str, pa.DataType]) -> Iterator[pa.RecordBatch]:
        for first, content in self._blocks():
            try:
                yield _parsed(content, types)
            except pa.ArrowException:
                self._explain(content.split(b"\n"), first, types)

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """Whole lines behind the header, with the number of the first, without blank lines at the end of the file."""
        first, blank = 2, 0
        with self._opened() as file:
            file.readline(MOST_LINE)
            while content := file.read(BLOCK) + file.readline(MOST_LINE):
                lines, content = content.count(b"\n"), content.rstrip(_BLANK)
                used = content.count(b"\n") + 1 if content else 0
                if content and blank:
                    raise InputError(f"{self.label}, line {blank}: blank, but not at the end; delete the line")
                if content:
                    yield first, content
                if lines > used and not blank:
                    blank = first + used
                first += lines

    def _explain(self, lines: list[bytes], first: int, types: dict[str, pa.DataType]) -> NoReturn:
        """Say what is wrong with the first line that does not fit, which is found by halving."""
        low, high = 0, len(lines)
        while high - low > 1:
            middle = (low + high) // 2
            try:
                _parsed(b"\n".join(lines[low:middle]), types)
                low = middle
            except pa.ArrowException:
                high = middle
        where = f"{self.label}, line {first + low}"
        try:
            cells = next(csv.reader([lines[low].decode().rstrip("\r")]), [])
        except (UnicodeDecodeError, csv.Error) as e:
            raise InputError(f"{where}: not a line of a CSV file in UTF-8 ({plain(e)}); correct it") from e
        if len(cells) != len(types):
            raise InputError(
                f"{where}: {len(cells)} fields instead of {len(types)}; the file is cut off or damaged here, get it "
                "again or delete the line"
            )
        for cell, (name, kind) in zip(cells, types.items(), strict=True):
            try:
                pa.scalar(cell.strip(" \t")).cast(kind)
            except pa.ArrowException:
                reason = f"{quoted(cell)}, not {_KINDS.get(kind, 'text')}"
                raise InputError(f"{where}: {short(name)} is {reason}; correct the cell") from None
        raise InputError(f"{where}: cannot be read as CSV; check quotes and line ends")


def _parsed(content: bytes, types: dict[str, pa.DataType]) -> pa.RecordBatch:
    table = pacsv.read_csv(
        pa.BufferReader(b"\n%b\n" % content),  # no mark of a file's beginning is skipped, no open quote is closed
        read_options=pacsv.ReadOptions(column_names=list(types), block_size=len(content) + 3),
        convert_options=pacsv.ConvertOptions(column_types=types, null_values=[]),
    )
    if len(table) != content.count(b"\n") + 1:
        raise pa.ArrowInvalid("a blank line, or a line break within a cell")
    return table.combine_chunks().to_batches()[0]
