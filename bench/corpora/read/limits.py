"""Checks of untrusted files and sensor values, and quotation of their contents in messages."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bench.errors import InputError, one_line, shorten

SYNTHETIC = "synthetic"  # a column that marks generated captures
MOST_LABEL = 200  # characters
MOST_CONDITIONS = 256  # columns beside the channels
MOST_RATIO = 100  # of unpacked to packed size; sensor values seldom reach 20
ALWAYS_UNPACKED = 16 << 20  # bytes, whatever the ratio
EXACT = 1 << 24  # float32 holds every whole number up to here
LARGEST = 65535  # of uint16

# Characters that end a line, move a cursor, cannot be written as UTF-8 or show nothing: two labels
# that look the same would be two gestures. Joiners (U+200C, U+200D) show nothing beside ASCII and
# at the ends; Persian words need them.
_UNSEEN = re.compile(
    "[\x00-\x1f\x7f-\x9f\xad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b\u200e\u200f"
    "\u2028-\u202e\u2060-\u206f\u2800\u3164\ufeff\uffa0\ud800-\udfff\U000e0000-\U000e007f]"
    "|(?<![^\x00-\x7f])[\u200c\u200d]|[\u200c\u200d](?![^\x00-\x7f])|^[\ufe00-\ufe0f]"
)


def quote_text(text: str, most: int = 40) -> str:
    """The text in quotes, with every character visible, in at most ``most`` characters."""
    return shorten(repr(shorten(text, 4 * most)), most)


def file_name(path: Path) -> str:
    """The name of a file in messages."""
    return one_line(path.name or str(path), 60)


def first_names(names: list[str]) -> str:
    """The first three names, and how many more there are."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(shorten(name, 30) for name in names[:3]) + more


def label_defect(label: str) -> str:
    """The defect of a label, as the end of a message, or ``""``."""
    if not label:
        return "is empty; fill it"
    if len(label) > MOST_LABEL:
        return f"is {quote_text(label)}, longer than {MOST_LABEL} characters; shorten it"
    if _UNSEEN.search(label):
        return f"is {quote_text(label)}, with characters that cannot be seen; correct it"
    return ""


def check_column_names(names: list[str], place: str) -> None:
    """Refuse missing, unreadable or repeated column names; messages begin with ``place``."""
    for number, name in enumerate(names, start=1):
        if defect := label_defect(name):
            raise InputError(f"{place}: the name of column {number} {defect}")
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(f"{place}: two columns are called {quote_text(min(repeated))}; rename one")


def check_columns(columns: list[str], required: list[str], place: str) -> None:
    """Refuse a table without all required columns."""
    present = set(columns)
    if missing := [name for name in required if name not in present]:
        first = shorten(repr(", ".join(columns[:20])), 70)
        raise InputError(
            f"{place}: no column {first_names(missing)}; the columns begin with {first}"
        )


def check_condition_count(count: int, place: str) -> None:
    """Refuse more conditions than a table can have: the grid is probably too small."""
    if count > MOST_CONDITIONS:
        raise InputError(
            f"{place}: {count} columns beside the channels, at most {MOST_CONDITIONS} are read; "
            "check grid= or delete some"
        )


def deviations_from_published(
    captures: pd.DataFrame,
    published: dict[str, object],
    figures: dict[str, object] | None = None,
    part: str = "",
) -> list[str]:
    """A sentence for each figure that differs from the published one.

    Args:
        captures: table of the captures.
        published: numbers by name, and by column the number of captures of each value.
        figures: numbers of this copy that the table does not contain.
        part: part of the corpus, in front of each sentence.
    """
    found = {"captures": len(captures), "subjects": captures["subject"].nunique()}
    found |= figures or {}
    expected: dict[str, object] = {}
    for name, number in published.items():
        if isinstance(number, dict):
            counts = captures[name].value_counts()
            found |= {f"captures of {name} {value}": counts.get(value, 0) for value in number}
            expected |= {f"captures of {name} {value}": count for value, count in number.items()}
        else:
            expected[name] = number
    return [
        f"{part}{name}: {found[name]} here, {number} published"
        for name, number in expected.items()
        if found[name] != number
    ]


def source_info(
    path: Path, source: str, licence: str, warnings: list[str], synthetic: bool = False
) -> dict[str, object]:
    """The ``info`` of a corpus that was read from a file."""
    name = one_line(path.name, 200) + source
    return {"source": name, "licence": licence, "synthetic": synthetic, "warnings": warnings}


def check_file(path: Path) -> None:
    """Refuse a path that is no readable file: a folder, a device, a pipe, or nothing."""
    if path.is_file() and os.access(path, os.R_OK):
        return
    reason = "not a readable file" if path.exists() else "there is no such file"
    raise InputError(f"{one_line(path, 160)}: {reason}; give the path of a file")


def check_unpacked_size(unpacked: int, path: Path, advice: str) -> None:
    """Refuse a file that unpacks to so many bytes that it cannot hold sensor values."""
    most = max(ALWAYS_UNPACKED, MOST_RATIO * path.stat().st_size)
    if unpacked > most:
        raise InputError(
            f"{file_name(path)}: unpacks to {unpacked >> 20:.4g} MiB, a file of this size to at "
            f"most {most >> 20} MiB; if it is right, {advice}"
        )


def highest_value(full_scale: float) -> float:
    """The largest accepted value: the full scale, or its float32 if that is larger."""
    return max(full_scale, float(np.float32(full_scale)))


def smallest_dtype(values: np.ndarray) -> np.dtype:
    """uint16 if all values, which are not negative, are whole and fit, else float32."""
    is_whole = values.dtype.kind in "iu" or bool((values == np.floor(values)).all())
    return np.dtype(np.uint16 if is_whole and float(values.max()) <= LARGEST else np.float32)


def checked_values(values: np.ndarray, full_scale: float, name: str, unit: str) -> np.ndarray:
    """Values [rows, ...] as they are stored; messages begin with ``name, unit``."""
    check_values(values.reshape(len(values), -1), full_scale, f"{name}, {unit}")
    return values.astype(smallest_dtype(values))


def check_values(
    values: np.ndarray,
    full_scale: float,
    row_prefix: str,
    first: int = 1,
    names: Sequence[str] = (),
) -> None:
    """Refuse values outside 0 to the full scale, and whole numbers that float32 would change.

    Args:
        values: sensor values [rows, columns].
        full_scale: largest value that the sensor can give.
        row_prefix: beginning of messages, before the number of a row.
        first: number of the first row.
        names: names of the columns; without them they are channels from 1.
    """
    wrong = ~((values >= 0) & (values <= np.float64(highest_value(full_scale))))  # so is NaN
    large = (values > np.float64(EXACT)) & ~wrong
    whole = values[large]
    with np.errstate(invalid="ignore", over="ignore"):  # float32 may round beyond the type
        changed = whole.astype(np.float32).astype(whole.dtype) != whole
        wrong[large] = changed & (whole == np.floor(whole))
    if not wrong.any():
        return
    row, column = np.argwhere(wrong)[0]
    value = values[row, column]
    reason = f"not within 0 and the full scale {full_scale:g}; correct it or give full_scale="
    if large[row, column]:
        reason = f"a whole number that float32 cannot hold; give values up to {EXACT}, or decimals"
    name = one_line(names[column], 60) if names else f"channel {column + 1}"
    shown = str(value).removesuffix(".0")
    raise InputError(f"{row_prefix} {first + row}: {name} is {shown}, {reason}")
