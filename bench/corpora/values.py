"""Sensor values: which are taken, and the smallest type that holds them."""

from __future__ import annotations

import numpy as np

from bench.errors import InputError

EXACT = 1 << 24  # float32 holds every whole number up to here
LARGEST = 65535  # of uint16
_AT_ONCE = 1 << 20  # values that are looked at in one step


def highest_of(full_scale: float) -> float:
    """The largest value that is taken: the full scale, as float32 has it if that is above it."""
    return max(full_scale, float(np.float32(full_scale)))


def unfit(values: np.ndarray, highest: float) -> np.ndarray:
    """Where values are not within 0 and ``highest``, or are whole numbers that float32 would change."""
    if values.dtype == np.float16:  # which holds no number as large as EXACT
        values = values.astype(np.float32)
    wrong = ~((values >= 0) & (values <= np.float64(highest)))  # a NaN is neither
    large = (values > EXACT) & ~wrong
    if large.any():
        some = values[large]
        if some.dtype.kind == "f":
            wrong[large] = (some == np.floor(some)) & (some.astype(np.float32) != some)
        else:  # 24 bits from the highest to the lowest that is set
            bits = some.astype(np.uint64)
            wrong[large] = bits // (bits & (~bits + np.uint64(1))) >= EXACT
    return wrong


def smallest(values: np.ndarray) -> np.dtype:
    """uint16 when all values, which are within 0 and the full scale, are whole and fit, else float32."""
    whole = values.dtype.kind in "iu" or bool((values == np.floor(values)).all())
    return np.dtype(np.uint16 if whole and float(values.max()) <= LARGEST else np.float32)


def checked(values: np.ndarray, full_scale: float, name: str, unit: str) -> np.ndarray:
    """Values as they are stored.

    Args:
        values: numbers [rows, ...] of any type.
        full_scale: the largest value allowed.
        name: what messages call the file.
        unit: what they call a row.

    Raises:
        InputError: a value that is not within 0 and the full scale, or a whole number that float32 would change.
    """
    flat = values.reshape(len(values), -1)
    kinds = [np.dtype(np.uint16)]
    step = max(1, _AT_ONCE // flat.shape[1])
    for at in range(0, len(flat), step):
        block = flat[at : at + step]
        check(block, full_scale, name, unit, at)
        kinds.append(smallest(block))
    return values.astype(np.result_type(*kinds))


def check(values: np.ndarray, full_scale: float, name: str, unit: str, row: int = 0, column: int = 0) -> None:
    """Refuse values that are not within 0 and the full scale, and whole numbers that float32 would change.

    Args:
        values: numbers [rows, columns] of any type.
        full_scale: the largest value allowed.
        name: what messages call the file.
        unit: what they call a row.
        row: number of the first row in the file, from 0.
        column: the same of the first column.

    Raises:
        InputError: the first of these values.
    """
    wrong = unfit(values, highest_of(full_scale))
    if wrong.any():
        i, j = np.argwhere(wrong)[0]
        value = values[i, j]
        raise InputError(f"{name}, {unit} {row + i + 1}: channel {column + j + 1} is {value}{why(value, full_scale)}")


def why(value: float, full_scale: float) -> str:
    """The end of the message about an unfit value."""
    if 0 <= value <= highest_of(full_scale):
        return f", a whole number that float32 cannot hold; give values up to {EXACT}, or decimals"
    return f", not within 0 and the full scale {full_scale:g}; correct it or give full_scale="
