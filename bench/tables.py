"""The tables that are stored with a run: one writer and one reader, so that types survive.

All are parquet, which is what is read back. Some are beside it as CSV, too, for people who look at MLflow's page, which
shows no parquet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import pandas as pd

from bench.errors import InputError

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile

FOR_PEOPLE = ("confusion", "per_class", "chosen", "trials")  # as CSV, too
AGAIN = "restore it, or delete the run in bench ui and run it again"  # what to do without a table


def file_of(name: str) -> str:
    """The file of a table of a run."""
    return f"{name}.parquet"


def write_table(table: pd.DataFrame, path: Path | BinaryIO) -> None:
    """Write a table as parquet."""
    uniform(table).to_parquet(path, index=False)


def read_table(file: Path | BinaryIO, name: str, of: str = "this run") -> pd.DataFrame:
    """A stored table of a run; an `InputError` where the file is damaged."""
    with _opened(file, name, of) as opened:
        return opened.read(use_threads=False, use_pandas_metadata=True).to_pandas(use_threads=False)


def read_columns(file: Path, name: str, columns: Sequence[str], of: str) -> list[np.ndarray]:
    """Some columns of a stored table, as `read_table` has them; making a DataFrame of them takes five times as long."""
    with _opened(file, name, of) as opened:
        table = opened.read([*columns], use_threads=False)
        return [table.column(each).to_numpy() for each in columns]


@contextmanager
def _opened(file: Path | BinaryIO, name: str, of: str) -> Iterator[ParquetFile]:
    """The file of a table; an `InputError` where it is damaged."""
    try:
        from pyarrow import parquet

        with parquet.ParquetFile(file) as opened:  # pandas takes twice as long
            yield opened
    except Exception as e:  # pandas and pyarrow raise a dozen types for damaged files
        raise InputError(f"{name} of {of} cannot be read, {file} is damaged; {AGAIN}") from e


def uniform(table: pd.DataFrame) -> pd.DataFrame:
    """The same as parquet can hold it: numbers or text in each column, each name once.

    What is in memory and what is stored are the same if both went through this.
    """
    names: list[str] = []
    for name in map(str, table):
        names.append(next(n for n in (name, *(f"{name}.{i}" for i in range(1, 2 + len(names)))) if n not in names))
    return pd.DataFrame({name: _uniform(table.iloc[:, i]) for i, name in enumerate(names)}, index=table.index)


def _uniform(column: pd.Series) -> pd.Series:
    """The same as numbers, or as text where it holds anything else; what is missing stays so."""
    if column.dtype != object:
        return column
    known = column[column.notna()]
    kind = known.infer_objects().dtype.kind
    if kind == "f" or (kind in "biu" and len(known) == len(column)):  # whole numbers with gaps: text, 8 and not 8.0
        return column.infer_objects()
    missing = column.isna()
    return pd.Series([None if gone else str(v) for v, gone in zip(column, missing, strict=True)], column.index)
