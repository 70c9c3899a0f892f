"""Tables with one frame per row, as labels and checked sensor values: CSV, parquet, and pandas in memory.

Rows are read in blocks, so what is no table costs a block, whatever it would expand to.
"""

from __future__ import annotations

import csv
import mmap
import re
import unicodedata
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn, Self

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pyarrow.types as kinds

from bench.corpora.read.limits import (
    check_column_names,
    check_condition_count,
    check_file,
    check_unpacked_size,
    check_values,
    file_name,
    label_defect,
    one_line,
    quote_text,
    shorten,
    smallest_dtype,
)
from bench.errors import InputError
from bench.ground.progress import warn

SEPARATORS = ",;\t"  # of a CSV file
BLOCK = 8 << 20  # bytes of a CSV file that are parsed at once, at least a line
MOST_LINE = 4 << 20  # bytes
AT_ONCE = 1 << 22  # values of a parquet file that are unpacked in one step
_WORDS = pa.dictionary(pa.int32(), pa.string())
_KINDS = {
    "int64": "a whole number",
    "uint16": "a whole number from 0 to 65535",
    "double": "a number",
}
_TEXT = (
    kinds.is_string,
    kinds.is_large_string,
    kinds.is_binary,
    kinds.is_large_binary,
    kinds.is_fixed_size_binary,
)
_WIDTHS = {
    "BOOLEAN": 1,
    "INT32": 4,
    "FLOAT": 4,
    "INT96": 12,
    "BYTE_ARRAY": 32,
}  # bytes of a value in memory


def differs_from_previous(column: pd.Series) -> np.ndarray:
    """Whether each row differs from the one before, bool [rows]; the first does not."""
    codes = pd.factorize(column)[0]
    return np.append(False, codes[1:] != codes[:-1])


def categories_as_text(captures: pd.DataFrame) -> pd.DataFrame:
    """Text instead of categories: plain columns are what a query wants."""
    for column in captures:
        if isinstance(captures[column].dtype, pd.CategoricalDtype):
            captures[column] = (
                captures[column].cat.categories.astype(str).take(captures[column].cat.codes)
            )
    return captures


