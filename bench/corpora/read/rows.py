"""Tables with one frame per row, as labels and checked sensor values: CSV, parquet, and pandas in memory.

Rows are read in blocks, so what is no table costs a block, whatever it would expand to.
"""

from __future__ import annotations

import csv
import io
import json
import unicodedata
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pyarrow.types as kinds

from bench.corpora.read.limits import (
    called,
    check_conditions,
    check_file,
    check_names,
    check_unpacked,
    flaw,
    plain,
    quoted,
    short,
)
from bench.corpora.read.sensor_values import check, smallest
from bench.errors import InputError
from bench.progress import warn

SEPARATORS = ",;\t"  # of a CSV file
BLOCK = 8 << 20  # bytes of a CSV file that are read at once
MOST_LINE = 4 << 20  # bytes
AT_ONCE = 1 << 22  # values of a parquet file that are unpacked in one step
_BLANK = b" \t\r\n"
_WORDS, _COUNT, _WHOLE, _NUMBER = pa.dictionary(pa.int32(), pa.string()), pa.int64(), pa.uint16(), pa.float64()
_KINDS = {_COUNT: "a whole number", _WHOLE: "a whole number from 0 to 65535", _NUMBER: "a number"}
_TEXT = (kinds.is_string, kinds.is_large_string, kinds.is_binary, kinds.is_large_binary, kinds.is_fixed_size_binary)
_WIDTHS = {"BOOLEAN": 1, "INT32": 4, "FLOAT": 4, "INT96": 12, "BYTE_ARRAY": 32}  # bytes of a value in memory


@dataclass
class Rows:
    """Rows of a table.

    Attributes:
        labels: all columns but the channels in file order, text as categories.
        values: sensor values [rows, channels], uint16 when all are whole and fit, else float32.
        where: the table and the word for a row in messages: ``my.csv, line``.
        first: number of the first row.
    """

    labels: pd.DataFrame
    values: np.ndarray
    where: str
    first: int

    def refuse(self, row: int, reason: str) -> NoReturn:
        """End with a message about a row."""
        raise InputError(f"{self.where} {self.first + row}: {reason}")

    def check(self, column: str, good: pd.Series, wanted: str) -> None:
        """Refuse the first label that is not good; ``wanted`` describes valid ones."""
        if len(wrong := np.flatnonzero(~good.to_numpy(dtype=bool))):
            value = quoted(str(self.labels[column].iloc[wrong[0]]))
            self.refuse(wrong[0], f"{column} is {value}, not {wanted}; correct it")

    def check_filled(self) -> None:
        """Refuse labels that are missing."""
        if self.labels.isna().any(axis=None):
            row, column = np.argwhere(self.labels.isna().to_numpy())[0]
            self.refuse(row, f"{short(str(self.labels.columns[column]))} is empty; fill the cell")

    def frame_numbers(self) -> np.ndarray:
        """The column ``frame``, which is taken from the labels, int64 [rows]."""
        numbers = self.labels.pop("frame").to_numpy()
        if len(wrong := np.flatnonzero(~(np.abs(numbers.astype(float)) < 2**53) | (numbers != np.round(numbers)))):
            self.refuse(wrong[0], f"frame is {numbers[wrong[0]]}, not a whole number; correct it")
        return numbers.astype(np.int64)

    def starts(self, same: list[str], frame: np.ndarray, origin: int) -> np.ndarray:
        """Rows at which captures begin, where the frame is ``origin``; elsewhere it goes up by one.

        The columns ``same`` stay the same within a capture.
        """
        changed = np.logical_or.reduce([changes(self.labels[name]) for name in same] + [np.arange(len(frame)) == 0])
        starts = frame == origin
        wrong = np.flatnonzero(~starts & (changed | (np.diff(frame, prepend=origin - 1) != 1)))
        if len(wrong):
            row = wrong[0]
            if changed[row]:
                self.refuse(
                    row, f"a capture starts at frame {frame[row]} instead of {origin}; restore its first frames"
                )
            self.refuse_step(row, frame)
        return np.flatnonzero(starts)

    def refuse_step(self, row: int, frame: np.ndarray) -> NoReturn:
        """End with a message about a frame that does not follow the one before."""
        self.refuse(row, f"frame {frame[row]} follows frame {frame[row - 1]}; restore the frames or renumber them")


