"""Values that people give, as text between commas or as objects of Python, and commands as people type them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping

from bench.errors import InputError

PARTS = {"protocol": "protocols", "features": "features", "model": "models"}  # rooms of parts by key
WIDTH = 100  # columns of help
FAULTS = "dead_taxels stuck_taxels dead_lines gain_drift offset_drift saturation noise fewer_bits dropped_frames "
FAULTS += "lower_rate time_jitter late_start early_end shift rotation smaller_grid cover"  # faults, all of captures
LOSSY = "dropped_frames late_start early_end"  # of these, faults that remove frames
LATER = "vibration drift noisy_region"  # further faults
SMALL = "model=lda features=touch model.window=1.0 model.repair=stuck+dead"  # a small system, accurate on real touch
DEFAULTS = {  # of the keys of a run
    "data": "synth",
    "protocol": "loso",
    "model": "svm",
    "features": "jung54",
    "seed": "0",
    "where": "",
    "target": "gesture",
}
Values = Mapping[str, object]  # text; from Python also numbers, objects, and lists of these


def items(key: str, value: object) -> list:
    """The values between commas, or of a list."""
    if isinstance(value, str):
        if key == "where":  # a condition may hold commas
            return [value]
        values = value.split(",")
        if not all(values):
            raise InputError(f"{key}={value}: a value is missing beside a comma; add it or remove the comma")
        return values
    several = isinstance(value, list) or (isinstance(value, tuple) and "." not in key)  # a parameter may be a tuple
    if several and not value:
        raise InputError(f"{key}=[]: give at least one value")
    return [*value] if several else [value]  # type: ignore[misc]


def typed(command: str, arguments: Mapping[str, str]) -> str:
    """A command as it is typed."""
    return " ".join(["bench", command, *(f"{key}={quoted(value)}" for key, value in arguments.items())])


def labelled(key: str, label: str) -> dict[str, str]:
    """``personal[shots=3]``, as tables name a part, as it is typed."""
    name, _, rest = label.rstrip("]").partition("[")
    return {key: name} | {f"{key}.{k}": v for k, _, v in (part.partition("=") for part in rest.split(", ") if part)}


def quoted(value: str) -> str:
    """A value as a shell takes it: in double quotes where it has single ones, as conditions have."""
    double = "'" in value and not set('"$`\\!') & set(value)
    return f'"{value}"' if double else shlex.quote(value)
