"""Times that say what work takes on a quiet machine, measured while the machine does other things.

Wall time counts the waiting for a busy processor. Processor time does not, but shared caches and clocks slow it, too.
So work is timed in processor time, summed over all threads of the process, and so is a fixed workload right before
and right after it. The ratio, times what the workload takes on this machine when it is quiet, is what tables show.
Threads of BLAS and torch that wait actively for others count as work.

What the workload takes on a quiet machine is the shortest time that was ever seen, kept in the user's data folder by
processor and versions.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np

from bench.ground.machine import cpu_model
from bench.ground.scratch import data_folder, write_then_rename

REPEATS = 2  # of each piece of work; the shorter one counts
NEAR = 3  # workloads before a piece of work, and after it, whose median counts
AROUND = 8  # workloads before work that is done once, and again after it
WARM_UP = 3
REFERENCE_FILE = "reference.json"

Given = TypeVar("Given")


@dataclass(frozen=True)
class Times:
    """Milliseconds of several pieces of work."""

    ms: list[float]  # on the quiet machine, one each
    wall_ms: list[float]  # by the wall clock, one each
    reference_ms: float  # processor time of the workloads around them; the median
    quiet_ms: float  # the same on the quiet machine
    slowdown: float  # wall time of these workloads, by their time on the quiet machine; the median


@cache
def _tables() -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(-1, 1, 256 * 256).reshape(256, 256), np.empty((256, 256))


def run_reference_workload() -> float:
    """The workload, of some milliseconds: arithmetic on arrays, a sort, a spectrum, and Python with small arrays.

    No BLAS: with several threads it waits actively, for a time that depends on other programs. No large array is made:
    new memory takes a time that depends on what the process did before.
    """
    table, result = _tables()
    total = 0.0
    for _ in range(4):  # half a megabyte, along both axes
        np.multiply(table.T, table, out=result)
        np.add(result, table, out=result)
        total += float(result[7, 7])
    for _ in range(2):
        wave = np.sort(np.sin(np.arange(8192.0)))
        total += float(np.abs(np.fft.rfft(wave)).sum())
    for i in range(15000):
        total += i * 7 % 13
    for i in range(200):
        total += float(np.asarray([total, i]).mean() > 0)
    return total


def measure_ms(work: Callable[[], object]) -> tuple[float, float]:
    """Milliseconds of the wall clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    cpu = time.process_time() - cpu
    return (time.perf_counter() - wall) * 1000, cpu * 1000


def time_repeatedly(works: Iterable[Callable[[], object]]) -> Times:
    """Do each piece of work twice, with the workload between all of them, and give the shorter times."""
    references = [measure_ms(run_reference_workload) for _ in range(WARM_UP)][-1:]
    done = []
    for work in works:
        walls, cpus = [], []
        for _ in range(REPEATS):
            wall, cpu = measure_ms(work)
            walls.append(wall)
            cpus.append(cpu)
            references.append(measure_ms(run_reference_workload))
        done.append((min(cpus), min(walls), len(references)))
    ratios = [
        cpu / median_reference(references[max(0, end - NEAR - REPEATS) : end + NEAR])
        for cpu, _, end in done
    ]
    return _make_times(ratios, [wall for _, wall, _ in done], references)


def time_once(
    work: Callable[[], Given], counted: Callable[[float, float], tuple[float, float]] | None = None
) -> tuple[Given, Times, float]:
    """Do a longer piece of work, with workloads before and after it; what it gives, its times, processor milliseconds.

    ``counted`` selects the seconds that count, from the wall clock and the processor.
    """
    references = [measure_ms(run_reference_workload) for _ in range(WARM_UP + AROUND)][WARM_UP:]
    given: list[Given] = []
    wall, cpu = measure_ms(lambda: given.append(work()))
    references += [measure_ms(run_reference_workload) for _ in range(AROUND)]
    if counted:
        wall, cpu = (1000 * seconds for seconds in counted(wall / 1000, cpu / 1000))
    return given[0], _make_times([cpu / median_reference(references)], [wall], references), cpu


def _make_times(
    ratios: Sequence[float], walls: Sequence[float], references: Sequence[tuple[float, float]]
) -> Times:
    here = median_reference(references)
    quiet = update_quiet_ms(min(cpu for _, cpu in references))
    slowdown = float(np.median([wall for wall, _ in references])) / quiet
    return Times([ratio * quiet for ratio in ratios], [*walls], here, quiet, slowdown)


def median_reference(references: Sequence[tuple[float, float]]) -> float:
    """Processor time of a workload: the median, which no interruption changes."""
    middle = float(np.median([cpu for _, cpu in references]))
    if middle <= 0:
        raise OSError("the processor time of this system is too coarse to time a prediction")
    return middle


def update_quiet_ms(seen: float) -> float:
    """Milliseconds of the workload on this machine when it is quiet; the time just measured, if it is the shortest."""
    path, key = data_folder() / REFERENCE_FILE, _machine_key()
    known: dict[str, float] = {}
    with suppress(OSError, ValueError, AttributeError):
        known = {str(name): float(ms) for name, ms in json.loads(path.read_text()).items()}
    if seen < known.get(key, np.inf):
        known[key] = seen
        with (
            suppress(OSError),
            write_then_rename(path) as beside,
        ):  # a folder that cannot be written knows no shorter time
            beside.write_text(json.dumps(known))
    return known[key]


@cache
def _machine_key() -> str:
    import platform

    return f"{cpu_model()}, Python {platform.python_version()}, numpy {np.__version__}"
