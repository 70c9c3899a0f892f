"""Run exported C on this machine, and measure it for a Cortex-M4F."""

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

from touchbench_chip.write import CODE, PREFIX, rename_public

PROGRAMS = ("cc", "make", "arm-none-eabi-gcc", "qemu-system-arm")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
# An event of touch.h, and the news that it comes with.
EVENT = [("label", np.int32), ("confidence", np.float32), ("reported", np.uint32)]
NEWS = np.dtype([*EVENT, ("end", np.uint32), ("news", np.int32)])
REASON = re.compile(r"too small|error:|undefined reference")  # in the first useful line of a linker
LIMIT_S = 300  # of one program; QEMU takes seconds
ROOMY = ("FLASH=4M", "RAM=1M")  # of an emulated chip on which any system is counted
FOOTPRINT_PATTERNS = (  # in the output of make flash count chip
    r"flash: (?P<code_bytes>\d+) bytes of code, (?P<table_bytes>\d+) of tables",
    r"RAM of the library: (?P<ram_bytes>\d+) bytes of state",
    r"library: (?P<flash_bytes>\d+) bytes of flash",
    r"stack: (?P<stack_bytes>\d+) bytes",
    r"program: \d+ bytes of flash and (?P<program_ram_bytes>\d+) of RAM, "
    r"and (?P<reserve>\d+) more",
    r"instructions: (?P<frame_instructions>\d+) a frame on average.*; "
    r"a frame and its label at most (?P<most_instructions>\d+)",
)
WATCHING_PATTERNS = (  # in the output of make flash count, of a system that watches
    r"watching: (?P<watch_ram_bytes>\d+) bytes of state",
    r"watching, linked .*: (?P<watch_flash_bytes>\d+) bytes of flash",
    r"watching: (?P<watch_idle_instructions>\d+) instructions a frame on average without touch and "
    r"(?P<watch_frame_instructions>\d+) with, at most \d+ and (?P<watch_most_instructions>\d+)",
    r"watching: stack of (?P<watch_stack_bytes>\d+) bytes",
)
RECORDING_PATTERNS = (  # also, of a system that watches a recording
    r"watching a recording: (?P<watch_recorded_instructions>\d+) instructions a frame on average, "
    r"at most (?P<watch_recorded_most_instructions>\d+); (?P<watch_recorded_reports>\d+) reports",
)


def missing_programs() -> list[str]:
    """Names of required programs that are not installed."""
    return [name for name in PROGRAMS if shutil.which(name) is None]


def compile_labeller(
    folder: Path, classes: int, prefix: str = PREFIX
) -> Callable[[np.ndarray], tuple[np.ndarray, bool]]:
    """Compile the C files of a folder into a function that labels captures.

    Returns:
        A function from a capture [frames, rows, cols] to its probabilities [classes], and whether
        it looks unlike all training captures. It raises a ValueError for a capture that the C
        refuses.

    Raises:
        ValueError: the files do not compile.
    """
    run = _load_function("asked", "asked", folder, prefix)
    floats = ctypes.POINTER(ctypes.c_float)

    def label_capture(frames: np.ndarray) -> tuple[np.ndarray, bool]:
        values = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
        proba, unlike = np.zeros(classes, np.float32), ctypes.c_int()
        pointers = values.ctypes.data_as(floats), proba.ctypes.data_as(floats)
        code = run(pointers[0], len(values), pointers[1], ctypes.byref(unlike))
        if code < 0:
            raise ValueError(
                f"the program refuses a capture of {len(frames)} frames with code {code}"
            )
        return proba, bool(unlike.value)

    return label_capture


def compile_watcher(folder: Path, prefix: str = PREFIX) -> Callable[[np.ndarray], np.ndarray]:
    """Compile the C files of a folder into a function that watches a recording.

    Returns:
        A function from a recording [frames, rows, cols] to the `NEWS` of ``touch_watch``. It raises
        a ValueError for a recording with a frame that the C refuses.

    Raises:
        ValueError: the files do not compile.
    """
    run = _load_function("watched", "watch_recording", folder, prefix)

    def watch_recording(frames: np.ndarray) -> np.ndarray:
        values = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
        news = np.zeros(len(values) + 1, NEWS)
        pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (values, news))
        count = run(next(pointers), len(values), next(pointers))
        if count < 0:
            raise ValueError(f"the program refuses a frame of a recording with code {count}")
        return news[:count]

    return watch_recording


