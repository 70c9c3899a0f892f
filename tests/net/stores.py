"""What the runs of a store hold, to the last digit.

Times, memory, versions, machine, ids and keys are left out.
"""

import contextlib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from bench.ground.registry import views_of_runs
from bench.store.client import connect
from tests.net.masks import MASKED

APART = re.compile(f"{MASKED.pattern}|front")  # trials that no other beats in accuracy and time


def untimed(columns: Mapping[str, Iterable]) -> dict[str, list[str]]:
    """The columns of a table to the last digit, but for those that differ between any two runs."""
    return {
        str(name): [*map(repr, column)]
        for name, column in columns.items()
        if not APART.fullmatch(str(name))
    }


def contents(folder: Path) -> dict[str, list[str]]:
    """Numbers, tags and tables of the runs of a store, by the number and name of the run."""
    found = {}
    with contextlib.chdir(folder):
        store = connect() if Path("mlflow.db").exists() else None
        for number, run in enumerate(
            map(store.load_result, store.runs_of_kind(*views_of_runs())) if store else ()
        ):
            values = {name: [value] for name, value in (run.metrics | run.attributes).items()}
            for table, columns in [("", values), *sorted(run.tables.items())]:
                name = f"run {number}, {run.kind} {run['system']}: {table} "
                found |= {name + column: cells for column, cells in untimed(columns).items()}
    return found
