"""CSV files that people open, in a spreadsheet too: no name in them becomes a formula."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from pandas.api.types import is_numeric_dtype

FORMULA = ("=", "+", "-", "@", "\t", "\r")  # what a spreadsheet takes for one, at the start of a cell


def write_sheet(table: pd.DataFrame, path: Path, float_format: str | None = None) -> None:
    """Write a table for people; a text or a heading that would start a formula is led by an apostrophe.

    Numbers stay as they are. What programs read back (artifacts of runs, features, exported corpora) is not written
    here, as there the apostrophe would be wrong.
    """
    text = table.apply(lambda column: column if is_numeric_dtype(column) else column.map(_harmless))
    text.rename(columns=_harmless).to_csv(path, index=False, float_format=float_format)


def _harmless(value: object) -> object:
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) and not _numeric(value) else value


def _numeric(text: str) -> bool:
    """A number typed as text, such as -1.5, calculates nothing; a dash alone stands for nothing in our tables."""
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True
