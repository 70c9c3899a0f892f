"""The command ``bench chip``: what systems answer as C, and what they take of a microcontroller."""

from __future__ import annotations

from bench.arguments import KEYS as RUN_KEYS
from bench.arguments import Values, backend_of, items, parse
from bench.commands.printing import show, then
from bench.errors import InputError
from bench.plan.cells import cells
from bench.work.chip import OnChip
from bench.work.loop import Outcome, execute, prepared

KEYS = RUN_KEYS | {"bits"}


def chip(arguments: list[str]) -> int:
    """Export systems in every fold and measure them; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used, or a program is not installed.
    """
    outcomes = measured(parse(arguments, KEYS))
    code = show(outcomes)
    then("bench choose by=cycles")
    return code


def measured(values: Values) -> list[Outcome[None]]:
    """The cells of some values as C.

    Raises:
        InputError: something in the values or the data cannot be used, or a program is not installed.
    """
    bits = dict.fromkeys(str(b) for b in items("bits", values.get("bits", "32")))
    if wrong := [b for b in bits if b not in ("32", "8")]:
        raise InputError(f"bits={wrong[0]}: give 32 or 8")
    backend = backend_of(values)
    asked = cells({k: v for k, v in values.items() if k != "bits"})
    return execute(prepared(asked, [OnChip(int(b)) for b in bits], backend.jobs), backend)
