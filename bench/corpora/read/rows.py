"""Tables with one frame per row, read as labels and checked sensor values.

CSV files are read in blocks, so that only their sensor values must fit into memory. Parquet files
are refused if they would unpack to far more than their own size.
"""

from __future__ import annotations

import csv
import mmap
import re
import unicodedata
from collections.abc import Collection, Iterator
from functools import cached_property
from pathlib import Path
from typing import NoReturn, Self

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pyarrow.types as kinds

from bench.corpora.read.archive import refuse_damage
from bench.corpora.read.limits import (
    check_column_names,
    check_condition_count,
    check_file,
    check_unpacked_size,
    check_values,
    file_name,
    first_names,
    label_defect,
    quote_text,
    smallest_dtype,
)
from bench.errors import InputError, one_line, shorten
from bench.ground.progress import warn

SEPARATORS = ",;\t"  # of a CSV file
BLOCK = 8 << 20  # bytes of a CSV file that are parsed at once, at least a line
MOST_HEADER = 4 << 20  # bytes
TEXT = pa.dictionary(pa.int32(), pa.string())  # each word once, so that repeated ones take no room
BYTES_PER_VALUE = 4  # in memory: a number, or the code of a word
DAMAGED_PARQUET = "not a readable parquet file ({}); save it again"
LEAST_WRAP, FEW_CUTS = 64, 3  # frames of a counter that wraps; cuts that tell nothing alone
INTEGERS = {pa.int64(): pd.Int64Dtype()}  # with gaps
NUMBER_WORDS = {
    "int64": "a whole number",
    "uint16": "a whole number from 0 to 65535",
    "double": "a number",
}


def differs_from_previous(column: pd.Series) -> np.ndarray:
    """True where a row differs from the one before, bool [rows]; False for the first row."""
    codes = pd.factorize(column)[0]
    return np.append(False, codes[1:] != codes[:-1])


def categories_as_text(captures: pd.DataFrame) -> pd.DataFrame:
    """The table with text in place of categories, as queries need it."""
    for column in captures.select_dtypes("category"):
        words = captures[column].cat
        captures[column] = words.categories.astype(str).take(words.codes)
    return captures


