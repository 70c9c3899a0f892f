"""The tables that are stored with a run: one writer and one reader, so that types survive.

All are parquet, which is what is read back. Some are beside it as CSV, too, for people who look at MLflow's page, which
shows no parquet. Runs of earlier versions stored these, and others, as CSV alone. Of these, `TEXT` lists the columns
that are text whatever they hold; any other column is text unless all of its cells are as pandas writes numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from bench.errors import InputError

FOR_PEOPLE = ("confusion", "per_class", "chosen", "trials")  # as CSV, too
LABELS = ("subject", "gesture", "label", "first", "fold", "true", "predicted")
WORDS = ("factor", "value", "kind", "slice", "fault", "amount", "where", "system", "data", "subset", "protocol")
TEXT = (*LABELS, *WORDS)  # columns of text, whatever they hold
CLASSES = {"confusion": ("true",)}  # tables whose other columns are called as classes are: their columns of text
AGAIN = "restore it, or delete the run in bench ui and run it again"  # what to do without a table
WHOLE = re.compile("-?(0|[1-9][0-9]*)")
NUMBER = re.compile("-?(0|[1-9][0-9]*|[0-9]+[.][0-9]+(e[+-][0-9]+)?|[0-9]e[+-][0-9]+|inf)")


def file_of(name: str) -> str:
    """The file of a table of a run."""
    return f"{name}.parquet"


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as parquet."""
    uniform(table).to_parquet(path, index=False)


def read_table(find: Callable[[str], Path | None], name: str, of: str = "this run") -> pd.DataFrame | None:
    """A stored table, None where there is none of its name.

    Args:
        find: path of a file by its name, None where there is none.
        name: name of the table.
        of: the run in words, for messages.

    Raises:
        InputError: the file is damaged.
    """
    text = CLASSES.get(name, TEXT)
    try:
        if path := find(f"{name}.parquet"):
            from pyarrow import parquet

            with parquet.ParquetFile(path) as file:  # pandas takes twice as long
                table = file.read(use_threads=False, use_pandas_metadata=True).to_pandas(use_threads=False)
        elif path := find(f"{name}.csv"):
            cells = pd.read_csv(path, dtype=str, keep_default_na=False)
            table = cells.apply(lambda column: column if column.name in text else _typed(column))
        else:
            return None
    except InputError:
        raise
    except Exception as e:  # pandas and pyarrow raise a dozen types for damaged files
        raise InputError(f"{name} of {of} cannot be read, {path} is damaged; {AGAIN}") from e
    if "subject" in table and "subject" in text and table["subject"].dtype != "str":
        return table.astype({"subject": str})
    return table


def _typed(cells: pd.Series) -> pd.Series:
    """A column of a CSV file in its type; an empty cell is missing."""
    known = cells[cells != ""]
    filled = 0 < len(known) == len(cells)
    if filled and known.isin(["True", "False"]).all():
        return cells == "True"
    if filled and known.map(WHOLE.fullmatch).notna().all():
        return cells.astype("int64")
    missing = cells.mask(cells == "")
    return missing.astype(float) if known.map(NUMBER.fullmatch).notna().all() else missing


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