def _load_function(file: str, name: str, folder: Path, prefix: str) -> Any:
    """Compile a C file together with those of a folder, and load a function of it."""
    code = (CODE / f"{file}.c").read_text(encoding="utf-8")
    (folder / f"{file}.c").write_text(rename_public(code, prefix), encoding="utf-8")
    _run_program(["cc", *FLAGS, f"{file}.c", "-lm", "-o", f"{file}.so"], folder)
    return getattr(ctypes.CDLL(str(folder / f"{file}.so")), name)


def measure_footprint(folder: Path, *room: str) -> dict[str, float]:
    """Measure bytes and instructions of the C files of a folder on a Cortex-M4F.

    Args:
        folder: with the files.
        room: sizes of the chip as words of ``make``; default 256 KiB of flash and 32 KiB of RAM.

    Returns:
        Flash, linked: ``chip_flash_bytes`` are code, tables, and what both need of the C library;
        of these, ``chip_code_bytes`` and ``chip_table_bytes`` are the exported library's own.

        RAM: ``chip_ram_bytes`` is that of the library, without the program's own stack and buffers.
        ``chip_stack_bytes`` is the most stack that a frame and a label take below their caller,
        without interrupts. ``chip_program_ram_bytes`` is that of the whole program that reads
        frames from standard input, with the C library and what the linker script reserves for heap
        and stack.

        Instructions, as QEMU counts them: ``chip_frame_instructions`` of a frame (mean), and
        ``chip_most_instructions`` of the costliest frame together with its label, in a generated
        capture of 8 s with a label every eighth frame and at the end of each window.

    Raises:
        ValueError: they do not compile, or the program does not fit, or QEMU does not end.
    """
    numbers = _parse_make_output(["flash", "count", "chip", *room], FOOTPRINT_PATTERNS, folder)
    numbers["chip_program_ram_bytes"] += numbers.pop("chip_reserve")
    return numbers


def measure_watching(folder: Path, recording: np.ndarray | None = None) -> dict[str, float]:
    """Measure bytes and instructions of `touch_watch`, as `measure_footprint` does.

    ``chip_watch_ram_bytes`` includes the RAM of a capture. Instructions are those of a frame
    without and with touch (means), and of the costliest frame; also on a recording [frames, rows,
    cols], if there is one, with the number of reports.
    """
    if recording is not None:
        (folder / "recorded.bin").write_bytes(recording.astype("<f4").tobytes())
    patterns = WATCHING_PATTERNS if recording is None else WATCHING_PATTERNS + RECORDING_PATTERNS
    return _parse_make_output(["flash", "count", *ROOMY], patterns, folder)


def _parse_make_output(
    targets: list[str], patterns: tuple[str, ...], folder: Path
) -> dict[str, float]:
    """Run make, and return the numbers that it prints, by the names of the patterns' groups.

    Raises:
        ValueError: a pattern is not in the output.
    """
    text = _run_program(["make", "-s", *targets], folder)
    numbers: dict[str, float] = {}
    for pattern in patterns:
        if not (match := re.search(pattern, text)):
            raise ValueError(
                f"make {' '.join(targets)} printed nothing about {pattern.partition(':')[0]}: "
                f"{text[-300:]}"
            )
        numbers |= {f"chip_{name}": float(value) for name, value in match.groupdict().items()}
    return numbers


def _run_program(call: list[str], folder: Path) -> str:
    """Run a program and return its output; a ValueError if it fails or does not end."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(call, cwd=folder, start_new_session=True, **pipes) as process:
        try:
            output, errors = process.communicate(timeout=LIMIT_S)
        except BaseException as e:
            os.killpg(process.pid, signal.SIGKILL)  # make, and the QEMU that it started
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
    versions = []
    for name in filter(shutil.which, PROGRAMS):
        call = [name, "--version"]
        done = subprocess.run(call, capture_output=True, text=True, check=False)
        versions.append(done.stdout.partition("\n")[0])
    return versions
