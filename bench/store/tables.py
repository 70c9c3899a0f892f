"""Tables of runs as parquet: one writer and one reader, so that types survive.

Each file has a digest, which is checked before it is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import pandas as pd

from bench.errors import InputError
from bench.ground.digests import check_parquet, write_parquet_with_digest

# Tables that are stored as CSV too: MLflow's page shows no parquet
CSV_TABLES = ("confusion", "per_class", "chosen", "trials")
HOW_TO_RESTORE = (
    "restore it, or delete the run in bench ui and run it again"  # what to do without a table
)


def table_file(name: str) -> str:
    """File name of a table of a run."""
    return f"{name}.parquet"


def write_table(table: pd.DataFrame, path: Path | BinaryIO) -> None:
    """Write a table as parquet."""
    as_stored(table).to_parquet(buffer := BytesIO(), index=False)
    if not isinstance(path, Path):
        write_parquet_with_digest(buffer.getbuffer(), path)
        return
    with path.open("wb") as file:
        write_parquet_with_digest(buffer.getbuffer(), file)


def read_table(
    file: Path | BinaryIO, name: str, run: str = "this run", columns: Sequence[str] = ()
) -> Any:
    """Read a table of a run as a DataFrame, or some ``columns``, faster, as an Arrow table.

    Raises:
        InputError: the file is damaged; the message names the table and the run.
    """
    try:
        from pyarrow import BufferReader, parquet

        content = file.read_bytes() if isinstance(file, Path) else file.read()
        check_parquet(content)
        reader = BufferReader(content)
        with parquet.ParquetFile(reader, pre_buffer=False) as opened:  # pandas takes twice as long
            if columns:
                return opened.read([*columns], use_threads=False)
            table = opened.read(use_threads=False, use_pandas_metadata=True)
            return table.to_pandas(use_threads=False)
    except Exception as e:  # pandas and pyarrow raise a dozen types for damaged files
        place = (
            f"{file} is damaged; {HOW_TO_RESTORE}" if isinstance(file, Path) else "it is damaged"
        )
        raise InputError(f"{name} of {run} cannot be read, {place}") from e


def as_stored(table: pd.DataFrame) -> pd.DataFrame:
    """Make a table as parquet stores it: columns of numbers or text, each name once.

    A table in memory that went through this equals the one that is read again.
    """
    has_plain_names = table.columns.is_unique and table.columns.name is None
    has_plain_names = has_plain_names and all(isinstance(name, str) for name in table)
    if has_plain_names and object not in table.dtypes.tolist():
        return table
    names: list[str] = []
    for name in map(str, table):
        candidates = (name, *(f"{name}.{i}" for i in range(1, 2 + len(names))))
        names.append(next(candidate for candidate in candidates if candidate not in names))
    columns = {name: as_one_type(table.iloc[:, i]) for i, name in enumerate(names)}
    return pd.DataFrame(columns, index=table.index)


def as_one_type(column: pd.Series) -> pd.Series:
    """Convert a column to numbers if it holds nothing else, or to text; missing values stay."""
    if column.dtype != object:
        return column
    known = column[column.notna()]
    kind = known.infer_objects().dtype.kind
    # Whole numbers with gaps become text: 8 and not 8.0.
    if kind == "f" or (kind in "biu" and len(known) == len(column)):
        return column.infer_objects()
    values = zip(column, column.isna(), strict=True)
    return pd.Series([None if is_missing else str(v) for v, is_missing in values], column.index)