class Table:
    """A table with one frame per row; subclasses read its rows in batches.

    Attributes:
        columns: names of the columns, without spaces around them.
        header_prefix: beginning of messages about columns.
        row_prefix: beginning of messages about a row, whose number follows: ``my.csv, line``.
        first: number of the first row.
        labels: all columns but the channels, in file order, text as categories; after `read_rows`.
        values: sensor values [rows, channels], uint16 if all are whole and fit, else float32.
    """

    columns: list[str]
    header_prefix: str
    row_prefix: str
    first = 1
    labels: pd.DataFrame
    values: np.ndarray

    @cached_property
    def notes(self) -> list[str]:
        """Warnings about the rows."""
        return []

    def read_batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield the rows; the columns ``channels`` must hold numbers."""
        raise NotImplementedError

    def read_rows(self, channels: list[str], full_scale: float, optional: str = "") -> Self:
        """Read all rows into `labels` and `values`.

        Args:
            channels: columns of sensor values, in the order of the taxels.
            full_scale: largest value that the sensor can give.
            optional: column in which cells may be empty.

        Raises:
            InputError: a cell or a column does not fit, or there is no row.
        """
        check_condition_count(len(self.columns) - len(channels), self.header_prefix)
        positions = {name: i for i, name in enumerate(self.columns)}
        labels = sorted(positions[name] for name in positions.keys() - {*channels})
        batches, blocks, first = [], [], self.first
        for batch in self.read_batches(channels):
            # A gap becomes NaN, which is refused.
            sensors = [batch.column(positions[name]) for name in channels]
            block = np.stack([s.to_numpy(zero_copy_only=False) for s in sensors], axis=1)
            check_values(block, full_scale, self.row_prefix, first, channels)
            blocks.append(block.astype(smallest_dtype(block)))
            batches.append(batch.rename_columns(self.columns).select(labels))
            first += len(batch)
        if not blocks:
            raise InputError(f"{self.header_prefix}: no frames below it; give one row per frame")
        self.labels = self._as_labels(pa.Table.from_batches(batches), optional)
        self.values = np.concatenate(blocks)
        return self

    def _as_labels(self, table: pa.Table, optional: str = "") -> pd.DataFrame:
        """Columns of labels: text as categories; whole numbers stay whole beside gaps."""
        labels: dict[str, object] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            if _is_text(column.type):
                words = column.unify_dictionaries().combine_chunks()
                labels[name] = text_categories(
                    words, name, self.row_prefix, self.first, name == optional
                )
            elif kinds.is_integer(column.type) and column.null_count:
                labels[name] = column.cast(pa.int64()).to_pandas(types_mapper=INTEGERS.get).array
            else:
                labels[name] = column.to_pandas().to_numpy()
        return pd.DataFrame(labels)

    def refuse_row(self, row: int, reason: str) -> NoReturn:
        """Raise an `InputError` about a row."""
        raise InputError(f"{self.row_prefix} {self.first + row}: {reason}")

    def check_labels(self, column: str, valid: pd.Series, wanted: str) -> None:
        """Refuse the first label that is not valid; ``wanted`` describes valid ones."""
        if len(wrong := np.flatnonzero(~valid.to_numpy(dtype=bool))):
            value = quote_text(str(self.labels[column].iloc[wrong[0]]))
            self.refuse_row(wrong[0], f"{column} is {value}, not {wanted}; correct it")

    def check_filled(self) -> None:
        """Refuse missing labels."""
        if len(gaps := np.argwhere(self.labels.isna().to_numpy())):
            row, column = gaps[0]
            self.refuse_row(row, f"{shorten(self.labels.columns[column])} is empty; fill the cell")

    def take_frame_numbers(self) -> np.ndarray:
        """Remove the column ``frame`` from the labels and return it, int64 [rows]."""
        numbers = self.labels.pop("frame").to_numpy()
        exact = np.abs(numbers.astype(float)) < 2**53
        if len(wrong := np.flatnonzero(~exact | (numbers != np.round(numbers)))):
            self.refuse_row(
                wrong[0], f"frame is {numbers[wrong[0]]}, not a whole number; correct it"
            )
        return numbers.astype(np.int64)

    def check_constant(self, columns: list[str], frame: np.ndarray) -> None:
        """Refuse columns that change from a frame to the next while subject and gesture stay."""
        changed = {name: differs_from_previous(self.labels[name]) for name in self.labels}
        others = [changed[name] for name in changed.keys() - {*columns}]
        follows = np.diff(frame, prepend=frame[0]) == 1
        follows &= ~np.logical_or.reduce([*others, np.zeros(len(frame), bool)])
        rows = {name: np.flatnonzero(changed[name] & follows) for name in columns}
        if wrong := {name: each[0] for name, each in rows.items() if len(each)}:
            first = min(wrong, key=wrong.__getitem__)
            more = [name for name in wrong if name != first]
            also = f" (so does {first_names(more)})" if more else ""
            self.refuse_row(
                wrong[first],
                f"{shorten(first)} changes within a capture{also}; delete the column, or if it is "
                "a channel, put all channels last, or if a capture begins here, restart frame",
            )

    def unwrap_frame_numbers(self, same: list[str], frame: np.ndarray, origin: int) -> np.ndarray:
        """Frame numbers that go on where a counter wraps, which a note says.

        A counter wraps if frame numbers begin again although no label changes, always after the
        same number, the highest of all, and if most of these stretches do not end with it, too:
        captures of a fixed length do. One or two cuts tell this only after a power of two.

        Args:
            same: columns of labels that do not change within a capture.
            frame: number of each frame.
            origin: number of the first frame of a capture.
        """
        changes = [differs_from_previous(self.labels[name]) for name in same]
        begins = np.logical_or.reduce([*changes, np.arange(len(frame)) == 0])
        is_cut = ~begins & (frame == origin)
        cuts, starts = np.flatnonzero(is_cut), np.flatnonzero(begins)
        if not len(cuts) or (frame[cuts - 1] != frame.max()).any():
            return frame
        count, run = int(frame.max()) - origin + 1, np.cumsum(begins) - 1
        ends = frame[np.append(starts[1:], len(frame)) - 1][np.unique(run[cuts])]
        is_binary = count >= LEAST_WRAP and count.bit_count() == 1
        seen = f"frame begins again after {frame.max()} {len(cuts)} times where no label changes"
        if (ends < frame.max()).mean() <= 0.5 or (len(cuts) < FEW_CUTS and not is_binary):
            if is_binary:
                self.notes.append(f"{seen}; if it is a counter that wraps, number the frames on")
            return frame
        self.notes.append(
            f"{seen}, as a counter that wraps: {len(starts) + len(cuts)} pieces are joined to "
            f"{len(starts)} captures; if the pieces are captures, number them in a column"
        )
        wraps = np.cumsum(is_cut)
        return frame + count * (wraps - wraps[starts][run])

    def split_captures(
        self, same: list[str], frame: np.ndarray, origin: int
    ) -> tuple[pd.DataFrame, np.ndarray, np.ndarray]:
        """Split the rows into captures.

        Args:
            same: columns of labels that do not change within a capture.
            frame: number of each frame, which goes up by one within a capture.
            origin: number of the first frame of a capture.

        Returns:
            Labels, first row and number of frames of each capture.
        """
        changes = [differs_from_previous(self.labels[name]) for name in same]
        changed = np.logical_or.reduce([*changes, np.arange(len(frame)) == 0])
        starts = frame == origin
        jumps = np.diff(frame, prepend=origin - 1) != 1
        if len(wrong := np.flatnonzero(~starts & (changed | jumps))):
            row = wrong[0]
            if not changed[row]:
                self.refuse_frame_step(row, frame)
            self.refuse_row(
                row,
                f"a capture starts at frame {frame[row]} instead of {origin}; "
                "restore its first frames",
            )
        first = np.flatnonzero(starts)
        captures = categories_as_text(self.labels.iloc[first].reset_index(drop=True))
        return captures, first, np.diff(first, append=len(frame))

    def refuse_frame_step(self, row: int, frame: np.ndarray) -> NoReturn:
        """Raise an `InputError` about a frame that does not follow the one before."""
        self.refuse_row(
            row,
            f"frame {frame[row]} follows frame {frame[row - 1]}; "
            "restore the frames or renumber them",
        )


def text_categories(
    column: pa.Array, name: str, row_prefix: str, first: int = 1, may_be_empty: bool = False
) -> pd.Categorical:
    """Labels without spaces around them, as composed Unicode characters (NFC).

    Args:
        column: text, or bytes that are text in UTF-8.
        name: name of the column.
        row_prefix: beginning of messages about a row.
        first: number of the first row.
        may_be_empty: True if a label may be missing.

    Raises:
        InputError: a label is empty, too long, not text, or has characters that cannot be seen.
    """
    encoded = column if kinds.is_dictionary(column.type) else column.dictionary_encode()
    codes = encoded.indices.cast(pa.int64()).fill_null(-1).to_numpy()
    used, positions = np.unique(codes, return_inverse=True)
    words = []
    for code in used.tolist():
        content = encoded.dictionary[code].cast(pa.large_binary()).as_py() if code >= 0 else b""
        try:
            text = content.decode()
            word, has_line_end = text.strip(), "\n" in text or "\r" in text
            defect = label_defect(text if has_line_end else word)
        except UnicodeDecodeError:
            word, defect = "?", "is not text in UTF-8; save it as text"
        if defect and (word or not may_be_empty):
            row = first + int(np.argmax(codes == code))
            raise InputError(f"{row_prefix} {row}: {one_line(name, 60)} {defect}")
        words.append(unicodedata.normalize("NFC", word))
        if words[-1] != word:
            place = row_prefix.partition(",")[0]
            warn(f"{place}: {name} {words[-1]} is spelt in parts (NFD) and read as NFC")
    merged, categories = pd.factorize(np.array(words, dtype=object))
    return pd.Categorical.from_codes(merged[positions], categories)


def _is_text(kind: pa.DataType) -> bool:
    """True for a column of text, or of bytes that should be text."""
    kind = kind.value_type if kinds.is_dictionary(kind) else kind
    is_string = kinds.is_string(kind) or kinds.is_large_string(kind)
    is_bytes = kinds.is_binary(kind) or kinds.is_large_binary(kind)
    return is_string or is_bytes or kinds.is_fixed_size_binary(kind)


def _check_types(schema: pa.Schema, numbers: set[str], place: str) -> None:
    """Refuse columns that hold neither text nor numbers; those of ``numbers`` must hold numbers."""
    for name, kind in zip(schema.names, schema.types, strict=True):
        if name in numbers and not (kinds.is_integer(kind) or kinds.is_floating(kind)):
            raise InputError(
                f"{place}: {one_line(name, 60)} is not a column of numbers; correct it"
            )
        inner = kind.value_type if kinds.is_dictionary(kind) else kind
        if not (_is_text(inner) or kinds.is_primitive(inner) or kinds.is_decimal(inner)):
            raise InputError(
                f"{place}: {one_line(name, 60)} holds {one_line(kind, 40)}; "
                "give one text or number per frame"
            )


class ArrowTable(Table):
    """A table in memory, which messages call ``label``."""

    def __init__(self, rows: pa.Table, label: str, row: str = "row") -> None:
        self.columns = [name.strip() for name in rows.column_names]
        self.header_prefix, self.row_prefix = label, f"{label}, {row}"
        self._rows = rows.rename_columns(self.columns)

    def read_batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield the rows as they lie in memory."""
        _check_types(self._rows.schema, {*channels, "frame"}, self.header_prefix)
        yield from (batch for batch in self._rows.to_batches() if len(batch))

    def label_columns(self) -> pd.DataFrame:
        """All columns as labels."""
        return self._as_labels(self._rows)


