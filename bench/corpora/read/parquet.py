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

from bench.corpora.read.frame_rows import check_types, is_text, labels_and_values
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
        header: name of the file, for messages.

    Raises:
        InputError: it cannot be read, or unpacks to far more than its size.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.header = path, called(path)
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

    def read(self, channels: list[str], full_scale: float, blank: str = "") -> tuple[pd.DataFrame, np.ndarray]:
        """Labels and sensor values of every row.

        Args:
            channels: columns of sensor values.
            full_scale: largest value allowed.
            blank: column of text whose cells may be empty.

        Returns:
            Labels [rows] in file order, text as categories, and values [rows, channels], uint16 when every value is a
            whole number up to 65535, else float32.

        Raises:
            InputError: a column or a value that does not fit; the message names the column or the row.
        """
        check_conditions(len(self.columns) - len(channels), self.header)
        check_types(self._schema, self.columns, {*channels, "frame"}, self.header)
        text = [field.name for field in self._schema if is_text(field.type)]
        # Of text each word once, so that a long one that is repeated is not multiplied.
        with (
            self._readable(),
            pq.ParquetFile(self.path, read_dictionary=text, page_checksum_verification=True) as file,
        ):
            batches = file.iter_batches(max(1, _AT_ONCE // len(self.columns)), columns=self._schema.names)
            rows = (batch for batch in batches if len(batch))
            return labels_and_values(rows, self.columns, channels, full_scale, f"{self.header}, row", 1, blank)
