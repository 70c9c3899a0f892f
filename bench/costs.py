"""The costs of a system, and amounts with units."""

from __future__ import annotations

from bench.errors import InputError

COSTS = {"flash": "kB", "ram": "kB", "predict": "ms", "decision": "ms", "cycles": "k"}  # of a system, and the unit
ROBUST = {"fault_loss": "points", "worst_fault": "points", "worst_person": "%", "worst_tenth": "%"}  # and the unit
BUDGETS = {f"max_{name}": name for name in COSTS | ROBUST}
WATCHED = {"false_alarms": "per hour", "latency": "ms"}  # of a system that watched recordings, and the unit
WATCH_BUDGETS = {f"max_{name}": name for name in WATCHED}
UNITS = {  # of a unit of a cost, and of the clock, what a typed unit is
    "k": {"k": 1, "M": 1e3},
    "kB": {"B": 1e-3, "kB": 1, "KiB": 1.024, "MB": 1e3, "MiB": 1048.576},
    "ms": {"ms": 1, "s": 1e3},
    "MHz": {"kHz": 1e-3, "MHz": 1, "GHz": 1e3},
}


def quantity(key: str, given: object, prefix: str = "") -> float:
    """A number with a unit, in milliseconds, kilobytes (1000 bytes; KiB are 1024), thousands or MHz, or in points.

    Args:
        key: one of `BUDGETS`, ``max_latency``, ``clock``, or another name, for a number without unit.
        given: typed value; losses and errors may be 0.
        prefix: prefix of the key, if it was typed with one.

    Raises:
        InputError: it is none, or not above 0.
    """
    text = str(given)
    number = text.rstrip("BkKiMmsGHz ")
    units = {"": 1.0}
    kinds = {"clock": "MHz", "max_latency": "ms"} | {f"max_{cost}": unit for cost, unit in COSTS.items()}
    if key in kinds:
        units = UNITS[kinds[key]]
    try:
        value = float(number) * units[text[len(number) :].strip()]
        least_is_fine = value == 0 and key.removeprefix("max_") in ROBUST
        if not (0 < value < float("inf") or least_is_fine):
            raise ValueError(text)
    except (ValueError, KeyError) as e:
        words = f" and {' or '.join(units)}" if "" not in units else ""
        raise InputError(f"{prefix}{key}={text}: give a number above 0{words}") from e
    return value
