"""The command ``bench run``: every cell that the arguments name, evaluated and tracked."""

from __future__ import annotations

from bench.arguments import KEYS, Backend, Values, backend_of, parse
from bench.commands.printing import one_label, show, then
from bench.plan.cells import Cell, cells
from bench.result import Result
from bench.work.evaluation import Evaluation
from bench.work.loop import execute, prepared
from reports.illustrations import illustrate


def run(arguments: list[str]) -> int:
    """Run every cell that the arguments name; exit code 1 if a fold failed.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    return printed(evaluated_values(parse(arguments, KEYS)))


def printed(results: list[Result]) -> int:
    """Print evaluations, whichever command made them; the exit code."""
    code = show(results, Evaluation)
    one_label(results)
    then("bench choose")
    return code


def evaluated_values(values: Values) -> list[Result]:
    """The cells of some values, evaluated."""
    return evaluated(cells(values), backend_of(values))


def evaluated(todo: list[Cell], backend: Backend) -> list[Result]:
    """Cells, evaluated.

    Raises:
        InputError: something in the cells or the data cannot be used; nothing was run.
    """
    return execute(prepared(todo, [Evaluation()], backend.jobs), backend, illustrate)
