"""What a cell, a label, a number and a capture are in every format that is imported: the ground of a second reader."""

import math
import re
import struct
from collections import Counter
from fractions import Fraction

INTEGER = re.compile(r"-?[0-9]+")
HEXADECIMAL = re.compile("0[xX][0-9a-fA-F]{1,4}")  # which pyarrow reads
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff\ud800-\udfff]")
MOST_LABEL, MOST_CONDITIONS = 200, 256


class Invalid(Exception):
    """The file cannot be right."""


class Content:
    """What a file holds.

    Attributes:
        rows: sensor values of each frame, row 0 of the grid first.
        lengths: frames of each capture.
        columns: of the table of captures.
        grid: rows and columns.
    """

    def __init__(self, rows: list, lengths: list, columns: dict, grid: tuple) -> None:
        self.rows, self.lengths, self.columns, self.grid = rows, lengths, columns, grid


def need(condition: object, why: str) -> None:
    if not condition:
        raise Invalid(why)


def single(value: float) -> float:
    """The nearest number that four bytes hold."""
    try:
        return struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.inf


def label(cell: str) -> str:
    word = cell.strip()
    need(word, "an empty label")
    need(len(word) <= MOST_LABEL, "a label of more than 200 characters")
    need(not UNSEEN.search(word), "a label with characters that cannot be seen")
    return word


def column_names(names: list) -> list:
    names = [str(name).strip() for name in names]
    for name in names:
        label(name)
    need(max(Counter(names).values()) == 1, "a column twice")
    return names


def integer(cell: str) -> int:
    digits = cell.strip(" \t")
    if HEXADECIMAL.fullmatch(digits):
        return int(digits, 16)
    need(INTEGER.fullmatch(digits), "not a whole number")
    sign = -1 if digits.startswith("-") else 1
    digits = digits.lstrip("-").lstrip("0") or "0"
    need(len(digits) < 20 and -(2**63) <= sign * int(digits) < 2**63, "too large a number")
    return sign * int(digits)


def sensor(value: float, highest: float) -> float:
    need(0 <= value <= highest, "a value beyond the full scale")  # not a number is neither
    if value > 2**24 and value == int(value):
        need(Fraction(single(value)) == Fraction(value), "a whole number that four bytes do not hold")
    return value


def decimal(cell: str, highest: float) -> float:
    text = cell.strip(" \t")
    need(NUMBER.fullmatch(text), "not a number")
    return sensor(float(text), highest)


def captures(rows: list, names: list, origin: int) -> list:
    """Where captures begin: at frame ``origin``; a capture keeps its labels and counts its frames."""
    starts = []
    for i, row in enumerate(rows):
        if row["frame"] == origin:
            starts.append(i)
        else:
            need(i and row["frame"] == rows[i - 1]["frame"] + 1, "a frame is missing")
            need(all(row[n] == rows[i - 1][n] for n in names), "another label within a capture")
    return starts


def lengths_of(starts: list, total: int) -> list:
    return [b - a for a, b in zip(starts, [*starts[1:], total], strict=True)]


def layout(header: list, channels: int) -> tuple:
    """Places of the labels by name, and places of the channels, row by row."""
    places = numbered(header, channels) or list(range(len(header)))[-channels:]
    taken = set(places)
    names = {name: i for i, name in enumerate(header) if i not in taken}
    need(len(names) + channels == len(header), "too few columns")
    for name in ("subject", "gesture", "frame"):
        need(name in names, f"no {name} beside the channels")
    return names, places


def numbered(header: list, channels: int) -> list:
    """Places of channels that have numbers, in the order of the numbers; nothing where they have none."""
    groups: dict = {}
    for i, name in enumerate(header):
        digits = len(name) - len(name.rstrip("0123456789"))
        digits = min(digits, 9)
        if digits:
            groups.setdefault(name[:-digits], []).append((int(name[-digits:]), i))
    end = len(header) - channels
    inside = {stem: [i for _, i in group if i >= end] for stem, group in groups.items()}
    whole = [stem for stem, places in inside.items() if len(places) == channels > 1]
    split = [stem for stem, places in inside.items() if places and len(places) < len(groups[stem])]
    stems = [s for s in groups if s == "ch"] or whole or sorted(split, key=lambda stem: inside[stem][0])
    if not stems:
        return []
    group = sorted(groups[stems[0]])
    first = min(1, group[0][0])
    need([n for n, _ in group] == list(range(first, first + channels)), "channels that are missing or extra")
    return [i for _, i in group]


def long_table(rows: list, values: list, grid: tuple) -> Content:
    need(rows, "no frames")
    origin = rows[0]["frame"]
    need(origin in (0, 1), "the first frame")
    names = [n for n in rows[0] if n != "frame"]
    starts = captures(rows, names, origin)
    return Content(values, lengths_of(starts, len(rows)), {n: [rows[i][n] for i in starts] for n in names}, grid)