def changes(column: pd.Series) -> np.ndarray:
    """Whether each row differs from the one before, bool [rows]; the first does not."""
    codes = pd.factorize(column)[0]
    return np.append(False, codes[1:] != codes[:-1])


def without_categories(captures: pd.DataFrame) -> pd.DataFrame:
    """Text instead of categories: plain columns are what a query wants."""
    for column in captures:
        if isinstance(captures[column].dtype, pd.CategoricalDtype):
            captures[column] = captures[column].cat.categories.astype(str).take(captures[column].cat.codes)
    return captures


class Table:
    """A table with one frame per row; subclasses give the rows in batches.

    Attributes:
        columns: names without spaces around them.
        header: beginning of messages about columns.
        where: the table and the word for a row in messages.
        first: number of the first row.
    """

    columns: list[str]
    header: str
    where: str
    first = 1

    def batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Rows; of text each word once (a dictionary), so that a long one that is repeated is not multiplied."""
        raise NotImplementedError

    def read(self, channels: list[str], full_scale: float, blank: str = "") -> Rows:
        """All rows, with the values of the channels in this order; in the column ``blank`` cells may be empty.

        Raises:
            InputError: there are no rows, or a label or a value does not fit; the message names its row.
        """
        check_conditions(len(self.columns) - len(channels), self.header)
        labels: dict[str, list[pd.Categorical | pa.Array]] = {}
        blocks, first = [], self.first
        for batch in self.batches(channels):
            columns = dict(zip(self.columns, batch.columns, strict=True))
            sensors = [columns.pop(name).to_numpy(zero_copy_only=False) for name in channels]  # a gap becomes NaN
            for name, column in zip(channels, sensors, strict=True):
                check(column[:, None], full_scale, self.where, first, [name])
            block = np.stack(sensors, axis=1)
            blocks.append(block.astype(smallest(block)))
            for name, column in columns.items():
                part = words_of(column, name, self.where, first, name == blank) if _is_text(column.type) else column
                labels.setdefault(name, []).append(part)
            first += len(batch)
        if not blocks:
            raise InputError(f"{self.where.partition(',')[0]}: there are no frames in it; give one row per frame")
        table = pd.DataFrame({name: _joined(parts) for name, parts in labels.items()})
        return Rows(table, np.concatenate(blocks), self.where, self.first)


def _joined(parts: list) -> pd.Categorical | np.ndarray | pd.api.extensions.ExtensionArray:
    """A column of labels from those of its batches; whole numbers stay whole where some are missing."""
    if isinstance(parts[0], pd.Categorical):
        return pd.api.types.union_categoricals(parts)
    column = pa.chunked_array(parts)
    if kinds.is_integer(column.type) and column.null_count:
        whole = pd.UInt64Dtype() if kinds.is_unsigned_integer(column.type) else pd.Int64Dtype()
        return column.to_pandas(types_mapper={column.type: whole}.get).array
    return column.to_pandas().to_numpy()


def words_of(column: pa.Array, name: str, where: str, first: int = 1, blank: bool = False) -> pd.Categorical:
    """Labels without spaces around them, from text or bytes that should be text; ``first`` numbers the first row.

    Raises:
        InputError: a label that cannot be, or is empty unless ``blank``; the message names its row.
    """
    coded = column if kinds.is_dictionary(column.type) else column.dictionary_encode()
    count = len(coded.dictionary)
    indices = coded.indices.cast(pa.int64()).fill_null(count).to_numpy()
    used = np.flatnonzero(np.bincount(indices))  # words of other rows are not looked at
    codes = np.searchsorted(used, indices)
    words = []
    contents = coded.dictionary.take(pa.array(used, mask=used == count)).cast(pa.large_binary())
    for i, content in enumerate(contents.to_pylist()):
        try:
            word = (content or b"").decode().strip()
            if not unicodedata.is_normalized("NFC", word):
                word = unicodedata.normalize("NFC", word)
                warn(f"{where.partition(',')[0]}: {name} {word} is spelt in parts (NFD) and read as {word} (NFC)")
            wrong = "" if blank and not word else flaw(word)
        except UnicodeDecodeError:
            wrong = "is not text in UTF-8; save it as text"
        if wrong:
            raise InputError(f"{where} {first + int(np.argmax(codes == i))}: {plain(name, 60)} {wrong}")
        words.append(word)
    merged, categories = pd.factorize(np.array(words, dtype=object))
    return pd.Categorical.from_codes(merged[codes], categories)


def _is_text(kind: pa.DataType) -> bool:
    """Whether a column holds text, or bytes that should be text."""
    kind = kind.value_type if kinds.is_dictionary(kind) else kind
    return any(test(kind) for test in _TEXT)


def _check_types(schema: pa.Schema, names: list[str], numbers: set[str], label: str) -> None:
    """Refuse columns that are neither text nor numbers; those of ``numbers`` must hold numbers."""
    for name, field in zip(names, schema, strict=True):
        number, kind = name in numbers, field.type
        if kinds.is_dictionary(kind) and not number:
            kind = kind.value_type
        if number and not (kinds.is_integer(kind) or kinds.is_floating(kind)):
            raise InputError(f"{label}: {plain(name, 60)} is not a column of numbers; correct it")
        if not (_is_text(kind) or kinds.is_primitive(kind) or kinds.is_decimal(kind)):
            raise InputError(f"{label}: {plain(name, 60)} holds {plain(kind, 40)}; give one text or number per frame")


class PandasTable(Table):
    """A table in memory, which messages call ``label``."""

    def __init__(self, table: pd.DataFrame, label: str) -> None:
        self.columns, self.header, self.where = [*table], label, f"{label}, row"
        try:
            self._rows = pa.Table.from_pandas(table, preserve_index=False).combine_chunks()
        except (pa.ArrowException, TypeError, ValueError) as e:
            raise InputError(f"{label}: a column holds mixed or unknown values ({plain(e)}); correct it") from e

    def batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """The whole table."""
        _check_types(self._rows.schema, self.columns, {*channels, "frame"}, self.header)
        yield from (batch for batch in self._rows.to_batches() if len(batch))


class ParquetTable(Table):
    """A parquet file, whose sizes and types are looked at before anything is unpacked.

    An index that pandas stored is none of its columns.

    Raises:
        InputError: it cannot be read, or unpacks to far more than its size.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.header, self.where = path, called(path), f"{called(path)}, row"
        with self._readable():
            with pq.ParquetFile(path) as file:
                metadata, schema = file.metadata, file.schema_arrow
            leaves = [metadata.schema.column(i) for i in range(metadata.num_columns)]
            row = sum(_WIDTHS.get(leaf.physical_type, max(8, leaf.length)) for leaf in leaves)
            groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
            needed = max(
                sum(group.num_rows for group in groups) * row,
                sum(group.column(i).total_uncompressed_size for group in groups for i in range(len(leaves))),
            )
            index = json.loads((schema.metadata or {}).get(b"pandas", b"{}")).get("index_columns", [])
            index = [name for name in index if isinstance(name, str)]  # others are ranges, which are no columns
        check_unpacked(needed, path, "save it as CSV")
        self._schema = pa.schema([field for field in schema if field.name not in index])
        self.columns = [name.strip() for name in self._schema.names]
        check_names(self.columns, self.header)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except InputError:
            raise
        except Exception as e:  # pyarrow and the text within a file raise a dozen types for damaged bytes
            raise InputError(f"{self.header}: not a readable parquet file ({plain(e)}); save it again") from e

    def read(self, channels: list[str], full_scale: float, blank: str = "") -> Rows:
        """All rows, as of any table."""
        with self._readable():
            return super().read(channels, full_scale, blank)

    def batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Rows as they are unpacked."""
        _check_types(self._schema, self.columns, {*channels, "frame"}, self.header)
        text = [field.name for field in self._schema if _is_text(field.type)]
        with pq.ParquetFile(self.path, read_dictionary=text, page_checksum_verification=True) as file:
            rows = file.iter_batches(max(1, AT_ONCE // len(self.columns)), columns=self._schema.names)
            yield from (batch for batch in rows if len(batch))


class CsvTable(Table):
    """A CSV file: read fast when it is good, explained to the line when it is not.

    Text in UTF-8, a header, as many cells in every line, no line breaks within cells, and blank lines only at the end.
    Cells are separated by the one of `SEPARATORS` that the header has most often.

    Args:
        source: path or content.
        label: name of the file in messages.
        counts: label columns that hold whole numbers; the other label columns are text.
        whole: True if sensor values must not have decimals.

    Raises:
        InputError: the file is missing, empty or not text.
    """

    first = 2

    def __init__(
        self, source: Path | bytes, label: str, counts: Collection[str] = ("frame",), whole: bool = False
    ) -> None:
        self.source, self.label, self.header, self.where = source, label, f"{label}, line 1", f"{label}, line"
        self.counts, self.kind = counts, _WHOLE if whole else _NUMBER
        with self._opened() as file:
            line = file.readline(MOST_LINE)
        self.separator = max(SEPARATORS, key=lambda sign: line.count(sign.encode()))
        try:
            cells = next(self._cells(line.decode("utf-8-sig").rstrip("\r\n"), skipinitialspace=True), [])
        except (UnicodeDecodeError, csv.Error) as e:
            raise InputError(
                f"{self.header}: not the header of a CSV file in UTF-8 ({plain(e)}); give the CSV file itself"
            ) from e
        self.columns = [name.strip().strip('"').strip() for name in cells]
        if not any(self.columns):
            raise InputError(f"{self.header}: empty; begin the file with its header")
        check_names(self.columns, self.header)

    def _cells(self, line: str, **how: bool) -> Iterator[list[str]]:
        return csv.reader([line], delimiter=self.separator, **how)

    def _opened(self) -> BinaryIO:
        if isinstance(self.source, bytes):
            return io.BytesIO(self.source)
        check_file(self.source)
        try:
            return open(self.source, "rb")
        except OSError as e:
            raise InputError(f"{self.label}: cannot be read ({e.strerror}); check the path") from e

    def batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Rows of a block of lines at a time."""
        sensors = {*channels}
        types = {n: self.kind if n in sensors else _COUNT if n in self.counts else _WORDS for n in self.columns}
        for first, content in self._blocks():
            try:
                yield self._parsed(content, types)
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
                    raise InputError(f"{self.where} {blank}: blank, but not at the end; delete the line")
                if content:
                    yield first, content
                if lines > used and not blank:
                    blank = first + used
                first += lines

    def _parsed(self, content: bytes, types: dict[str, pa.DataType]) -> pa.RecordBatch:
        """Rows of some lines; whole numbers may be written as 1.0, as pandas does where a cell was missing."""
        try:
            table = self._read(content, types)
        except pa.ArrowException:
            numbers = {name: _NUMBER if kind == _COUNT else kind for name, kind in types.items()}
            table = self._read(content, numbers).cast(pa.schema([*types.items()]))
        if len(table) != content.count(b"\n") + 1:
            raise pa.ArrowInvalid("a blank line, or a line break within a cell")
        return table.combine_chunks().to_batches()[0]

    def _read(self, content: bytes, types: dict[str, pa.DataType]) -> pa.Table:
        return pacsv.read_csv(
            pa.BufferReader(b"\n%b\n" % content),  # no mark of a file's beginning is skipped, no open quote is closed
            read_options=pacsv.ReadOptions(column_names=list(types), block_size=len(content) + 3),
            parse_options=pacsv.ParseOptions(delimiter=self.separator),
            convert_options=pacsv.ConvertOptions(column_types=types, null_values=[]),
        )

    def _explain(self, lines: list[bytes], first: int, types: dict[str, pa.DataType]) -> NoReturn:
        """Say what is wrong with the first line that does not fit, which is found by halving."""
        low, high = 0, len(lines)
        while high - low > 1:
            middle = (low + high) // 2
            try:
                self._parsed(b"\n".join(lines[low:middle]), types)
                low = middle
            except pa.ArrowException:
                high = middle
        where = f"{self.where} {first + low}"
        try:
            cells = next(self._cells(lines[low].decode().rstrip("\r")), [])
        except (UnicodeDecodeError, csv.Error) as e:
            raise InputError(f"{where}: not a line of a CSV file in UTF-8 ({plain(e)}); correct it") from e
        if len(cells) != len(types):
            raise InputError(
                f"{where}: {len(cells)} fields instead of {len(types)}; the file is cut off or damaged here, get it "
                "again or delete the line"
            )
        for cell, (name, kind) in zip(cells, types.items(), strict=True):
            try:
                value = pa.scalar(cell.strip(" \t"))
                (value.cast(_NUMBER) if kind == _COUNT else value).cast(kind)
            except pa.ArrowException:
                reason = f"{quoted(cell)}, not {_KINDS.get(kind, 'text')}"
                raise InputError(f"{where}: {short(name)} is {reason}; correct the cell") from None
        raise InputError(f"{where}: cannot be read as CSV; check quotes and line ends")
