"""Memory: how much is free, and a refusal of anything that needs more."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import psutil

from bench.errors import InputError


def available() -> float:
    """Bytes available to this process: the machine's free memory, or the limit of its container."""
    limits = [float(psutil.virtual_memory().available)]
    for name in ("memory.max", "memory/memory.limit_in_bytes"):  # of cgroups 2 and 1, which psutil does not read
        with suppress(OSError, ValueError):
            limits.append(float(Path("/sys/fs/cgroup", name).read_text()))
    return min(limits)


def ensure(asked: str, needed: float) -> None:
    """Refuse a request that needs more memory than is free.

    Args:
        asked: typed request.
        needed: bytes, at the least.

    Raises:
        InputError: there are fewer.
    """
    if needed > (free := available()):
        raise InputError(f"{asked}: needs at least {_size(needed)} of memory, {_size(free)} are free; ask for less")


def _size(number: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} TB" if number < 1e6 else f"{number:.1e} TB"
