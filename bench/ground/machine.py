"""The machine: its processor and its free memory."""

from __future__ import annotations

import platform
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from bench.errors import InputError

# Slowdown of the reference workload (`bench.ground.timing`) from which a machine is busy
BUSY_SLOWDOWN = 1.3


class Machine(NamedTuple):
    """Properties of a machine that times and rounding depend on."""

    cpu: str
    simd: str


@cache
def this_machine() -> Machine:
    """The machine of this process."""
    return Machine(cpu_model(), vector_instructions())


@cache
def cpu_model() -> str:
    """Name of the processor."""
    return _read_cpuinfo("model name") or platform.processor() or platform.machine()


def vector_instructions() -> str:
    """Names of the processor's vector instructions, on which rounding depends; empty if unknown."""
    flags = _read_cpuinfo("flags", "Features").split()
    return " ".join(sorted(f for f in flags if f.startswith(("avx", "fma", "amx", "asimd", "sve"))))


def _read_cpuinfo(*names: str) -> str:
    """The first entry of Linux about the processor with one of these names; empty elsewhere."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith(names):
                return line.partition(":")[2].strip()
    return ""


def available_memory() -> float:
    """Bytes of memory that this process may use: free ones, or the limit of its container."""
    import psutil

    limits = [float(psutil.virtual_memory().available)]
    for name in ("memory.max", "memory/memory.limit_in_bytes"):  # of cgroups 2 and 1
        with suppress(OSError, ValueError):
            limits.append(float(Path("/sys/fs/cgroup", name).read_text()))
    return min(limits)


def check_memory(request: str, needed: float) -> None:
    """Refuse a request, as it was typed, if it needs more bytes of memory than are free."""
    if needed > (free := available_memory()):
        sizes = f"needs at least {_format_bytes(needed)} of memory, {_format_bytes(free)} are free"
        raise InputError(f"{request}: {sizes}; ask for less")


def _format_bytes(number: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} TB" if number < 1e6 else f"{number:.1e} TB"
