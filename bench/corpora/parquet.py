"""Parquet files of touch frames, one frame per row: sizes and types are looked at before anything is unpacked."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pyarrow.types as kinds

from bench.corpora.labels import Words, words_of
from bench.corpora.limits import allowance, called, check_conditions, check_names, check_unpacked, plain
from bench.corpora.pages import unpacked
from bench.corpora.values import check, smallest
from bench.errors import InputError

_AT_ONCE = 1 << 22  # values that are unpacked in one step
_WIDTHS = {"BOOLEAN": 1, "INT32": 4, "FLOAT": 4, "INT96": 12, "BYTE_ARRAY": 32}  # bytes of a value in memory


class ParquetFile:
    """A parquet file with one frame per row.

    Args:
        path: the file.

    Attributes:
        columns: names without spaces around them; an index that pandas stored is none of them.

    Raises:
        InputError: it cannot be read, or unpacks to far more than its size.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.label = path, called(path)
        with self._readable():
            with pq.ParquetFile(path) as file:
                metadata, schema = file.metadata, file.schema_arrow
            leaves = [metadata.schema.column(i) for i in range(metadata.num_columns)]
            row = sum(_WIDTHS.get(leaf.physical_type, max(8, leaf.length)) for leaf in leaves)
            needed = max(metadata.num_rows * row, unpacked(path, metadata, allowance(path)))
            index = _index_columns(schema)
        check_unpacked(needed, path, "save it as CSV")
        self._rows = metadata.num_rows
        self._fields = [(i, field) for i, field in enumerate(schema) if field.name not in index]
        self.columns = [field.name.strip() for _, field in self._fields]
        check_names(self.columns, self.label)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except InputError:
            raise
        except Exception as e:  # pyarrow and the text within a file raise a dozen types for damaged bytes
            raise InputError(f"{self.label}: not a readable parquet file ({plain(e)}); save it again") from e

    def require(self, names: list[str]) -> None:
        """Raise an `InputError` that names the columns that are missing."""
        if missing := [n for n in names if n not in self.columns]:
            raise InputError(f"{self.label}: no column {', '.join(missing)}; add it")

    def read(self, channels: list[str], full_scale: float) -> tuple[pd.DataFrame, np.ndarray]:
        """Labels and sensor values of every row.

        Args:
            channels: columns of sensor values.
            full_scale: largest value allowed.

        Returns:
            Labels [rows] in file order, text as categories, and values [rows, channels] as they are stored.

        Raises:
            InputError: a column or a value that does not fit; the message names the column or the row.
        """
        check_conditions(len(self._fields) - len(channels), self.label)
        by_name = dict(zip(self.columns, self._fields, strict=True))
        sensors = [by_name.pop(name) for name in channels]
        about = list(by_name.values())
        for _, field in about:
            _check_label_type(field, self.label)
        for _, field in [*(f for f in about if f[1].name.strip() == "frame"), *sensors]:
            if not (kinds.is_integer(field.type) or kinds.is_floating(field.type)):
                raise InputError(
                    f"{self.label}: {plain(field.name.strip(), 60)} is not a column of numbers; correct it"
                )
        words = {field.name: Words() for _, field in about if _is_text(field.type)}
        others: dict[str, list[pa.Array]] = {field.name: [] for _, field in about if field.name not in words}
        values, row = [], 0
        for batch in self._batches(list(words), max(1, _AT_ONCE // len(self._fields))):
            for i, field in about:
                if field.name in words:
                    with self._readable():
                        found = words_of(batch.column(i), field.name.strip(), f"{self.label}, row", row)
                    words[field.name].add(*found)
                else:
                    others[field.name].append(batch.column(i))
            block = np.empty((len(batch), len(channels)))
            for j, (i, _) in enumerate(sensors):
                with self._readable():
                    column = batch.column(i).to_numpy(zero_copy_only=False)  # what is missing becomes NaN
                check(column[:, None], full_scale, self.label, "row", row, j)
                block[:, j] = column
            values.append(block.astype(smallest(block)))
            row += len(batch)
        if row != self._rows or not row:
            what = "there are no frames in it" if not row else f"{row} rows instead of {self._rows}; save it again"
            raise InputError(f"{self.label}: {what}")
        labels = {}
        for _, field in about:
            with self._readable():
                name = field.name
                plainly = words[name].column() if name in words else pa.chunked_array(others[name]).to_pandas()
                labels[name.strip()] = plainly
        return pd.DataFrame(labels), np.concatenate(values)

    def _batches(self, text: list[str], rows: int) -> Iterator[pa.RecordBatch]:
        """The file in parts; of text each word once, so that a long one that is repeated is not multiplied."""
        with self._readable():
            file = pq.ParquetFile(self.path, read_dictionary=text, page_checksum_verification=True)
        with file:
            batches = file.iter_batches(batch_size=rows)
            while True:
                with self._readable():
                    batch = next(batches, None)
                if batch is None:
                    return
                if len(batch):
                    yield batch


def _index_columns(schema: pa.Schema) -> set[str]:
    """Columns in which pandas stored the index of a table."""
    about = json.loads((schema.metadata or {}).get(b"pandas", b"{}"))
    return {name for name in about.get("index_columns", []) if isinstance(name, str)}


def _is_text(kind: pa.DataType) -> bool:
    if kinds.is_dictionary(kind):
        kind = kind.value_type
    return any(
        test(kind)
        for test in (
            kinds.is_string,
            kinds.is_large_string,
            kinds.is_binary,
            kinds.is_large_binary,
            kinds.is_fixed_size_binary,
        )
    )


def _check_label_type(field: pa.Field, label: str) -> None:
    kind = field.type.value_type if kinds.is_dictionary(field.type) else field.type
    name = plain(field.name.strip(), 60)
    if kinds.is_nested(kind):
        raise InputError(f"{label}: {name} holds lists or arrays; give one value per frame")
    if not (_is_text(kind) or kinds.is_primitive(kind) or kinds.is_decimal(kind)):
        raise InputError(f"{label}: {name} is of type {plain(kind, 40)}; save it as text or numbers")
