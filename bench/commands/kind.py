"""The commands that make runs, of all kinds and circumstances: ``bench run`` and others."""

from __future__ import annotations

from pathlib import Path

from bench.arguments import backend_of, parse
from bench.commands.printing import output, say, show, then, writable
from bench.errors import InputError
from bench.options import keys, makers
from bench.plan.cells import Cell, cells
from bench.registry import check_loaded, classes
from bench.result import Result
from bench.table import Table
from bench.words import Values
from bench.work.backend import Backend
from bench.work.experiment import Experiment
from bench.work.loop import execute, prepared


def command(name: str, arguments: list[str]) -> int:
    """Make the runs that the arguments name, print and write them; exit code 1 if a fold failed.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    try:
        values = parse(arguments, keys(name))
    except InputError:
        check_loaded()  # the key may be one of such a package
        raise
    todo, out = planned(name, values)
    folder = writable(Path(out)) if out else None
    return printed(name, execute(todo, backend_of(values)), folder)


def made(name: str, values: Values) -> list[Result]:
    """The runs of some values.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return execute(planned(name, values)[0], backend_of(values))


def planned(name: str, values: Values) -> tuple[list, str]:
    """What a command is to run, and the folder of ``out=``; empty for none.

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    maker = makers()[name]
    given = dict(maker.spelling.given)
    own = {option.key for option in maker.options()} | {*given}
    of_cells = {k: v for k, v in values.items() if k not in own and k.partition(".")[0] not in own}
    kinds = maker.kind.of({**given, **{k: v for k, v in values.items() if k not in of_cells}})
    ready = maker.kind.ready(cells(of_cells))
    out = str(values.get("out", maker.spelling.out[0])) if maker.spelling.out[0] else ""
    return prepared(ready, kinds, backend_of(values).jobs), out


def printed(name: str, results: list[Result], folder: Path | None = None) -> int:
    """Print runs as a command shows them, and write what it writes; the exit code.

    Args:
        name: command whose view is shown; ``bench run`` shows the kind, and each circumstance.
        results: results of one kind of run.
        folder: folder of ``out=``.
    """
    maker = makers()[name]
    views = maker.kind.views(results) if maker.view is maker.kind else [(maker.view, results)]
    code = show(results, views)
    scored = [r for r in results if r.scored and maker.view.holds(r)]
    if folder is not None:
        say(*maker.view.write(scored, folder))
    for view, members in views:
        for shown in view.printed(members):
            shown.print(output()) if isinstance(shown, Table) else say(shown)
    then(maker.view.then(results))
    return code


def evaluated(todo: list[Cell], backend: Backend) -> list[Result]:
    """Cells of captures, evaluated as ``bench run`` does.

    Raises:
        InputError: something in the cells or the data cannot be used; nothing was run.
    """
    plain: Experiment = next(iter(classes("kinds").values()))()
    return execute(prepared(todo, [plain], backend.jobs), backend)
