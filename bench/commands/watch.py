"""The command ``bench watch``: continuous recordings through fitted systems."""

from __future__ import annotations

from dataclasses import replace

from bench.arguments import KEYS, Values, backend_of, parse, setting
from bench.commands.printing import show, then
from bench.corpora.library import imported, stored_value
from bench.corpora.recordings import Recordings
from bench.errors import InputError
from bench.options import keys
from bench.plan.cells import Cell, cells
from bench.result import Result
from bench.usual import FALSE_ALARMS
from bench.work.loop import execute, prepared
from bench.work.watch import Watch
from reports.illustrations import illustrate

OWN = keys("watch") - KEYS


def watch(arguments: list[str]) -> int:
    """Watch recordings under a protocol; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    code = show(watched(parse(arguments, keys("watch"))), Watch)
    then(f"bench choose max_false_alarms={FALSE_ALARMS:g} max_latency=1s")
    return code


def watched(values: Values) -> list[Result]:
    """The systems of some values on continuous recordings.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    alarms = float(str(setting("watch", "false_alarms", values)))
    experiment = Watch(alarms, str(values.get("background", "")), str(values.get("unknown", "")))
    backend = backend_of(values)
    todo = cells({k: v for k, v in values.items() if k not in OWN})
    recorded = {name: name == "synth" or holds_recordings(name) for name in dict.fromkeys(cell.data for cell in todo)}
    todo = [with_recordings(cell) if recorded[cell.data] else cell for cell in todo]
    return execute(prepared(todo, [experiment], backend.jobs), backend, illustrate)


def with_recordings(cell: Cell) -> Cell:
    """The cell, marked: its data holds recordings.

    Raises:
        InputError: a condition selects captures of recordings.
    """
    if cell.where:
        raise InputError(f"where={cell.where}: {cell.data} holds recordings, which are used whole; leave where= out")
    return replace(cell, recordings=True)


def holds_recordings(data: str) -> bool:
    """Return True for imported recordings."""
    return data in imported() and isinstance(stored_value(data), Recordings)