def table_from_pandas(table: pd.DataFrame, label: str, row: str = "row") -> ArrowTable:
    """A pandas table; messages call it ``label`` and its rows ``row``."""
    try:
        rows = pa.Table.from_pandas(table, preserve_index=False)
    except (pa.ArrowException, TypeError, ValueError) as e:
        raise InputError(
            f"{label}: a column holds mixed or unknown values ({one_line(e)}); correct it"
        ) from e
    return ArrowTable(rows, label, row)


def table_from_parquet(path: Path) -> ArrowTable:
    """A parquet file, without an index that pandas stored.

    Raises:
        InputError: it is damaged, or would unpack to more than its size explains.
    """
    with refuse_damage(path, DAMAGED_PARQUET), pq.ParquetFile(path) as file:
        metadata, schema = file.metadata, file.schema_arrow
        groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
        values = sum(group.num_rows for group in groups) * metadata.num_columns
        packed = sum(group.total_byte_size for group in groups)
        check_unpacked_size(max(values * BYTES_PER_VALUE, packed), path, "save it as CSV")
        index = (schema.pandas_metadata or {}).get("index_columns", [])  # a range is no column
        columns = [field.name for field in schema if field.name not in index]
        text = [field.name for field in schema if _is_text(field.type)]
        rows = pq.read_table(
            path, columns=columns, read_dictionary=text, page_checksum_verification=True
        )
    table = ArrowTable(rows, file_name(path))
    check_column_names(table.columns, table.header_prefix)
    return table


