"""Long CSV files of touch frames: read fast when they are good, explained to the line when they are not."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv

from bench.errors import InputError


class FrameFile:
    """A CSV file, or the bytes of one, with one frame per row.

    Args:
        source: path or content.
        label: what messages call it.

    Attributes:
        columns: header names without spaces and quotes.

    Raises:
        InputError: the file is missing, empty or not text.
    """

    def __init__(self, source: Path | bytes, label: str) -> None:
        self.source = source
        self.label = label
        try:
            with io.BytesIO(source) if isinstance(source, bytes) else open(source, "rb") as f:
                head = f.read(1 << 20).splitlines()
            header = head[0].decode("utf-8-sig") if head else ""
        except UnicodeDecodeError as e:
            raise InputError(f"{label}: not a text file in UTF-8; give the CSV file itself") from e
        except OSError as e:
            raise InputError(f"{label}: cannot be read ({e.strerror}); check the path") from e
        if not header.strip():
            raise InputError(f"{label}: the file is empty; give a file with a header line and one line per frame")
        self.columns = [name.strip().strip('"').strip() for name in header.split(",")]
        if twice := {name for name in self.columns if self.columns.count(name) > 1}:
            raise InputError(f"{label}, line 1: column {min(twice)!r} stands twice; rename one")

    def _open(self) -> TextIO:
        options = {"encoding": "utf-8-sig", "errors": "replace", "newline": ""}
        if isinstance(self.source, bytes):
            return io.TextIOWrapper(io.BytesIO(self.source), **options)
        return open(self.source, **options)

    def require(self, names: list[str]) -> None:
        """Raise an `InputError` that names the columns that are missing."""
        if missing := [n for n in names if n not in self.columns]:
            more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
            raise InputError(
                f"{self.label}, line 1: no column {', '.join(missing[:3])}{more}; the line begins with "
                f"{', '.join(self.columns)[:60]!r}"
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
            value is a whole number, else float32.

        Raises:
            InputError: a cell that does not fit, with its line and column.
        """
        try:
            table = self._parse(whole, channels, pa.uint16())
        except pa.ArrowInvalid:
            try:
                table = self._parse(whole, channels, pa.float32()) if fractions else None
            except pa.ArrowInvalid:
                table = None
        if table is None or any(column.null_count for column in table.itercolumns()):
            self._explain(whole, channels, full_scale, fractions)
        if not len(table):
            raise InputError(f"{self.label}: a header and no frames; give a file with one line per frame")
        values = np.empty((len(table), len(channels)), np.uint16 if table.field(channels[0]).type == "uint16" else "f4")
        for i, name in enumerate(channels):
            values[:, i] = table[name].to_numpy()
        labels = table.drop_columns(channels)
        del table
        if not (values.max() <= full_scale and values.min() >= 0):  # a NaN fails too
            self._explain(whole, channels, full_scale, fractions)
        return labels.to_pandas(), values

    def _parse(self, whole: list[str], channels: list[str], values: pa.DataType) -> pa.Table:
        types = dict.fromkeys(self.columns, pa.dictionary(pa.int32(), pa.string()))
        types |= dict.fromkeys(whole, pa.int64()) | dict.fromkeys(channels, values)
        source = io.BytesIO(self.source) if isinstance(self.source, bytes) else str(self.source)
        return pacsv.read_csv(
            source,
            read_options=pacsv.ReadOptions(column_names=self.columns, skip_rows=1, block_size=8 << 20),
            parse_options=pacsv.ParseOptions(ignore_empty_lines=False),
            convert_options=pacsv.ConvertOptions(column_types=types, strings_can_be_null=True, null_values=[""]),
        )

    def _explain(self, whole: list[str], channels: list[str], full_scale: float, fractions: bool) -> None:
        """Find the first line that does not fit and say what is wrong with it; always raises."""
        whole_columns = [(self.columns.index(n), n) for n in whole]
        channel_columns = [(self.columns.index(n), n) for n in channels]
        line = 1
        for line, cells in self._lines():
            where = f"{self.label}, line {line}"
            if len(cells) != len(self.columns):
                raise InputError(
                    f"{where}: {len(cells)} fields instead of {len(self.columns)}; the file is cut off or damaged "
                    "here, get it again or delete the line"
                )
            for i, name in whole_columns:
                if not re.fullmatch(r"-?[0-9]{1,18}", cells[i].strip()):
                    raise InputError(f"{where}: {name} is {cells[i]!r}, not a whole number; correct the cell")
            for i, name in channel_columns:
                _check_value(where, name, cells[i].strip(), full_scale, fractions)
            for name, cell in zip(self.columns, cells, strict=True):
                if not cell.strip():
                    raise InputError(f"{where}: {name} is empty; fill the cell")
        if line == 1:
            raise InputError(f"{self.label}: a header and no frames; give a file with one line per frame")
        raise InputError(f"{self.label}: the file cannot be read as CSV; check its quotes and line ends")

    def _lines(self) -> Iterator[tuple[int, list[str]]]:
        with self._open() as f:
            reader = csv.reader(f)
            next(reader)
            line = reader.line_num + 1  # where a record begins; an open quote makes it end lines later
            try:
                for cells in reader:
                    if any("\ufffd" in cell for cell in cells):  # what decoding puts for bytes that are not UTF-8
                        raise InputError(f"{self.label}, line {line}: not text in UTF-8; get the file again")
                    yield line, cells
                    line = reader.line_num + 1
            except csv.Error as e:
                raise InputError(f"{self.label}, line {line}: not CSV text ({e}); get the file again") from e


def _check_value(where: str, name: str, cell: str, full_scale: float, fractions: bool) -> None:
    try:
        if not re.fullmatch(r"-?[0-9]+" if not fractions else r"[^_]+", cell):
            raise ValueError(cell)
        value = float(cell)
        if math.isnan(value):
            raise ValueError(cell)
    except ValueError as e:
        kind = "a number" if fractions else "a whole number"
        raise InputError(f"{where}: {name} is {cell!r}, not {kind}; correct the cell") from e
    if value < 0 or (cell.startswith("-") and not fractions):
        raise InputError(f"{where}: {name} is {cell}, below 0; correct the cell")
    if not value <= full_scale:
        raise InputError(
            f"{where}: {name} is {cell}, above the full scale {full_scale:g}; correct it or give full_scale="
        )


def capture_starts(labels: pd.DataFrame, frame: np.ndarray, origin: int, label: str) -> np.ndarray:
    """Rows at which captures begin: where the frame number is ``origin``; elsewhere it must go up by one.

    Args:
        labels: columns that stay the same within a capture.
        frame: frame number of each row.
        origin: frame number of the first frame of a capture.
        label: what messages call the file.

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
        where, now = f"{label}, line {row + 2}", frame[row]
        if changed[row]:
            raise InputError(f"{where}: a capture starts at frame {now} instead of {origin}; restore its first frames")
        if step[row] == 0:
            raise InputError(f"{where}: frame {now} stands twice; delete one of the two lines")
        raise InputError(f"{where}: frame {now} follows frame {frame[row - 1]}; restore the frames or renumber them")
    return np.flatnonzero(starts)
