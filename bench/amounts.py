"""Typed values: amounts with units, and values of parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, overload

from bench.errors import InputError

UNITS = {  # typed units, by the unit in which an amount is kept
    "k": {"k": 1, "M": 1e3},
    "kB": {"B": 1e-3, "kB": 1, "KiB": 1.024, "MB": 1e3, "MiB": 1048.576},
    "ms": {"ms": 1, "s": 1e3},
    "MHz": {"kHz": 1e-3, "MHz": 1, "GHz": 1e3},
}
Usual = TypeVar("Usual")
LARGEST, LARGEST_SEED = 10**6, 2**32 - 1  # of a whole number, of a seed, which NumPy and scikit-learn bound
BOOLEANS = {"true": True, "yes": True, "false": False, "no": False}
READERS: dict[type, tuple[str, Callable[[str], object]]] = {
    bool: ("yes or no", lambda text: BOOLEANS[text.lower()]),
    int: ("a whole number", int),
    float: ("a number", float),
    tuple: ("names joined by +", lambda text: tuple(text.split("+"))),
    str: ("text", str),
}


def quantity(key: str, given: object, unit: str = "", zero: bool = False, prefix: str = "") -> float:
    """A typed amount above 0 in its unit: ms, kB (1000 bytes; KiB are 1024), thousands, MHz or a plain number."""
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


@overload
def convert(key: str, given: object, default: None) -> int | None: ...


@overload
def convert(key: str, given: object, default: Usual) -> Usual: ...


def convert(key: str, given: object, default: object) -> object:
    """Text as a value of the type of the default; a default of None takes None or a whole number.

    What is no text (an API call) is taken as it is, if it is of that type.
    """
    if isinstance(given, tuple) and not given and isinstance(default, tuple):
        return given
    text = given if isinstance(given, str) else text_of(given)
    if text == "None" and default is None:
        return None
    if text == "None" and isinstance(default, tuple):
        raise InputError(f"{key}=None: give a value such as {default!r}")
    usual, seed = 0 if default is None else default, key.endswith("seed")
    words, read = next((reader for kind, reader in READERS.items() if isinstance(usual, kind)), READERS[str])
    try:
        value = read(text)
        if seed and isinstance(value, int | float) and value < 0:
            raise ValueError(key)
    except (ValueError, KeyError) as e:
        words += " or None" if default is None else " from 0 on" if seed else ""
        example = "" if isinstance(usual, bool) else f", such as {2 if default in (None, 0) and not seed else default}"
        raise InputError(f"{key}={text[:60]}: give {words}{example}") from e
    most = LARGEST_SEED if seed else LARGEST
    if isinstance(value, int) and abs(value) > most:
        raise InputError(f"{key}={text[:60]}: give {most} at most")
    return value


def text_of(value: object) -> str:
    """A value as it is typed; `convert` reads it again."""
    if type(value).__name__ in ("bool", "bool_"):  # NumPy's own, too
        return str(value).lower()
    return "+".join(map(str, value)) if isinstance(value, tuple) else str(value)
