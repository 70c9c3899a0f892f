"""Exported C in use: run on this machine, measured for a Cortex-M4."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from touchbench_chip.write import CODE

PROGRAMS = ("cc", "make", "arm-none-eabi-gcc", "qemu-system-arm")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
REASON = re.compile(
    r"too small|error:|undefined reference"
)  # among the lines of a linker, what is not what follows
LIMIT_S = 300  # of one program; QEMU takes seconds
ROOMY = (
    "FLASH=4M",
    "RAM=1M",
)  # of a chip on which everything is counted, whether or not yours has as much
PRINTED = (  # by make flash count chip
    r"flash: (?P<code_bytes>\d+) bytes of code, (?P<table_bytes>\d+) of tables",
    r"RAM of the library: (?P<ram_bytes>\d+) bytes of state",
    r"library: (?P<flash_bytes>\d+) bytes of flash",
    r"stack: (?P<stack_bytes>\d+) bytes",
    r"program: \d+ bytes of flash and (?P<program_ram_bytes>\d+) of RAM, and (?P<reserve>\d+) more",
    r"instructions: (?P<frame_instructions>\d+) a frame on average.*; a frame and its label at most "
    r"(?P<most_instructions>\d+)",
)
WATCHING = (  # besides, by make flash count of a system that watches a stream
    r"watching: (?P<watch_ram_bytes>\d+) bytes of state",
    r"watching, linked .*: (?P<watch_flash_bytes>\d+) bytes of flash",
    r"watching: (?P<watch_idle_instructions>\d+) instructions a frame on average without touch and "
    r"(?P<watch_frame_instructions>\d+) with, at most \d+ and (?P<watch_most_instructions>\d+)",
    r"watching: stack of (?P<watch_stack_bytes>\d+) bytes",
)
RECORDED = (  # besides, where it watches a recording
    r"watching a recording: (?P<watch_recorded_instructions>\d+) instructions a frame on average, "
    r"at most (?P<watch_recorded_most_instructions>\d+); (?P<watch_recorded_reports>\d+) reports",
)


def missing_programs() -> list[str]:
    """Programs that are needed and not installed."""
    return [name for name in PROGRAMS if shutil.which(name) is None]


def compile_labeller(folder: Path, classes: int) -> Callable[[np.ndarray], tuple[np.ndarray, bool]]:
    """The C files of a folder as a function from a capture [frames, rows, cols] to probabilities [classes].

    It also says whether the capture looks unlike all training captures.

    Both raise a ValueError: what does not compile, and a capture that is refused.
    """
    (folder / "asked.c").write_text(
        (CODE / "asked.c").read_text(encoding="utf-8"), encoding="utf-8"
    )
    _run_program(["cc", *FLAGS, "asked.c", "-lm", "-o", "asked.so"], folder)
    run = ctypes.CDLL(str(folder / "asked.so")).asked
    floats = ctypes.POINTER(ctypes.c_float)

    def label_capture(frames: np.ndarray) -> tuple[np.ndarray, bool]:
        values = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
        proba, unlike = np.zeros(classes, np.float32), ctypes.c_int()
        code = run(
            values.ctypes.data_as(floats),
            len(values),
            proba.ctypes.data_as(floats),
            ctypes.byref(unlike),
        )
        if code < 0:
            raise ValueError(
                f"the program refuses a capture of {len(frames)} frames with code {code}"
            )
        return proba, bool(unlike.value)

    return label_capture


def measure_footprint(folder: Path, *room: str) -> dict[str, float]:
    """Bytes and instructions of the C files of a folder on a Cortex-M4F of 256 KiB and 32 KiB, or of some ``room``.

    Returns:
        ``chip_flash_bytes``: code, tables, and what both need of the C library, linked; ``chip_code_bytes`` and
        ``chip_table_bytes`` of it are the library's own. ``chip_ram_bytes``: RAM of the library, without the program's
        own stack and buffers. ``chip_stack_bytes``: the most stack that a frame and a label take, below their caller,
        without interrupts. ``chip_program_ram_bytes``: RAM of the whole program that reads frames from standard input,
        with the C library and what the linker script reserves for heap and stack.
        ``chip_frame_instructions``: of a frame, mean; ``chip_most_instructions``: of the frame that costs most together
        with its label, as QEMU counts them (a generated capture of 8 s, a label every eighth frame and where a window
        ends).

    Raises:
        ValueError: they do not compile, or the program does not fit, or QEMU does not end.
    """
    numbers = _parse_make_output(["flash", "count", "chip", *room], PRINTED, folder)
    numbers["chip_program_ram_bytes"] += numbers.pop("chip_reserve")
    return numbers


def measure_watching(folder: Path, recording: np.ndarray | None = None) -> dict[str, float]:
    """Bytes and instructions of `touch_watch`, as of `measure_footprint`, of a system that watches an endless stream.

    ``chip_watch_ram_bytes`` has that of a capture, too; instructions are of a frame without and with touch (means), and
    of the costliest; also on a recording [frames, rows, cols], if there is one, with the number of reports.
    """
    if recording is not None:
        (folder / "recorded.bin").write_bytes(recording.astype("<f4").tobytes())
    patterns = WATCHING if recording is None else WATCHING + RECORDED
    return _parse_make_output(["flash", "count", *ROOMY], patterns, folder)


def _parse_make_output(
    targets: list[str], patterns: tuple[str, ...], folder: Path
) -> dict[str, float]:
    """Numbers that make prints, by the names of the groups of their patterns; a ValueError where one is missing."""
    text = _run_program(["make", "-s", *targets], folder)
    numbers: dict[str, float] = {}
    for pattern in patterns:
        if not (match := re.search(pattern, text)):
            raise ValueError(
                f"make {' '.join(targets)} printed nothing about {pattern.partition(':')[0]}: {text[-300:]}"
            )
        numbers |= {f"chip_{name}": float(value) for name, value in match.groupdict().items()}
    return numbers


def _run_program(call: list[str], folder: Path) -> str:
    """What a program prints; a ValueError if it fails or does not end."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(call, cwd=folder, start_new_session=True, **pipes) as process:
        try:
            output, errors = process.communicate(timeout=LIMIT_S)
        except BaseException as e:
            os.killpg(process.pid, signal.SIGKILL)  # make, and QEMU that it has started
            if isinstance(e, subprocess.TimeoutExpired):
                raise ValueError(f"{call[0]} did not end within {LIMIT_S} s") from e
            raise
    if process.returncode:
        lines = (errors or output).strip().splitlines() or [f"exit code {process.returncode}"]
        reason = next((line for line in lines if REASON.search(line)), lines[-1])
        raise ValueError(f"{' '.join(call)}: {reason.strip()[-300:]}")
    return output


@cache
def toolchain_versions() -> list[str]:
    """Versions of the programs that bytes, instructions and rounding depend on."""
    return [
        subprocess.run(
            [name, "--version"], capture_output=True, text=True, check=False
        ).stdout.partition("\n")[0]
        for name in PROGRAMS
        if shutil.which(name)
    ]
