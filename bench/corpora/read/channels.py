"""Which columns of a table are the channels, and which taxel each of them is."""

from __future__ import annotations

import re

import numpy as np

from bench.corpora.read.limits import first_names
from bench.errors import InputError, shorten

CHANNEL = "ch"  # saved systems call their channels ch1, ch2, ...
TAG = r"(r(?:ow)?|c(?:ol(?:umn)?)?|x|y)"
TAGGED = re.compile(
    rf"(.*?){TAG}[\W_]*(\d{{1,9}})[\W_]*{TAG}[\W_]*(\d{{1,9}})\W*", re.DOTALL | re.I
)
UNTAGGED = re.compile(r"(.*?)(\d{1,9})(?:[\W_]+|x)(\d{1,9})\W*", re.DOTALL | re.I)
STATISTICS = set(
    "mean average avg sum total max maximum min minimum std sd var variance median rms range "
    "energy time timestamp counter".split()
)


def channel_columns(columns: list[str], grid: tuple[int, int], place: str) -> list[str]:
    """The columns of the channels, row by row.

    If most of the last columns name a row and a column (r0c0, row1_col2, p_0_11), channels are
    taken in this order. If they differ only in a number at the end of their names (ch1, ch2, ... or
    cell0, cell1, ...), channels are taken in the order of that number, from 0 or 1 without a gap.
    Else they are the last columns, in file order.

    Raises:
        InputError: the names say another grid, a number is missing, there are more than the grid
            has taxels, or one of the last columns is a statistic.
    """
    count = grid[0] * grid[1]
    last = {*columns[-count:]}
    numbers: dict[str, dict[str, int]] = {}  # of columns, by what is in front of their numbers
    for name in columns:
        if match := re.fullmatch(r"(.*?)([0-9]{1,9})", name, re.DOTALL):
            numbers.setdefault(match[1], {})[name] = int(match[2])
    if CHANNEL not in numbers and count > 1:
        for places in _places_by_stem(columns).values():
            if len(last & {*places}) / count > 0.5:
                return _order_by_place(places, grid, place)
    shares = {stem: len(last & {*names}) / count for stem, names in numbers.items()}
    stem = CHANNEL if CHANNEL in numbers else max(shares, key=shares.__getitem__, default="")
    if stem != CHANNEL and (count == 1 or shares.get(stem, 0) <= 0.5):
        for name in columns[-count:]:
            words = {*re.split(r"[\W_\d]+", name.lower())}
            if count > 1 and words & STATISTICS:
                raise InputError(
                    f"{place}: {shorten(name)} is one of the last {count} columns, which are read "
                    "as the channels; delete it, or rename it if it is a channel"
                )
        return columns[-count:]
    first = 0 if 0 in numbers[stem].values() else 1
    wanted = range(first, first + count)
    by_number = {n: name for name, n in reversed(numbers[stem].items()) if n in wanted}
    extra = [name for name, n in numbers[stem].items() if by_number.get(n) != name]
    missing = [f"{stem}{n}" for n in wanted if n not in by_number]
    if missing or extra:
        kinds = (("missing", missing), ("extra", extra))
        wrong = ", ".join(f"{kind}: {first_names(names)}" for kind, names in kinds if names)
        raise InputError(
            f"{place}: a grid of {grid[0]}x{grid[1]} has {count} channels, {shorten(stem)}{first} "
            f"to {shorten(stem)}{first + count - 1}; {wrong}; correct the columns or the grid"
        )
    return [by_number[n] for n in wanted]


def _places_by_stem(columns: list[str]) -> dict[tuple[str, str], dict[str, tuple[int, int]]]:
    """Row and column that names say, by the rest of the name; names without tags say both."""
    stems: dict[tuple[str, str], dict[str, tuple[int, int]]] = {}
    for name in columns:
        if match := TAGGED.fullmatch(name):
            stem, one, first, other, second = match.groups()
            is_row = [tag[0] in "ryRY" for tag in (one, other)]
            if is_row[0] != is_row[1]:
                numbers = (first, second) if is_row[0] else (second, first)
                stems.setdefault(("tagged", stem), {})[name] = int(numbers[0]), int(numbers[1])
        elif match := UNTAGGED.fullmatch(name):
            stems.setdefault(("", match[1]), {})[name] = int(match[2]), int(match[3])
    return {
        (tags, stem): places
        for (tags, stem), places in stems.items()
        if tags or np.ptp([*places.values()], axis=0).all()
    }


def _order_by_place(
    places: dict[str, tuple[int, int]], grid: tuple[int, int], place: str
) -> list[str]:
    """Names in row-major order; they must say every taxel of the grid once."""
    low, high = np.min([*places.values()], axis=0), np.max([*places.values()], axis=0)
    rows, cols = (high - low + 1).tolist()
    ordered = sorted(places, key=places.__getitem__)
    names = f"{place}: the channels {shorten(ordered[0])} to {shorten(ordered[-1])}"
    if (rows, cols) != grid:
        raise InputError(
            f"{names} say a grid of {rows}x{cols}, not {grid[0]}x{grid[1]}; "
            "correct the names or the grid"
        )
    by_place = {taxel: name for name, taxel in places.items()}
    for taxel in np.ndindex(*grid):
        row, col = (np.array(taxel) + low).tolist()
        if (row, col) not in by_place:
            raise InputError(f"{names} lack row {row}, column {col}; add it or correct the names")
    if len(by_place) < len(places):
        double = next(name for name in ordered if by_place[places[name]] != name)
        raise InputError(f"{names}: {shorten(double)} is a taxel that another column is, too")
    return ordered
