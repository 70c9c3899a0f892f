"""Compare what the runs of two stores hold: ``python -m tests.net.stores BEFORE AFTER`` prints every difference.

BEFORE and AFTER are folders with ``mlflow.db``. Numbers must be equal to the last digit. Times, memory, versions,
machine, ids and keys are left out. Exit code 1 if anything differs.
"""

import contextlib
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from bench.ground.registry import run_views
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
    """What the runs of a store hold, by the number and the name of a run and the name of the number, tag or column."""
    found = {}
    with contextlib.chdir(folder):
        store = connect() if Path("mlflow.db").exists() else None
        for number, run in enumerate(
            map(store.result, store.of_kind(*run_views())) if store else ()
        ):
            values = {name: [value] for name, value in (run.metrics | run.about).items()}
            for table, columns in [("", values), *sorted(run.tables.items())]:
                name = f"run {number}, {run.kind} {run['system']}: {table} "
                found |= {name + column: cells for column, cells in untimed(columns).items()}
    return found


def main(before: str, after: str) -> int:
    """Print differences."""
    old, new = contents(Path(before)), contents(Path(after))
    changed = [name for name in dict.fromkeys([*old, *new]) if old.get(name) != new.get(name)]
    for name in changed:
        one, other = old.get(name, []), new.get(name, [])
        row = next(
            (i for i, pair in enumerate(zip(one, other, strict=False)) if pair[0] != pair[1]), 0
        )
        print(
            f"{name}: {len(one)} -> {len(other)} rows, row {row}: {one[row : row + 1]} -> {other[row : row + 1]}"
        )
    print(f"{len(changed)} of {len({*old, *new})} differ")
    return int(bool(changed) or not old)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
