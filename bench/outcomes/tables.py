"""The tables that are stored with a run: one writer and one reader, so that types survive.

What is read back is parquet. CSV has the tables that people look at on MLflow's page, which shows no parquet; they are
not read back. Runs of earlier versions stored other tables as CSV, too; the reader keeps their text text.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd

FOR_PEOPLE = ("confusion", "per_class", "chosen", "trials")  # written as CSV
TEXT = (
    "subject",
    "gesture",
    "label",
    "first",
    "fold",
    "true",
    "predicted",
)  # columns that are text, whatever they hold


def file_of(name: str) -> str:
    """The file of a table of a run."""
    return f"{name}.{'csv' if name in FOR_PEOPLE else 'parquet'}"


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV or parquet, as the name of the file implies."""
    table.to_csv(path, index=False) if path.suffix == ".csv" else _uniform(table).to_parquet(path, index=False)


def read_table(find: Callable[[str], Path | None], name: str) -> pd.DataFrame | None:
    """A stored table, None where there is none of its name.

    Args:
        find: path of a file by its name, None where there is none.
        name: name of the table.
    """
    if path := find(f"{name}.parquet"):
        table = pd.read_parquet(path)
    elif path := find(f"{name}.csv"):
        table = pd.read_csv(path, converters=dict.fromkeys(TEXT, str), float_precision="round_trip")
    else:
        return None
    return table.astype({"subject": str}) if "subject" in table else table


def _uniform(table: pd.DataFrame) -> pd.DataFrame:
    """The same with text where a column holds values of several types, which parquet has not."""
    mixed = [str(n) for n in table if table[n].dtype == object and table[n].dropna().map(type).nunique() > 1]
    return table.assign(**{n: table[n].map(lambda v: v if pd.isna(v) else str(v)) for n in mixed}) if mixed else table
