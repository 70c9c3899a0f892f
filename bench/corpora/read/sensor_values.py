"""Sensor values: which are taken, and the smallest type that holds them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.corpora.read.limits import plain
from bench.errors import InputError

EXACT = 1 << 24  # float32 holds every whole number up to here
LARGEST = 65535  # of uint16
_AT_ONCE = 1 << 20  # values that are looked at in one step


def highest_of(full_scale: float) -> float:
    """The largest value that is taken: the full scale, as float32 has it if that is above it."""
    return max(full_scale, float(np.float32(full_scale)))


def smallest(values: np.ndarray) -> np.dtype:
    """uint16 when all values, which are within 0 and the full scale, are whole and fit, else float32."""
    integers = values.dtype.kind in "iu" or bool((values == np.floor(values)).all())
    return np.dtype(np.uint16 if integers and float(values.max()) <= LARGEST else np.float32)


def checked(values: np.ndarray, full_scale: float, name: str, unit: str) -> np.ndarray:
    """Values [rows, ...] as they are stored; messages name the file and a ``unit``, the word for a row."""
    flat = values.reshape(len(values), -1)
    step = max(1, _AT_ONCE // flat.shape[1])
    for at in range(0, len(flat), step):
        check(flat[at : at + step], full_scale, f"{name}, {unit}", at + 1)
    return values.astype(smallest(values))


def check(values: np.ndarray, full_scale: float, where: str, first: int = 1, names: Sequence[str] = ()) -> None:
    """Refuse values [rows, columns] outside 0 to the full scale, and whole numbers that float32 would change.

    In messages ``where`` is the file and the word for a row, ``first`` the number of the first one; columns without
    names are channels from 1.
    """
    wrong = ~((values >= 0) & (values <= np.float64(highest_of(full_scale))))  # a NaN is neither
    large = (values > np.float64(EXACT)) & ~wrong
    wrong[large] = [value == int(value) and float(np.float32(value)) != value for value in values[large].tolist()]
    if wrong.any():
        i, j = np.argwhere(wrong)[0]
        value = values[i, j]
        why = f"not within 0 and the full scale {full_scale:g}; correct it or give full_scale="
        if 0 <= value <= highest_of(full_scale):
            why = f"a whole number that float32 cannot hold; give values up to {EXACT}, or decimals"
        name = plain(names[j], 60) if names else f"channel {j + 1}"
        raise InputError(f"{where} {first + i}: {name} is {str(value).removesuffix('.0')}, {why}")
