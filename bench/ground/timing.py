"""Times of work as on a quiet machine, measured while the machine does other things.

Wall time includes waiting for a busy processor. Processor time does not, but shared caches and
clocks slow it too. So work is timed in processor time, summed over all threads of the process, and
so is a fixed reference workload right before and after it. Tables show the ratio of both, times the
time of the workload on the quiet machine. Threads of BLAS and torch that wait actively for others
count as work.

The time of the workload on the quiet machine is the shortest time ever measured, stored in the
user's data folder by processor and versions. A damaged file is replaced, with a warning.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from bench.ground.digests import DamagedFile, json_with_digest, read_json_with_digest
from bench.ground.machine import cpu_model
from bench.ground.progress import warn
from bench.ground.scratch import data_folder, write_then_rename

REPEATS = 2  # of each piece of work; the shorter one counts
NEAR = 3  # workloads before a piece of work, and after it, whose median counts
AROUND = 8  # workloads before work that is done once, and after it
WARM_UP = 3
REFERENCE_FILE = "reference.json"

Value = TypeVar("Value")


@dataclass(frozen=True)
class Times:
    """Milliseconds of several pieces of work."""

    ms: list[float]  # on the quiet machine, one each
    wall_ms: list[float]  # by the wall clock, one each
    reference_ms: float  # median processor time of the workloads around them
    quiet_ms: float  # processor time of the workload on the quiet machine
    slowdown: float  # median wall time of these workloads, divided by `quiet_ms`


# Large arrays are made once: new memory takes a time that depends on what the process did before.
TABLE, PRODUCTS = np.linspace(-1, 1, 256 * 256).reshape(256, 256), np.empty((256, 256))


def run_reference_workload() -> float:
    """Work for some milliseconds: arithmetic on arrays, a sort, a spectrum, and plain Python.

    It does without BLAS, which waits actively for a time that depends on other programs.
    """
    total = 0.0
    for _ in range(4):  # half a megabyte, along both axes
        np.multiply(TABLE.T, TABLE, out=PRODUCTS)
        np.add(PRODUCTS, TABLE, out=PRODUCTS)
        total += float(PRODUCTS[7, 7])
    for _ in range(2):
        wave = np.sort(np.sin(np.arange(8192.0)))
        total += float(np.abs(np.fft.rfft(wave)).sum())
    for i in range(15000):
        total += i * 7 % 13
    for i in range(200):
        total += float(np.asarray([total, i]).mean() > 0)
    return total


def measure_ms(work: Callable[[], object]) -> tuple[float, float]:
    """Do some work; its milliseconds by the wall clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    cpu = time.process_time() - cpu
    return (time.perf_counter() - wall) * 1000, cpu * 1000


def time_repeatedly(works: Iterable[Callable[[], object]]) -> Times:
    """Time each piece of work several times between reference workloads; the shortest counts."""
    references = [measure_ms(run_reference_workload) for _ in range(WARM_UP)][-1:]
    shortest = []
    for work in works:
        walls, cpus = [], []
        for _ in range(REPEATS):
            wall, cpu = measure_ms(work)
            walls.append(wall)
            cpus.append(cpu)
            references.append(measure_ms(run_reference_workload))
        shortest.append((min(cpus), min(walls), len(references)))
    ratios = []
    for cpu, _, end in shortest:
        nearby = references[max(0, end - NEAR - REPEATS) : end + NEAR]
        ratios.append(cpu / median_reference(nearby))
    return _make_times(ratios, [wall for _, wall, _ in shortest], references)


def time_once(
    work: Callable[[], Value],
    select_seconds: Callable[[float, float], tuple[float, float]] | None = None,
) -> tuple[Value, Times, float]:
    """Time a longer piece of work between reference workloads.

    Args:
        work: what is done once.
        select_seconds: from the measured seconds (wall, processor) to those that count.

    Returns:
        The result of the work, its times, and its milliseconds of the processor.
    """
    references = [measure_ms(run_reference_workload) for _ in range(WARM_UP + AROUND)][WARM_UP:]
    results: list[Value] = []
    wall, cpu = measure_ms(lambda: results.append(work()))
    references += [measure_ms(run_reference_workload) for _ in range(AROUND)]
    if select_seconds:
        wall, cpu = (1000 * seconds for seconds in select_seconds(wall / 1000, cpu / 1000))
    return results[0], _make_times([cpu / median_reference(references)], [wall], references), cpu


def _make_times(
    ratios: Sequence[float], walls: Sequence[float], references: Sequence[tuple[float, float]]
) -> Times:
    quiet = update_quiet_ms(min(cpu for _, cpu in references))
    slowdown = float(np.median([wall for wall, _ in references])) / quiet
    ms = [ratio * quiet for ratio in ratios]
    return Times(ms, [*walls], median_reference(references), quiet, slowdown)


def median_reference(references: Sequence[tuple[float, float]]) -> float:
    """Median processor time of reference workloads, which an interruption does not change.

    Raises:
        OSError: it is 0, because the clock is too coarse.
    """
    median = float(np.median([cpu for _, cpu in references]))
    if median <= 0:
        raise OSError("the processor time of this system is too coarse to time a prediction")
    return median


def update_quiet_ms(measured: float) -> float:
    """Shortest time of the reference workload on this machine; stores the measured one if it is."""
    path = data_folder() / REFERENCE_FILE
    key = f"{cpu_model()}, Python {platform.python_version()}, numpy {np.__version__}"
    shortest: dict[str, float] = {}
    try:
        shortest = read_json_with_digest(path)
        if not all(isinstance(ms, float) and 0 < ms < np.inf for ms in shortest.values()):
            raise DamagedFile("a time is no number above 0")
    except DamagedFile:
        shortest = {}
        warn(f"warning: {path} is damaged; the reference workload of this machine is timed anew")
    except OSError:  # there is none yet
        pass
    if measured < shortest.get(key, np.inf):
        shortest[key] = measured
        with suppress(OSError), write_then_rename(path) as beside:  # unless it cannot be written
            beside.write_text(json_with_digest(json.dumps(shortest)))
    return shortest[key]
