"""Memory: what is there, and what asks for more than that."""

from __future__ import annotations

import os
from pathlib import Path

from bench.errors import InputError


def available() -> float:
    """Bytes that this process may still ask for; infinite where the system does not say."""
    found = [float("inf")]
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        found += [1024 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    except (OSError, ValueError, IndexError):  # another system than Linux
        pass
    if len(found) == 1 and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found.append(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    for name in ("memory.max", "memory/memory.limit_in_bytes"):  # of a container
        try:
            found.append(float(Path("/sys/fs/cgroup", name).read_text()))
        except (OSError, ValueError):
            continue
    return min(found)


def ensure(asked: str, needed: float) -> None:
    """Refuse what needs more memory than there is, before any is asked for.

    Args:
        asked: what the user typed.
        needed: bytes, at the least.

    Raises:
        InputError: there are fewer.
    """
    if needed > (there := available()):
        raise InputError(f"{asked}: needs at least {_size(needed)} of memory, {_size(there)} are free; ask for less")


def _size(number: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} TB" if number < 1e6 else f"{number:.1e} TB"
