"""The command ``bench chip``: labels of systems exported as C, and their costs on a microcontroller."""

from __future__ import annotations

from bench.arguments import Values, backend_of, items, parse, setting
from bench.commands.printing import show, then
from bench.options import keys
from bench.plan.cells import cells
from bench.work.chip import OnChip
from bench.work.loop import Outcome, execute, prepared


def chip(arguments: list[str]) -> int:
    """Export systems in every fold and measure them; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used, or a program is not installed.
    """
    code = show(measured(parse(arguments, keys("chip"))))
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
