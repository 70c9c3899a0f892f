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

from bench.corpora.read.frame_rows import Rows
from bench.corpora.read.limits import check_conditions, check_names, quoted, short
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
        label: what messages call it.

    Attributes:
        columns: header names without spaces and quotes.

    Raises:
        InputError: the file is missing, empty or not text.
    """

    def __init__(self, source: Path | bytes, label: str) -> None:
        self.source, self.label = source, label
        where = f"{label}, line 1"
        with self._opened() as file:
            line = file.readline(MOST_LINE)
        if not line:
            raise InputError(f"{label}: the file is empty; give a file with a header line and one line per frame")
        try:
            header = line.decode("utf-8-sig").rstrip("\r\n")
            cells = next(csv.reader([header], skipinitialspace=True), [])
        except UnicodeDecodeError as e:
            raise InputError(f"{label}: not a text file in UTF-8; give the CSV file itself") from e
        except csv.Error as e:
            raise InputError(f"{where}: not a header; give a CSV file whose lines end with line feeds") from e
        if not header.strip():
            raise InputError(f"{where}: blank; begin the file with its header")
        self.columns = [name.strip().strip('"').strip() for name in cells]
        check_names(self.columns, where)

    def _opened(self) -> BinaryIO:
        if isinstance(self.source, bytes):
            return io.BytesIO(self.source)
        try:
            if self.source.exists() and not (self.source.is_file() or self.source.is_dir()):
                raise OSError(0, "a device or a pipe")  # which may have no end
            return open(self.source, "rb")
        except OSError as e:
            raise InputError(f"{self.label}: cannot be read ({e.strerror}); check the path") from e

    def require(self, names: list[str]) -> None:
        """Raise an `InputError` that names the columns that are missing."""
        here = set(self.columns)
        if missing := [n for n in names if n not in here]:
            more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
            begin = quoted(", ".join(self.columns[:20])[:60], 70)
            raise InputError(
                f"{self.label}, line 1: no column {', '.join(missing[:3])}{more}; the line begins with {begin}"
            )

    def read(
        self, whole: list[str], channels: list[str], full_scale: float, fractions: bool = False
    ) -> tuple[pd.DataFrame, np.ndarray]:
        """Labels and sensor values of every row.

        Args:
            whole: label columns that hold whole numbers; the other label columns are text.
            channels: columns of sensor values, 0..full_scale.
            full_scale: largest value allowed.
            fractions: whether values may have decimals.

        Returns:
            Labels [rows], all columns but the channels in file order, and values [rows, channels], uint16 when every
            value is a whole number up to 65535, else float32.

        Raises:
            InputError: a cell that does not fit, with its line and column.
        """
        check_conditions(len(self.columns) - len(channels), f"{self.label}, line 1")
        types = dict.fromkeys(self.columns, _TEXT) | dict.fromkeys(whole, _COUNT)
        types |= dict.fromkeys(channels, _NUMBER if fractions else _WHOLE)
        rows = Rows(f"{self.label}, line", 2, channels, full_scale)
        for first, content in self._blocks():
            try:
                batch = _parsed(content, types)
            except pa.ArrowException:
                self._explain(content.split(b"\n"), first, types)
            rows.add(self.columns, batch)
        return rows.result()

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """Whole lines behind the header, with the number of the first, without blank lines at the end of the file."""
        first, blank = 2, 0
        with self._opened() as file:
            file.readline()
            while content := file.read(BLOCK):
                content += file.readline(MOST_LINE)
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
        if not lines[low].strip(_BLANK):
            raise InputError(f"{where}: blank, but not at the end; delete the line")
        try:
            cells = next(csv.reader([lines[low].decode().rstrip("\r")]), [])
        except UnicodeDecodeError as e:
            raise InputError(f"{where}: not text in UTF-8; get the file again") from e
        except csv.Error as e:
            raise InputError(f"{where}: not a line of a table ({e}); correct it") from e
        if len(cells) != len(types):
            raise InputError(
                f"{where}: {len(cells)} fields instead of {len(types)}; the file is cut off or damaged here, get it "
                "again or delete the line"
            )
        for cell, (name, kind) in zip(cells, types.items(), strict=True):
            try:
                pa.scalar(cell.strip(" \t")).cast(kind)
            except pa.ArrowException:
                what = f"is {quoted(cell)}, not {_KINDS.get(kind, 'text')}; correct the cell"
                raise InputError(f"{where}: {short(name)} {what}") from None
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


def capture_starts(labels: pd.DataFrame, frame: np.ndarray, origin: int, label: str, unit: str = "line") -> np.ndarray:
    """Rows at which captures begin: where the frame number is ``origin``; elsewhere it must go up by one.

    Args:
        labels: columns that stay the same within a capture.
        frame: frame number of each row.
        origin: frame number of the first frame of a capture.
        label: what messages call the file.
        unit: what they call a row: ``line`` where the header is line 1, else ``row``.

    Raises:
        InputError: a capture that starts at another frame, a duplicate or a missing frame.
    """
    changed = np.zeros(len(frame), dtype=bool)
    changed[0] = True
    for name in labels:
        codes = pd.factorize(labels[name])[0]
        changed[1:] |= codes[1:] != codes[:-1]
    starts = frame == origin
    step = np.diff(frame, prepend=origin - 1)
    wrong = np.flatnonzero(~starts & (changed | (step != 1)))
    if len(wrong):
        row = wrong[0]
        where, now = f"{label}, {unit} {row + (2 if unit == 'line' else 1)}", frame[row]
        if changed[row]:
            raise InputError(f"{where}: a capture starts at frame {now} instead of {origin}; restore its first frames")
        if step[row] == 0:
            raise InputError(f"{where}: frame {now} stands twice; delete one of the two lines")
        raise InputError(f"{where}: frame {now} follows frame {frame[row - 1]}; restore the frames or renumber them")
    return np.flatnonzero(starts)
