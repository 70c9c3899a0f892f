"""The command ``bench chip``: labels of systems exported as C, and their costs on a microcontroller."""

from __future__ import annotations

from bench.arguments import Values, backend_of, items, parse, setting
from bench.commands.printing import output, show, then
from bench.measures import Measure, text
from bench.options import keys
from bench.plan.cells import cells
from bench.result import Result
from bench.table import Table
from bench.work.chip import OnChip
from bench.work.loop import execute, prepared

WATCHING = (  # columns of the costs of watching an endless stream
    text("system", read=lambda r: r.system),
    Measure("bits", read="chip.bits"),
    Measure("flash", "flash kB", "chip_watch_flash_bytes", ",.1f", per=1000),
    Measure("ram", "RAM kB", "chip_watch_ram_bytes", ",.1f", per=1000),
    Measure("stack", "stack B", "chip_watch_stack_bytes", ",.0f"),
    Measure("idle", "instructions a frame", "chip_watch_idle_instructions", ",.0f"),
    Measure("frame", "in a touch", "chip_watch_frame_instructions", ",.0f"),
    Measure("most", "at most", "chip_watch_most_instructions", ",.0f"),
)


def chip(arguments: list[str]) -> int:
    """Export systems in every fold and measure them; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used, or a program is not installed.
    """
    results = measured(parse(arguments, keys("chip")))
    code = show(results, OnChip)
    if watching := [r for r in results if "chip_watch_flash_bytes" in r]:
        Table(WATCHING, watching, "Costs of touch_watch, which watches an endless stream").print(output())
    then("bench choose by=cycles")
    return code


def measured(values: Values) -> list[Result]:
    """The cells of some values as C.

    Raises:
        InputError: something in the values or the data cannot be used, or a program is not installed.
    """
    bits = [setting("chip", "bits", {"bits": each}) for each in items("bits", values.get("bits", "32"))]
    experiments = [OnChip(int(str(each))) for each in dict.fromkeys(bits)]
    backend = backend_of(values)
    todo = cells({key: value for key, value in values.items() if key != "bits"})
    return execute(prepared(todo, experiments, backend.jobs), backend)
