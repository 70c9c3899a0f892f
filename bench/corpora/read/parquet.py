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

from bench.corpora.read.frame_rows import Rows, is_text
from bench.corpora.read.limits import called, check_conditions, check_names, check_unpacked, plain
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
            groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
            needed = max(
                sum(group.num_rows for group in groups) * row,
                sum(group.column(i).total_uncompressed_size for group in groups for i in range(len(leaves))),
            )
            index = _index_columns(schema)
        check_unpacked(needed, path, "save it as CSV")
        self._fields = [field for field in schema if field.name not in index]
        self.columns = [field.name.strip() for field in self._fields]
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
        check_conditions(len(self.columns) - len(channels), self.label)
        sensors = {*channels, "frame"}
        for name, field in zip(self.columns, self._fields, strict=True):
            _check_type(field.type, plain(name, 60), name in sensors, self.label)
        text = [field.name for field in self._fields if is_text(field.type)]
        rows = Rows(f"{self.label}, row", 1, channels, full_scale)
        at_once = max(1, _AT_ONCE // len(self.columns))
        # Of text each word once, so that a long one that is repeated is not multiplied.
        with (
            self._readable(),
            pq.ParquetFile(self.path, read_dictionary=text, page_checksum_verification=True) as file,
        ):
            for batch in file.iter_batches(at_once, columns=[field.name for field in self._fields]):
                if len(batch):
                    rows.add(self.columns, batch)
            return rows.result()


def _index_columns(schema: pa.Schema) -> set[str]:
    """Columns in which pandas stored the index of a table."""
    about = json.loads((schema.metadata or {}).get(b"pandas", b"{}"))
    return {name for name in about.get("index_columns", []) if isinstance(name, str)}


def _check_type(kind: pa.DataType, name: str, number: bool, label: str) -> None:
    kind = kind.value_type if kinds.is_dictionary(kind) and not number else kind
    if number and not (kinds.is_integer(kind) or kinds.is_floating(kind)):
        raise InputError(f"{label}: {name} is not a column of numbers; correct it")
    if kinds.is_nested(kind):
        raise InputError(f"{label}: {name} holds lists or arrays; give one value per frame")
    if not (is_text(kind) or kinds.is_primitive(kind) or kinds.is_decimal(kind)):
        raise InputError(f"{label}: {name} is of type {plain(kind, 40)}; save it as text or numbers")
