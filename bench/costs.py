"""What a system may cost, and amounts as they are typed."""

from __future__ import annotations

from bench.errors import InputError

COSTS = {"flash": "kB", "ram": "kB", "predict": "ms", "decision": "ms", "cycles": "k"}  # of a system, and the unit
BUDGETS = {f"max_{name}": name for name in COSTS}
UNITS = {"": 1, "B": 1e-3, "kB": 1, "KiB": 1.024, "MB": 1e3, "MiB": 1048.576, "ms": 1, "s": 1e3, "k": 1, "M": 1e3}


def quantity(key: str, given: object, prefix: str = "") -> float:
    """A number with a unit, in milliseconds, kilobytes (1000 bytes; KiB are 1024) or thousands, or a margin in points.

    Args:
        key: one of `BUDGETS`, or another name, for a number without unit.
        given: as it was typed.
        prefix: of the key, where it was typed with one.

    Raises:
        InputError: it is none, or not above 0.
    """
    text = str(given)
    number = text.rstrip("BkKiMms ")
    unit = text[len(number) :].strip()
    known = {"kB": ["B", "kB", "KiB", "MB", "MiB"], "ms": ["ms", "s"], "k": ["k", "M"]}
    allowed = known[COSTS[BUDGETS[key]]] if key in BUDGETS else []
    try:
        value = float(number)
        if not 0 < value < float("inf") or (unit not in allowed and allowed) or (unit and not allowed):
            raise ValueError(text)
    except ValueError as e:
        raise InputError(
            f"{prefix}{key}={text}: give a number above 0" + (f" and {' or '.join(allowed)}" if allowed else "")
        ) from e
    return value * UNITS[unit]
