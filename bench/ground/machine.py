"""The machine: its processor and free memory, and where folds are done."""

from __future__ import annotations

import platform
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

from bench.errors import InputError

BUSY_SLOWDOWN = 1.3  # of the reference workload (`bench.ground.timing`), from which on a machine is busy


class Machine(NamedTuple):
    """Properties of a machine that times and rounding depend on."""

    cpu: str
    simd: str


@cache
def this_machine() -> Machine:
    """The one that runs this."""
    return Machine(cpu_model(), vector_instructions())


def cpu_model() -> str:
    """The processor as the system names it."""
    return _of_processor("model name") or platform.processor() or platform.machine()


def vector_instructions() -> str:
    """The processor's vector instructions: libraries choose by them, and so does the rounding; empty if unknown."""
    flags = _of_processor("flags", "Features").split()
    return " ".join(sorted(f for f in flags if f.startswith(("avx", "fma", "amx", "asimd", "sve"))))


def _of_processor(*names: str) -> str:
    """What Linux tells of the processor under one of some names; empty elsewhere."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(
            (line.partition(":")[2].strip() for line in lines if line.startswith(names)), ""
        )
    return ""


@dataclass(frozen=True)
class Backend:
    """The workers that do folds."""

    jobs: int | None = None  # processes of this machine, None for one per core
    workers: str = (
        ""  # class of other workers, ``module:object``; empty for processes of this machine
    )
    address: str = ""  # the place where they are found


LOCAL_BACKEND = Backend()


def available_memory() -> float:
    """Bytes available to this process: the machine's free memory, or the limit of its container."""
    import psutil

    limits = [float(psutil.virtual_memory().available)]
    for name in (
        "memory.max",
        "memory/memory.limit_in_bytes",
    ):  # of cgroups 2 and 1, which psutil does not read
        with suppress(OSError, ValueError):
            limits.append(float(Path("/sys/fs/cgroup", name).read_text()))
    return min(limits)


def check_memory(asked: str, needed: float) -> None:
    """Refuse a request, as it was typed, that needs more bytes of memory than are free."""
    if needed > (free := available_memory()):
        raise InputError(
            f"{asked}: needs at least {_size(needed)} of memory, {_size(free)} are free; ask for less"
        )


def _size(number: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} TB" if number < 1e6 else f"{number:.1e} TB"
