"""Amounts with units, as they are typed."""

from __future__ import annotations

from bench.errors import InputError

UNITS = {  # typed units, by the unit in which an amount is kept
    "k": {"k": 1, "M": 1e3},
    "kB": {"B": 1e-3, "kB": 1, "KiB": 1.024, "MB": 1e3, "MiB": 1048.576},
    "ms": {"ms": 1, "s": 1e3},
    "MHz": {"kHz": 1e-3, "MHz": 1, "GHz": 1e3},
}


def quantity(key: str, given: object, unit: str = "", zero: bool = False, prefix: str = "") -> float:
    """A typed amount in its unit: milliseconds, kilobytes (1000 bytes; KiB are 1024), thousands, MHz or a plain number.

    Args:
        key: key of the argument.
        given: typed value.
        unit: unit of the result; an amount of one that is not in `UNITS` is typed as a plain number.
        zero: True if 0 is an amount.
        prefix: prefix of the key, if it was typed with one.

    Raises:
        InputError: it is no such amount, or not above 0.
    """
    text = str(given)
    number = text.rstrip("BkKiMmsGHz ")
    units = UNITS.get(unit, {"": 1.0})
    try:
        value = float(number) * units[text[len(number) :].strip()]
        if not (0 < value < float("inf") or (zero and value == 0)):
            raise ValueError(text)
    except (ValueError, KeyError) as e:
        words = f" and {' or '.join(units)}" if "" not in units else ""
        raise InputError(f"{prefix}{key}={text}: give a number above 0{words}") from e
    return value
