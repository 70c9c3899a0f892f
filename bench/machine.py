"""The machine that a run was made on."""

from __future__ import annotations

import platform
from functools import cache
from pathlib import Path
from typing import NamedTuple


class Machine(NamedTuple):
    """Properties of a machine that times and rounding depend on."""

    cpu: str
    simd: str


@cache
def this_machine() -> Machine:
    """The one that runs this."""
    return Machine(cpu_model(), simd())


def cpu_model() -> str:
    """The processor as the system names it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def simd() -> str:
    """The processor's vector instructions: libraries choose by them, and so does the rounding; empty if unknown."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        flags = next(line.split(":", 1)[1].split() for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        return ""
    return " ".join(sorted(f for f in flags if f.startswith(("avx", "fma", "amx", "asimd", "sve"))))
