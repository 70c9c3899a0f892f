"""Limits on unchecked files and sensor values, and quotation of contents in messages: one line of bounded length."""

from __future__ import annotations

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
MOST_TIMES = 100  # what a packed file may unpack to, in its own size; sensor values seldom reach 20
ALWAYS = 16 << 20  # bytes that every packed file may unpack to
EXACT = 1 << 24  # float32 holds every whole number up to here
LARGEST = 65535  # of uint16
_AT_ONCE = 1 << 20  # values that are looked at in one step

# Characters that end a line, move a cursor, cannot be written as UTF-8 or show nothing: two labels that look the same
# would be two gestures. Joiners (U+200C, U+200D) show nothing beside ASCII and at the ends; Persian words need them.
_UNSEEN = re.compile(
    "[\x00-\x1f\x7f-\x9f\xad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f"
    "\u2800\u3164\ufeff\uffa0\ud800-\udfff\U000e0000-\U000e007f]"
    "|(?<![^\x00-\x7f])[\u200c\u200d]|[\u200c\u200d](?![^\x00-\x7f])|^[\ufe00-\ufe0f]"
)


def quote_text(text: str, most: int = 40) -> str:
    """The text between quotes, with every character visible."""
    return shorten(repr(shorten(text, 4 * most)), most)


def file_name(path: Path) -> str:
    """The name of a file in messages."""
    return one_line(path.name or str(path), 60)


def first_names(names: list[str]) -> str:
    """The first three names and the number of the others."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(shorten(name, 30) for name in names[:3]) + more


def label_defect(word: str) -> str:
    """The defect of a label, as the end of a message, or nothing."""
    if not word:
        return "is empty; fill it"
    if len(word) > MOST_LABEL:
        return f"is {quote_text(word)}, longer than {MOST_LABEL} characters; shorten it"
    if _UNSEEN.search(word):
        return f"is {quote_text(word)}, with characters that cannot be seen; correct it"
    return ""


def check_column_names(names: list[str], where: str) -> None:
    """Refuse column names that are missing, unreadable or doubled; the message begins with ``where``."""
    for i, name in enumerate(names, start=1):
        if wrong := label_defect(name):
            raise InputError(f"{where}: the name of column {i} {wrong}")
    if twice := [name for name, times in Counter(names).items() if times > 1]:
        raise InputError(f"{where}: column {quote_text(min(twice))} stands twice; rename one")


def check_columns(columns: list[str], required: list[str], where: str) -> None:
    """Refuse a table without all required columns."""
    present = set(columns)
    if missing := [name for name in required if name not in present]:
        first = shorten(repr(", ".join(columns[:20])), 70)
        raise InputError(
            f"{where}: no column {first_names(missing)}; the columns begin with {first}"
        )


def deviations_from_published(
    captures: pd.DataFrame, published: dict, here: dict | None = None, part: str = ""
) -> list[str]:
    """A sentence on every figure that differs from the published one.

    Published are numbers, and numbers of captures by column and value; ``here`` has those that captures do not tell.
    """
    figures = {"captures": len(captures), "subjects": captures["subject"].nunique()} | (here or {})
    expected: dict[str, object] = {}
    for name, number in published.items():
        if isinstance(number, dict):
            counts = captures[name].value_counts()
            figures |= {f"captures of {name} {value}": counts.get(value, 0) for value in number}
            expected |= {f"captures of {name} {value}": count for value, count in number.items()}
        else:
            expected[name] = number
    return [
        f"{part}{k}: {figures[k]} here, {n} published"
        for k, n in expected.items()
        if figures[k] != n
    ]


def source_info(
    path: Path, source: str, licence: str, warnings: list[str], synthetic: bool = False
) -> dict[str, object]:
    """The ``info`` of a corpus that was read from a file."""
    name = one_line(path.name, 200) + source
    return {"source": name, "licence": licence, "synthetic": synthetic, "warnings": warnings}


def check_condition_count(count: int, where: str) -> None:
    """Refuse more columns than conditions can have: mostly a grid that is too small."""
    if count > MOST_CONDITIONS:
        raise InputError(
            f"{where}: {count} columns beside the channels, at most {MOST_CONDITIONS} are read; check grid= or delete "
            "some"
        )


def check_file(path: Path) -> None:
    """Refuse a path that is no plain file: a folder, a device, a pipe or nothing."""
    if not path.is_file():
        kind = (
            "a folder"
            if path.is_dir()
            else "not a plain file"
            if path.exists()
            else "there is no such file"
        )
        raise InputError(f"{one_line(path, 160)}: {kind}; give the path of a file")


def check_unpacked_size(unpacked: int, path: Path, instead: str) -> None:
    """Refuse a file whose bytes unpack to so much more than its own size that it cannot hold sensor values."""
    most = max(ALWAYS, MOST_TIMES * path.stat().st_size)
    if unpacked > most:
        raise InputError(
            f"{file_name(path)}: unpacks to {unpacked >> 20:.4g} MiB, a file of this size to at most {most >> 20} MiB; if "
            f"it is right, {instead}"
        )


def highest_value(full_scale: float) -> float:
    """The largest value that is taken: the full scale, as float32 has it if that is above it."""
    return max(full_scale, float(np.float32(full_scale)))


def smallest_dtype(values: np.ndarray) -> np.dtype:
    """uint16 when all values, which are within 0 and the full scale, are whole and fit, else float32."""
    integers = values.dtype.kind in "iu" or bool((values == np.floor(values)).all())
    return np.dtype(np.uint16 if integers and float(values.max()) <= LARGEST else np.float32)


def checked_values(values: np.ndarray, full_scale: float, name: str, unit: str) -> np.ndarray:
    """Values [rows, ...] as they are stored; messages name the file and a ``unit``, the word for a row."""
    flat = values.reshape(len(values), -1)
    step = max(1, _AT_ONCE // flat.shape[1])
    for at in range(0, len(flat), step):
        check_values(flat[at : at + step], full_scale, f"{name}, {unit}", at + 1)
    return values.astype(smallest_dtype(values))


def check_values(
    values: np.ndarray, full_scale: float, where: str, first: int = 1, names: Sequence[str] = ()
) -> None:
    """Refuse values [rows, columns] outside 0 to the full scale, and whole numbers that float32 would change.

    In messages ``where`` is the file and the word for a row, ``first`` the number of the first one; columns without
    names are channels from 1.
    """
    wrong = ~((values >= 0) & (values <= np.float64(highest_value(full_scale))))  # a NaN is neither
    large = (values > np.float64(EXACT)) & ~wrong
    some = values[large]
    with np.errstate(invalid="ignore", over="ignore"):  # the nearest float32 may be beyond the type
        wrong[large] = (some == np.floor(some)) & (
            some.astype(np.float32).astype(some.dtype) != some
        )
    if wrong.any():
        i, j = np.argwhere(wrong)[0]
        value = values[i, j]
        why = f"not within 0 and the full scale {full_scale:g}; correct it or give full_scale="
        if 0 <= value <= highest_value(full_scale):
            why = f"a whole number that float32 cannot hold; give values up to {EXACT}, or decimals"
        name = one_line(names[j], 60) if names else f"channel {j + 1}"
        raise InputError(f"{where} {first + i}: {name} is {str(value).removesuffix('.0')}, {why}")
