"""The cells of a CSV line: what they may be, and which one of a damaged file to point at."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from decimal import Decimal
from typing import NoReturn

import numpy as np

from bench.corpora.limits import flaw, quoted, short
from bench.corpora.lines import Lines
from bench.corpora.values import EXACT, highest_of, unfit, why
from bench.errors import InputError

SPACES = " \t"  # around numbers
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_INTEGER = re.compile("-?[0-9]+")


@dataclass
class Wanted:
    """What is read of each line.

    Attributes:
        whole: columns of whole numbers.
        channels: columns of sensor values.
        full_scale: the largest sensor value.
        fractions: whether sensor values may have decimals.
    """

    whole: list[str]
    channels: list[str]
    full_scale: float
    fractions: bool

    def __post_init__(self) -> None:
        self.highest = highest_of(self.full_scale)


def cells_of(line: str, header: bool = False) -> list[str]:
    """The cells of one line; the last one ends with a line feed if a quote is open.

    Only quotes need the csv module, which takes no cell above 128 KiB. In a header spaces may stand before quotes.
    """
    if '"' in line:
        try:
            return next(csv.reader([line + "\n"], skipinitialspace=header))
        except csv.Error:
            pass
    return line.split(",") if line else []


def is_written(cell: str, value: float) -> bool:
    """Whether a number is exactly what the cell says."""
    return Decimal(cell.strip(SPACES)) == Decimal(float(value))


def explain(lines: Lines, columns: list[str], wanted: Wanted, label: str) -> NoReturn:
    """Say what is wrong with the first line that does not fit.

    Raises:
        InputError: always; the message names the line and the column.
    """
    place = {name: i for i, name in enumerate(columns)}
    numbers = {*wanted.whole, *wanted.channels}
    whole = [(place[n], n) for n in wanted.whole]
    channels = [(place[n], n) for n in wanted.channels]
    labels = [(i, n) for n, i in place.items() if n not in numbers]
    for line, raw in enumerate(lines.content.removesuffix(b"\n").split(b"\n"), start=lines.first):
        where = f"{label}, line {line}"
        try:
            cells = cells_of(raw.decode())
        except UnicodeDecodeError as e:
            raise InputError(f"{where}: not text in UTF-8; get the file again") from e
        if not cells:
            raise InputError(f"{where}: 0 fields instead of {len(columns)}, the line is blank; delete it")
        if len(cells) != len(columns):
            raise InputError(
                f"{where}: {len(cells)} fields instead of {len(columns)}; the file is cut off or damaged here, get it "
                "again or delete the line"
            )
        for i, name in whole:
            if not _is_int64(cells[i].strip(SPACES)):
                what = f"is {quoted(cells[i])}, not a whole number; correct the cell"
                raise InputError(f"{where}: {short(name)} {what}")
        for i, name in channels:
            if wrong := _value_flaw(cells[i].strip(SPACES), wanted):
                raise InputError(f"{where}: {short(name)} {wrong}")
        for i, name in labels:
            if wrong := flaw(cells[i].strip()):
                raise InputError(f"{where}: {short(name)} {wrong}")
        if cells[-1].endswith("\n"):
            raise InputError(f"{where}: the quote of the last cell is not closed; a cell holds no line break")
    raise InputError(f"{label}, line {lines.first} or after: cannot be read as CSV; check quotes and line ends")


def _is_int64(cell: str) -> bool:
    digits = cell.removeprefix("-").lstrip("0") or "0"
    return bool(_INTEGER.fullmatch(cell)) and len(digits) < 20 and int(digits) < 2**63 + cell.startswith("-")


def _value_flaw(cell: str, wanted: Wanted) -> str:
    """What is wrong with a sensor value, as the end of a message, or nothing."""
    shape, kind = (_NUMBER, "a number") if wanted.fractions else (_INTEGER, "a whole number")
    if not shape.fullmatch(cell):
        return f"is {quoted(cell)}, not {kind}; correct the cell"
    value = float(cell)
    if value < 0 or (cell.startswith("-") and not wanted.fractions):
        return f"is {short(cell, 40)}, below 0; correct the cell"
    if value > wanted.highest:
        return f"is {short(cell, 40)}, above the full scale {wanted.full_scale:g}; correct it or give full_scale="
    if value > EXACT and (unfit(np.array([value]), wanted.highest).any() or not is_written(cell, value)):
        return f"is {short(cell, 40)}{why(value, wanted.full_scale)}"
    return ""