class Table:
    """A table with one frame per row; subclasses give the rows in batches."""

    columns: list[str]  # without spaces around them
    header_prefix: str  # beginning of messages about columns
    row_prefix: str  # the table and the word for a row in messages: "my.csv, line"
    first = 1  # number of the first row
    labels: (
        pd.DataFrame
    )  # once read: all columns but the channels in file order, text as categories
    values: (
        np.ndarray
    )  # once read: of sensors [rows, channels], uint16 when all are whole and fit, else float32

    def read_batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Rows; of text each word once (a dictionary), so that a long one that is repeated is not multiplied."""
        raise NotImplementedError

    def read_rows(self, channels: list[str], full_scale: float, blank: str = "") -> Self:
        """Read all rows, the values of the channels in this order; in the column ``blank`` cells may be empty."""
        check_condition_count(len(self.columns) - len(channels), self.header_prefix)
        labels: dict[str, list[pa.Array]] = {}
        blocks, first = [], self.first
        for batch in self.read_batches(channels):
            columns = dict(zip(self.columns, batch.columns, strict=True))
            sensors = [
                columns.pop(name).to_numpy(zero_copy_only=False) for name in channels
            ]  # a gap becomes NaN
            for name, column in zip(channels, sensors, strict=True):
                check_values(column[:, None], full_scale, self.row_prefix, first, [name])
            block = np.stack(sensors, axis=1)
            blocks.append(block.astype(smallest_dtype(block)))
            for name, column in columns.items():
                labels.setdefault(name, []).append(column)
            first += len(batch)
        if not blocks:
            raise InputError(
                f"{self.row_prefix.partition(',')[0]}: there are no frames in it; give one row per frame"
            )
        table = {
            name: self._joined(pa.chunked_array(parts), name, name == blank)
            for name, parts in labels.items()
        }
        self.labels, self.values = pd.DataFrame(table), np.concatenate(blocks)
        return self

    def refuse_row(self, row: int, reason: str) -> NoReturn:
        """End with a message about a row."""
        raise InputError(f"{self.row_prefix} {self.first + row}: {reason}")

    def check_labels(self, column: str, good: pd.Series, wanted: str) -> None:
        """Refuse the first label that is not good; ``wanted`` describes valid ones."""
        if len(wrong := np.flatnonzero(~good.to_numpy(dtype=bool))):
            value = quote_text(str(self.labels[column].iloc[wrong[0]]))
            self.refuse_row(wrong[0], f"{column} is {value}, not {wanted}; correct it")

    def check_filled(self) -> None:
        """Refuse labels that are missing."""
        if self.labels.isna().any(axis=None):
            row, column = np.argwhere(self.labels.isna().to_numpy())[0]
            self.refuse_row(
                row, f"{shorten(str(self.labels.columns[column]))} is empty; fill the cell"
            )

    def take_frame_numbers(self) -> np.ndarray:
        """The column ``frame``, which is taken from the labels, int64 [rows]."""
        numbers = self.labels.pop("frame").to_numpy()
        if len(
            wrong := np.flatnonzero(
                ~(np.abs(numbers.astype(float)) < 2**53) | (numbers != np.round(numbers))
            )
        ):
            self.refuse_row(
                wrong[0], f"frame is {numbers[wrong[0]]}, not a whole number; correct it"
            )
        return numbers.astype(np.int64)

    def split_captures(
        self, same: list[str], frame: np.ndarray, origin: int
    ) -> tuple[pd.DataFrame, np.ndarray, np.ndarray]:
        """Labels, first row and length of each capture, which begins where the frame is ``origin``.

        Elsewhere the frame goes up by one, and the columns ``same`` stay the same.
        """
        changed = np.logical_or.reduce(
            [differs_from_previous(self.labels[name]) for name in same]
            + [np.arange(len(frame)) == 0]
        )
        starts = frame == origin
        wrong = np.flatnonzero(~starts & (changed | (np.diff(frame, prepend=origin - 1) != 1)))
        if len(wrong):
            row = wrong[0]
            if not changed[row]:
                self.refuse_frame_step(row, frame)
            self.refuse_row(
                row,
                f"a capture starts at frame {frame[row]} instead of {origin}; restore its first frames",
            )
        first = np.flatnonzero(starts)
        captures = categories_as_text(self.labels.iloc[first].reset_index(drop=True))
        return captures, first, np.diff(first, append=len(frame))

    def refuse_frame_step(self, row: int, frame: np.ndarray) -> NoReturn:
        """End with a message about a frame that does not follow the one before."""
        self.refuse_row(
            row,
            f"frame {frame[row]} follows frame {frame[row - 1]}; restore the frames or renumber them",
        )

    def _joined(self, column: pa.ChunkedArray, name: str, blank: bool) -> object:
        """A column of labels; whole numbers stay whole where some are missing."""
        if _is_text(column.type):
            return text_categories(
                column.unify_dictionaries().combine_chunks(),
                name,
                self.row_prefix,
                self.first,
                blank,
            )
        if kinds.is_integer(column.type) and column.null_count:
            whole = pd.UInt64Dtype() if kinds.is_unsigned_integer(column.type) else pd.Int64Dtype()
            return column.to_pandas(types_mapper={column.type: whole}.get).array
        return column.to_pandas().to_numpy()


def text_categories(
    column: pa.Array, name: str, where: str, first: int = 1, blank: bool = False
) -> pd.Categorical:
    """Labels without spaces around them, from text or bytes that should be text; ``first`` numbers the first row."""
    coded = column if kinds.is_dictionary(column.type) else column.dictionary_encode()
    count = len(coded.dictionary)
    indices = coded.indices.cast(pa.int64()).fill_null(count).to_numpy()
    used = np.flatnonzero(np.bincount(indices))  # words of other rows are not looked at
    codes = np.searchsorted(used, indices)
    words = []
    contents = coded.dictionary.take(pa.array(used, mask=used == count)).cast(pa.large_binary())
    for i, content in enumerate(contents.to_pylist()):
        try:
            text = (content or b"").decode()
            word = text.strip()
            if not unicodedata.is_normalized("NFC", word):
                word = unicodedata.normalize("NFC", word)
                warn(
                    f"{where.partition(',')[0]}: {name} {word} is spelt in parts (NFD) and read as {word} (NFC)"
                )
            wrong = (
                "" if blank and not word else label_defect(text if {"\n", "\r"} & {*text} else word)
            )
        except UnicodeDecodeError:
            wrong = "is not text in UTF-8; save it as text"
        if wrong:
            raise InputError(
                f"{where} {first + int(np.argmax(codes == i))}: {one_line(name, 60)} {wrong}"
            )
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
            raise InputError(
                f"{label}: {one_line(name, 60)} is not a column of numbers; correct it"
            )
        if not (_is_text(kind) or kinds.is_primitive(kind) or kinds.is_decimal(kind)):
            raise InputError(
                f"{label}: {one_line(name, 60)} holds {one_line(kind, 40)}; give one text or number per frame"
            )


class PandasTable(Table):
    """A table in memory, which messages call ``label``."""

    def __init__(self, table: pd.DataFrame, label: str, row: str = "row") -> None:
        self.columns, self.header_prefix, self.row_prefix = [*table], label, f"{label}, {row}"
        try:
            self._rows = pa.Table.from_pandas(table, preserve_index=False).combine_chunks()
        except (pa.ArrowException, TypeError, ValueError) as e:
            raise InputError(
                f"{label}: a column holds mixed or unknown values ({one_line(e)}); correct it"
            ) from e

    def read_batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """The whole table."""
        _check_types(self._rows.schema, self.columns, {*channels, "frame"}, self.header_prefix)
        yield from (batch for batch in self._rows.to_batches() if len(batch))

    def label_columns(self) -> pd.DataFrame:
        """All columns."""
        columns = zip(self.columns, self._rows.columns, strict=True)
        return pd.DataFrame({name: self._joined(column, name, False) for name, column in columns})


class ParquetTable(Table):
    """A parquet file, whose sizes and types are looked at before anything is unpacked.

    An index that pandas stored is none of its columns.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.header_prefix, self.row_prefix = (
            path,
            file_name(path),
            f"{file_name(path)}, row",
        )
        with self._readable():
            with pq.ParquetFile(path) as file:
                metadata, schema = file.metadata, file.schema_arrow
            leaves = [metadata.schema.column(i) for i in range(metadata.num_columns)]
            row = sum(_WIDTHS.get(leaf.physical_type, max(8, leaf.length)) for leaf in leaves)
            groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
            needed = max(
                sum(group.num_rows for group in groups) * row,
                sum(group.total_byte_size for group in groups),
            )
            index = (schema.pandas_metadata or {}).get("index_columns", [])  # a range is no column
        check_unpacked_size(needed, path, "save it as CSV")
        self._schema = pa.schema([field for field in schema if field.name not in index])
        self.columns = [name.strip() for name in self._schema.names]
        check_column_names(self.columns, self.header_prefix)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except InputError:
            raise
        except (
            Exception
        ) as e:  # pyarrow and the text within a file raise a dozen types for damaged bytes
            raise InputError(
                f"{self.header_prefix}: not a readable parquet file ({one_line(e)}); save it again"
            ) from e

    def read_rows(self, channels: list[str], full_scale: float, blank: str = "") -> Self:
        """All rows, as of any table."""
        with self._readable():
            return super().read_rows(channels, full_scale, blank)

    def read_batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Rows as they are unpacked."""
        _check_types(self._schema, self.columns, {*channels, "frame"}, self.header_prefix)
        text = [field.name for field in self._schema if _is_text(field.type)]
        with pq.ParquetFile(
            self.path, read_dictionary=text, page_checksum_verification=True
        ) as file:
            rows = file.iter_batches(
                max(1, AT_ONCE // len(self.columns)), columns=self._schema.names
            )
            yield from (batch for batch in rows if len(batch))


class CsvTable(Table):
    """A CSV file: text in UTF-8, a header, as many cells in every line, and blank lines only at the end.

    Cells are separated by the one of `SEPARATORS` that the header has most often.

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
        self.label, self.header_prefix, self.row_prefix = (
            label,
            f"{label}, line 1",
            f"{label}, line",
        )
        self.counts, self.kinds = (
            counts,
            (pa.int64(), pa.uint16()) if whole else (pa.float64(), pa.float64()),
        )
        content = _content(source, label)
        line, _, _ = bytes(content[:MOST_LINE]).partition(b"\n")
        self._rows = content[len(line) + 1 :]
        self.separator = max(SEPARATORS, key=lambda sign: line.count(sign.encode()))
        try:
            text = line.decode("utf-8-sig").rstrip("\r")
            cells = next(csv.reader([text], delimiter=self.separator, skipinitialspace=True), [])
        except (UnicodeDecodeError, csv.Error) as e:
            raise InputError(
                f"{self.header_prefix}: not the header of a CSV file in UTF-8 ({one_line(e)}); give the CSV file itself"
            ) from e
        self.columns = [name.strip().strip('"').strip() for name in cells]
        if not any(self.columns):
            raise InputError(f"{self.header_prefix}: empty; begin the file with its header")
        check_column_names(self.columns, self.header_prefix)

    def read_batches(self, channels: list[str]) -> Iterator[pa.RecordBatch]:
        """Rows of a block of lines at a time."""
        sensors, (count, value) = {*channels}, self.kinds
        types = {
            n: value if n in sensors else count if n in self.counts else _WORDS
            for n in self.columns
        }
        line = self.first
        if not self._rows:
            return
        try:
            for batch in pacsv.open_csv(
                pa.BufferReader(self._rows),
                read_options=pacsv.ReadOptions(
                    column_names=self.columns, block_size=BLOCK, use_threads=False
                ),
                parse_options=pacsv.ParseOptions(
                    delimiter=self.separator, ignore_empty_lines=False
                ),
                convert_options=pacsv.ConvertOptions(column_types=types, null_values=[]),
            ):
                yield batch
                line += len(batch)
        except pa.ArrowInvalid as e:
            self._explain(str(e), line)

    def _explain(self, error: str, line: int) -> NoReturn:
        """Say what is wrong, from the message of Arrow, which has read until a line."""
        line = (
            int(match[1]) + self.first - 1 if (match := re.search(r"Row #(\d+): ", error)) else line
        )
        if match := re.search(r"Expected (\d+) columns, got (\d+)", error):
            reason = (
                f"{match[2]} fields instead of {match[1]}; the file is cut off or damaged here, get it again or "
                "delete the line"
            )
        elif match := re.search(
            r"column #(\d+): .*error to (\w+): (?:invalid value '(.*)')?", error, re.DOTALL
        ):
            wrong = (
                f"is {quote_text(match[3])}, not {_KINDS[match[2]]}"
                if match[3] is not None
                else "is not text in UTF-8"
            )
            reason = f"{shorten(self.columns[int(match[1])])} {wrong}; correct the cell"
        else:
            reason = "cannot be read as CSV; check quotes and line ends"
        raise InputError(f"{self.row_prefix} {line}: {reason}")


def _content(source: Path | bytes, label: str) -> memoryview:
    """A file, mapped, without blanks at its end."""
    content: bytes | mmap.mmap = source if isinstance(source, bytes) else b""
    if not isinstance(source, bytes):
        check_file(source)
        try:
            with open(source, "rb") as file:
                if source.stat().st_size:
                    content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except OSError as e:
            raise InputError(f"{label}: cannot be read ({e.strerror}); check the path") from e
    end = len(content)
    while end:
        begin = max(0, end - BLOCK)
        kept = len(content[begin:end].rstrip(b" \t\r\n"))
        end = begin + kept
        if kept:
            break
    if content[content.rfind(b"\n", 0, end) + 1 : end].count(b'"') % 2:  # which Arrow would close
        raise InputError(
            f"{label}: a quote is open in the last line; close it, or get the file again"
        )
    return memoryview(content)[:end]
