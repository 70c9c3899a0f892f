"""The runs of a command that are not stored yet, and the seconds that they will take, from stored runs like them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from bench.plan.plan import Plan
from bench.store import Store
from bench.work.tracking import FOLDS, finished, is_whole

NEWEST = 20  # runs among which one like another is looked for: a store may have thousands
FREE = ("seed", "protocol")  # arguments in which runs that take about as long may differ, as in parameters of parts


class Left(NamedTuple):
    """A run that is not stored whole, and the number of its missing folds."""

    plan: Plan
    folds: int


def left(store: Store, plans: Iterable[Plan]) -> list[Left]:
    """The plans whose runs are not stored whole."""
    found = []
    for plan in plans:
        run = store.find(plan.key, plan.cell.kind)
        if not run or not is_whole(run):
            found.append(Left(plan, len(plan.folds) - (len(finished(store, run)) if run else 0)))
    return found


def expected(store: Store, todo: Iterable[Left]) -> list[float | None]:
    """Seconds that the missing folds of each run take with its workers; None where no run like it has a fold."""
    seconds = []
    for plan, folds in todo:
        cell = plan.cell  # objects cannot be typed
        each = None if cell.objects else _of_a_fold(store, cell.kind, cell.arguments())
        seconds.append(each and each * folds / max(1, min(plan.workers, folds)))
    return seconds


def _of_a_fold(store: Store, kind: str, arguments: Mapping[str, str]) -> float | None:
    """Mean seconds of a fold of the stored run with most arguments in common, or itself; the newest of several."""
    names = {key: arguments[key] for key in ("data", "model", "features") if key in arguments}
    like = []
    for run in store.newest(kind, NEWEST, **names):
        theirs = json.loads(run.data.tags.get("touchbench.arguments", "{}"))
        if _fixed(theirs) == _fixed(arguments):
            like.append((len(arguments.items() & theirs.items()), run))
    for _, run in sorted(like, key=lambda one: -one[0]):
        if (table := store.result(run).tables.get(FOLDS)) is not None:
            done = [*table["seconds"][table["status"] == "FINISHED"]]
        else:  # it was cut off
            done = [result.seconds for result in finished(store, run).values()]
        if done:
            return float(np.mean(done))
    return None


def _fixed(arguments: Mapping[str, str]) -> dict[str, str]:
    return {key: value for key, value in arguments.items() if "." not in key and key not in FREE}
