"""Exported C as it runs: asked on this machine, measured for a Cortex-M4."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.chip.write import CODE

PROGRAMS = ("cc", "make", "arm-none-eabi-gcc", "qemu-system-arm")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
LIMIT_S = 300  # of one program; QEMU takes seconds
SAID = (
    r"flash: (?P<code>\d+) bytes of code, (?P<tables>\d+) of tables",
    r"RAM: (?P<ram>\d+) bytes of state",
    r"library: (?P<flash>\d+) bytes of flash",
    r"instructions: (?P<mean>\d+) a frame .* and (?P<frame>\d+) with a window that ends; label at most (?P<label>\d+)",
)


def lacking() -> list[str]:
    """Programs that are needed and not installed."""
    return [name for name in PROGRAMS if shutil.which(name) is None]


def compiled(folder: Path, classes: int) -> Callable[[np.ndarray], np.ndarray]:
    """The C files of a folder as a function from a capture [frames, rows, cols] to probabilities [classes].

    Raises:
        ValueError: they do not compile; the function: the capture is refused.
    """
    (folder / "asked.c").write_text((CODE / "asked.c").read_text(encoding="utf-8"), encoding="utf-8")
    _said(["cc", *FLAGS, "asked.c", "-lm", "-o", "asked.so"], folder)
    run = ctypes.CDLL(str(folder / "asked.so")).asked
    floats = ctypes.POINTER(ctypes.c_float)

    def asked(frames: np.ndarray) -> np.ndarray:
        given = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
        proba = np.zeros(classes, np.float32)
        code = run(given.ctypes.data_as(floats), len(given), proba.ctypes.data_as(floats))
        if code < 0:
            raise ValueError(f"the program refuses a capture of {len(frames)} frames with code {code}")
        return proba

    return asked


def measured(folder: Path) -> dict[str, float]:
    """Bytes and instructions of the C files of a folder on a Cortex-M4F.

    Returns:
        ``chip_flash_bytes``: code, tables, and what both need of the C library, linked; ``chip_code_bytes`` and
        ``chip_table_bytes`` of it are the program's own. ``chip_ram_bytes``: the state of a capture.
        ``chip_frame_instructions``: of a frame, mean; ``chip_most_instructions``: of the costliest frame and a label of
        it, as QEMU counts them (a generated capture of 8 s).

    Raises:
        ValueError: they do not compile, or do not fit into 256 KiB and 32 KiB, or QEMU does not end.
    """
    text = _said(["make", "-s", "flash", "chip", "count"], folder)
    found: dict[str, float] = {}
    for pattern in SAID:
        if not (match := re.search(pattern, text)):
            raise ValueError(f"make flash count said nothing of {pattern.partition(':')[0]}: {text[-300:]}")
        found |= {name: float(value) for name, value in match.groupdict().items()}
    return {
        "chip_flash_bytes": found["flash"],
        "chip_code_bytes": found["code"],
        "chip_table_bytes": found["tables"],
        "chip_ram_bytes": found["ram"],
        "chip_frame_instructions": found["mean"],
        "chip_most_instructions": found["frame"] + found["label"],
    }


def _said(call: list[str], folder: Path) -> str:
    """What a program prints.

    Raises:
        ValueError: it fails or does not end.
    """
    try:
        done = subprocess.run(call, cwd=folder, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired as e:
        raise ValueError(f"{call[0]} did not end within {LIMIT_S} s") from e
    if done.returncode:
        raise ValueError(f"{' '.join(call)}: {(done.stderr or done.stdout).strip()[-300:]}")
    return done.stdout
