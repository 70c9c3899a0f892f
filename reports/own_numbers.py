"""Published numbers of the user's, from a file, beside those of the papers."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bench.corpora.read.limits import check_columns, check_file
from bench.errors import InputError, one_line, suggest_names
from bench.reports.comparison import VARIANTS, load_published

REQUIRED = ["system", "data", "protocol", "accuracy", "reference"]
OPTIONAL = {"where": "all", "target": "gesture", "unit": "subject mean", "sd": ""}
UNITS = sorted({unit for *_, units in VARIANTS.values() for unit in units})
OWN_NUMBER = "own number"  # confidence of the numbers of the file


def load_numbers(path: Path | None) -> pd.DataFrame:
    """The numbers of the papers, and those of a CSV file of the user's, marked as own.

    Its columns are `REQUIRED` and any of `OPTIONAL`: ``system`` as tables name it, ``where`` and
    ``target`` as `bench run` takes them, ``accuracy`` and ``sd`` in percent.

    Raises:
        InputError: it is no such file, or a value cannot be right.
    """
    if path is None:
        return load_published()
    check_file(path)
    place = f"published={path.name}"
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except ValueError as e:
        raise InputError(f"{place}: no CSV file in UTF-8 ({one_line(e)}); save it again") from e
    check_columns([*map(str, table)], REQUIRED, place)
    table = table.assign(**{k: v for k, v in OPTIONAL.items() if k not in table})
    rows = []
    for line, row in enumerate(table[[*REQUIRED, *OPTIONAL]].to_dict("records"), 2):
        values = {name: text.strip() for name, text in row.items()}
        values |= {name: values[name] or usual for name, usual in OPTIONAL.items()}
        rows.append(_read_row(values, f"{place}, line {line}", line - 1))
    return pd.concat([load_published(), pd.DataFrame(rows)], ignore_index=True)


def _read_row(values: dict[str, str], place: str, number: int) -> dict[str, object]:
    """A row of the user's file as one of `load_published`."""
    percent = {}
    for name in ("accuracy", "sd"):
        share = pd.to_numeric(values[name] or "nan", errors="coerce")
        if (values[name] and not 0 <= share <= 100) or not values["accuracy"]:
            raise InputError(
                f"{place}: {name} is {values[name]!r}; give percent, such as 71.2, without the sign"
            )
        percent[name] = float(share)
    if missing := [name for name in REQUIRED if not values[name]]:
        raise InputError(f"{place}: {missing[0]} is empty; fill it in")
    if values["unit"] not in UNITS:
        raise InputError(
            f"{place}: unit {values['unit']!r}: {suggest_names(values['unit'], UNITS)}"
        )
    keys = {"subset": "where", "target": "target", "protocol": "protocol", "unit": "unit"}
    words = {name: values[key] for name, key in keys.items()}
    return {
        "id": f"{OWN_NUMBER} {number}: {values['reference']}",
        "reference": f"{values['reference']} ({OWN_NUMBER})",
        "data": values["data"],
        **words,
        **{f"{name}_key": word for name, word in words.items()},
        "system": values["system"],
        "classifier": values["system"],
        "confidence": OWN_NUMBER,
        "nearest_key": "",
        **percent,
    }
