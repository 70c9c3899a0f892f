"""The command ``bench stress``: failures of recognisers, under faults and without."""

from __future__ import annotations

import re
from pathlib import Path

from bench.amounts import convert
from bench.arguments import KEYS, Values, backend_of, items, parse
from bench.commands.printing import contexts, say, show, then, writable
from bench.corpora.faults import Fault, all_faults
from bench.errors import InputError, nearest
from bench.options import keys
from bench.outcomes import stability
from bench.plan.cells import cells
from bench.result import Result
from bench.work.loop import execute, prepared
from bench.work.stress import Stress
from reports import stability_tables

OWN = keys("stress") - KEYS


def stress(arguments: list[str]) -> int:
    """Stress every cell that the arguments name, print where each fails; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    results, out = stressed(parse(arguments, keys("stress")))
    code = show(results, Stress)
    for folder, members in grouped(results, out).items():
        title = ", ".join(members[0].context)
        say(f"{title}: failing subjects, classes, conditions and faults, with figures: {folder / 'stability.md'}")
    say("To train a system on damaged copies too, add model.faults=all.")
    then("bench report")
    return code


def stressed(values: Values) -> tuple[list[Result], Path]:
    """The cells of some values under stress, their tables and figures written; and where.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    experiment = Stress(_faults(values), _counts(values))
    backend = backend_of(values)
    todo = prepared(cells({k: v for k, v in values.items() if k not in OWN}), [experiment], backend.jobs)
    out = writable(Path(str(values.get("out", "stress"))))
    results = execute(todo, backend)
    for folder, members in grouped(results, out).items():
        stability_tables.write(members, folder)
    return results, out


def grouped(results: list[Result], out: Path) -> dict[Path, list[Result]]:
    """Successful runs by the folder of their tables: one for each corpus, subset and protocol."""
    folders: dict[Path, list[Result]] = {}
    groups = contexts(results)
    for members in groups:
        folder = out
        if len(groups) > 1:
            name = re.sub(r"[^A-Za-z0-9]+", "-", " ".join(members[0].context)).strip("-").lower()
            folder = out / name if out / name not in folders else out / f"{name}-{len(folders) + 1}"
        folders[folder] = members
    return folders


def _faults(values: Values) -> tuple[Fault, ...]:
    """Faults that were asked for, all without ``faults=``, in the order in which they are known."""
    faults = all_faults()
    chosen = items("faults", values["faults"]) if "faults" in values else list(faults)
    if chosen == [stability.CLEAN]:
        return ()
    for name in chosen:
        if name not in faults:
            raise InputError(f"faults={name}: unknown; {nearest(name, faults)}")
    return tuple(fault for name, fault in faults.items() if name in chosen)


def _counts(values: Values) -> tuple[int, ...]:
    """Numbers of training subjects that were asked for."""
    if "train_subjects" not in values:
        return ()
    counts = {convert("train_subjects", text, 4) for text in items("train_subjects", values["train_subjects"])}
    if min(counts) < 1:
        raise InputError(f"train_subjects={min(counts)}: give whole numbers of at least 1")
    return tuple(sorted(counts))
