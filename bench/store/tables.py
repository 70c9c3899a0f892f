"""The tables that are stored with a run as parquet: one writer and one reader, so that types survive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import pandas as pd

from bench.errors import InputError

CSV_TABLES = (
    "confusion",
    "per_class",
    "chosen",
    "trials",
)  # as CSV, too: MLflow's page shows no parquet
HOW_TO_RESTORE = (
    "restore it, or delete the run in bench ui and run it again"  # what to do without a table
)


def table_file(name: str) -> str:
    """The file of a table of a run."""
    return f"{name}.parquet"


def write_table(table: pd.DataFrame, path: Path | BinaryIO) -> None:
    """Write a table as parquet."""
    as_stored(table).to_parquet(path, index=False)


def read_table(
    file: Path | BinaryIO, name: str, of: str = "this run", columns: Sequence[str] = ()
) -> Any:
    """A stored table of a run as a DataFrame; only some ``columns`` as an Arrow table, which is five times as fast."""
    try:
        from pyarrow import parquet

        with parquet.ParquetFile(file, pre_buffer=False) as opened:  # pandas takes twice as long
            if columns:
                return opened.read([*columns], use_threads=False)
            return opened.read(use_threads=False, use_pandas_metadata=True).to_pandas(
                use_threads=False
            )
    except Exception as e:  # pandas and pyarrow raise a dozen types for damaged files
        raise InputError(
            f"{name} of {of} cannot be read, {file} is damaged; {HOW_TO_RESTORE}"
        ) from e


def as_stored(table: pd.DataFrame) -> pd.DataFrame:
    """The same as parquet can hold it: numbers or text in each column, each name once.

    What is in memory and what is stored are the same if both went through this.
    """
    plain = (
        all(isinstance(name, str) for name in table)
        and table.columns.is_unique
        and table.columns.name is None
    )
    if plain and object not in table.dtypes.tolist():
        return table
    names: list[str] = []
    for name in map(str, table):
        names.append(
            next(
                n
                for n in (name, *(f"{name}.{i}" for i in range(1, 2 + len(names))))
                if n not in names
            )
        )
    return pd.DataFrame(
        {name: as_one_type(table.iloc[:, i]) for i, name in enumerate(names)}, index=table.index
    )


def as_one_type(column: pd.Series) -> pd.Series:
    """The same as numbers, or as text where it holds anything else; what is missing stays so."""
    if column.dtype != object:
        return column
    known = column[column.notna()]
    kind = known.infer_objects().dtype.kind
    if kind == "f" or (
        kind in "biu" and len(known) == len(column)
    ):  # whole numbers with gaps: text, 8 and not 8.0
        return column.infer_objects()
    missing = column.isna()
    return pd.Series(
        [None if gone else str(v) for v, gone in zip(column, missing, strict=True)], column.index
    )
