"""The command ``bench chip``: labels of systems exported as C, and their costs on a microcontroller."""

from __future__ import annotations

from bench.arguments import Values, backend_of, items, parse, setting
from bench.commands.printing import grid, output, show, system_in_tables, then
from bench.options import keys
from bench.plan.cells import cells
from bench.work.chip import OnChip
from bench.work.loop import Outcome, execute, prepared

WATCH = "chip_watch_"
KILOBYTES = {"flash": "flash", "RAM": "ram"}
SINGLE = {
    "stack B": "stack_bytes",
    "instructions a frame": "idle_instructions",
    "in a touch": "frame_instructions",
    "at most": "most_instructions",
}


def chip(arguments: list[str]) -> int:
    """Export systems in every fold and measure them; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used, or a program is not installed.
    """
    outcomes = measured(parse(arguments, keys("chip")))
    code = show(outcomes)
    if rows := watching(outcomes):
        grid(output(), "Costs of touch_watch, which watches an endless stream", rows, ("system",))
    then("bench choose by=cycles")
    return code


def measured(values: Values) -> list[Outcome[None]]:
    """The cells of some values as C.

    Raises:
        InputError: something in the values or the data cannot be used, or a program is not installed.
    """
    bits = [setting("chip", "bits", {"bits": each}) for each in items("bits", values.get("bits", "32"))]
    experiments = [OnChip(int(str(each))) for each in dict.fromkeys(bits)]
    backend = backend_of(values)
    todo = cells({key: value for key, value in values.items() if key != "bits"})
    return execute(prepared(todo, experiments, backend.jobs), backend)


def watching(outcomes: list[Outcome[None]]) -> list[dict[str, str]]:
    """Costs of watching an endless stream, a row for each run that has measured them."""
    rows = []
    for outcome in outcomes:
        costs = {name.removeprefix(WATCH): value for name, value in outcome.metrics.items() if name.startswith(WATCH)}
        if costs:
            row = {"system": system_in_tables(outcome), "bits": outcome.experiment.arguments().get("bits", "32")}
            row |= {f"{of} kB": f"{costs[f'{name}_bytes'] / 1000:,.1f}" for of, name in KILOBYTES.items()}
            rows.append(row | {heading: f"{costs[name]:,.0f}" for heading, name in SINGLE.items()})
    return rows
