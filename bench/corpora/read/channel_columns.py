"""The channel columns of a table, and their order."""

from __future__ import annotations

import re

from bench.corpora.read.limits import listed, short
from bench.errors import InputError

OURS = "ch"  # what saved systems call their channels: ch1, ch2, ...


def channels_of(columns: list[str], grid: tuple[int, int], where: str) -> list[str]:
    """The columns of the channels, row by row.

    Channels whose names differ in one number at the end (ch1, ch2, ... or cell0, cell1, ...) are taken in the order of
    that number. The numbers begin with 0 or 1 and have no gap. Channels with other names are the last columns, in file
    order.

    Args:
        columns: names of all columns, each once.
        grid: (rows, cols) of the sensor.
        where: beginning of a message.

    Raises:
        InputError: a numbered channel is missing or extra.
    """
    count = grid[0] * grid[1]
    stem = _stem(columns, count)
    if stem is None:
        return columns[-count:]
    numbered = [(number, name) for s, number, name in map(_parts, columns) if s == stem and number is not None]
    first = 0 if any(number == 0 for number, _ in numbered) else 1
    by_number: dict[int, str] = {}
    extra = []
    for number, name in numbered:
        if number in by_number or not first <= number < first + count:
            extra.append(name)
        else:
            by_number[number] = name
    missing = [f"{stem}{number}" for number in range(first, first + count) if number not in by_number]
    wrong = [f"{what}: {listed(names)}" for what, names in (("missing", missing), ("extra", extra)) if names]
    if wrong:
        raise InputError(
            f"{where}: a grid of {grid[0]}x{grid[1]} has {count} channels, {short(stem)}{first} to "
            f"{short(stem)}{first + count - 1}; {', '.join(wrong)}; correct the columns or the grid"
        )
    return [by_number[number] for number in sorted(by_number)]


def _stem(columns: list[str], count: int) -> str | None:
    """The text before the numbers of the channels, None where the channels are not numbered."""
    stems = [stem for stem, number, _ in map(_parts, columns) if number is not None]
    if OURS in stems:
        return OURS
    before = {stem for stem, number, _ in map(_parts, columns[:-count]) if number is not None}
    last = [(stem, number) for stem, number, _ in map(_parts, columns[-count:])]
    if count > 1 and all(number is not None for _, number in last) and len({stem for stem, _ in last}) == 1:
        return last[0][0]
    return next((stem for stem, number in last if number is not None and stem in before), None)


def _parts(name: str) -> tuple[str, int | None, str]:
    """Text and number of a name such as ch12, and the name."""
    match = re.fullmatch(r"(.*?)([0-9]{1,9})", name, re.DOTALL)
    return (match[1], int(match[2]), name) if match else (name, None, name)