class CsvTable(Table):
    """A CSV file in UTF-8 with a header, the same number of cells per line, and no blank lines.

    Cells are separated by the one of `SEPARATORS` that is most frequent in the header. Blank lines
    at the end are ignored.

    Args:
        source: path or content.
        label: name of the file in messages.
        counts: label columns that hold numbers; the other label columns are text.
        whole: True if neither these nor sensor values may have decimals.
    """

    first = 2

    def __init__(
        self,
        source: Path | bytes,
        label: str,
        counts: Collection[str] = ("frame",),
        whole: bool = False,
    ) -> None:
        self.header_prefix, self.row_prefix = f"{label}, line 1", f"{label}, line"
        self.counts, self.whole = counts, whole
        content = _load_content(source, label)
        header, _, _ = bytes(content[:MOST_HEADER]).partition(b"\n")
        self._rows = content[len(header) + 1 :]
        self.separator = max(SEPARATORS, key=lambda sign: header.count(sign.encode()))
        try:
            text = header.decode("utf-8-sig").rstrip("\r")
            cells = next(csv.reader([text], delimiter=self.separator, skipinitialspace=True), [])
        except (UnicodeDecodeError, csv.Error) as e:
            raise InputError(
                f"{self.header_prefix}: not the header of a CSV file in UTF-8 ({one_line(e)}); "
                "give the CSV file itself"
            ) from e
        self.columns = [name.strip().strip('"').strip() for name in cells]
        if not any(self.columns):
            raise InputError(f"{self.header_prefix}: empty; begin the file with its header")
        check_column_names(self.columns, self.header_prefix)

    def read_batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield the rows of one block of lines after another."""
        if not self._rows:
            return
        count, value = (pa.int64(), pa.uint16()) if self.whole else (pa.float64(), pa.float64())
        types = dict.fromkeys(self.columns, TEXT) | dict.fromkeys(self.counts, count)
        types |= dict.fromkeys(channels, value)
        read = pacsv.ReadOptions(column_names=self.columns, block_size=BLOCK, use_threads=False)
        parse = pacsv.ParseOptions(delimiter=self.separator, ignore_empty_lines=False)
        convert = pacsv.ConvertOptions(column_types=types, null_values=[])
        line = self.first
        try:
            for batch in pacsv.open_csv(pa.BufferReader(self._rows), read, parse, convert):
                yield batch
                line += len(batch)
        except pa.ArrowInvalid as e:
            self._refuse_line(str(e), line)

    def _refuse_line(self, error: str, line: int) -> NoReturn:
        """Turn Arrow's error into one with a line number; all lines before ``line`` were read."""
        if match := re.search(r"Row #(\d+): ", error):
            line = int(match[1]) + self.first - 1
        conversion = r"column #(\d+): .*error to (\w+): (?:invalid value '(.*)')?"
        if match := re.search(r"Expected (\d+) columns, got (\d+)", error):
            reason = (
                f"{match[2]} fields instead of {match[1]}; "
                "the file is cut off or damaged here, get it again or delete the line"
            )
        elif match := re.search(conversion, error, re.DOTALL):
            column, kind, value = match.groups()
            wanted = NUMBER_WORDS.get(kind, "text in UTF-8")
            shown = quote_text(value) if value is not None else "bytes"
            reason = f"{shorten(self.columns[int(column)])} is {shown}, not {wanted}; correct it"
        else:
            reason = "cannot be read as CSV; check quotes and line ends"
        raise InputError(f"{self.row_prefix} {line}: {reason}")


def _load_content(source: Path | bytes, label: str) -> memoryview:
    """Content of a file, mapped, without blanks at its end."""
    content: bytes | mmap.mmap = source if isinstance(source, bytes) else b""
    if isinstance(source, Path):
        check_file(source)
        if source.stat().st_size:
            with open(source, "rb") as file:
                content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    end = len(content)
    while end and content[end - 1 : end].isspace():
        end -= 1
    if content[content.rfind(b"\n", 0, end) + 1 : end].count(b'"') % 2:  # Arrow would close it
        raise InputError(
            f"{label}: a quote is open in the last line; close it, or get the file again"
        )
    return memoryview(content)[:end]
