"""Stored runs as tables: `results` and `compare`, which load nothing that only making runs needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import pandas as pd

from bench.arguments import KEYS, values_of
from bench.errors import InputError, nearest
from bench.measures import over_people
from bench.outcomes.runs import SELECTING, asked_of, frame_of, grouped, selected, stored, wanted
from bench.outcomes.store import connect
from bench.reports.comparison import comparison, published
from bench.reports.pair import Compared, compared
from bench.result import COUNTS, Result
from bench.table import Table
from bench.words import items

SHOWN = (  # columns that matter, by name
    "system accuracy low high behind subject_sd macro_f1 adaptive_accuracy adaptive_ms flash_bytes predict_ms_p50 "
    "seed folds run_id subset target data protocol"
).split()
RENAMED = {"accuracy_low": "low", "accuracy_high": "high", "subject_accuracy_sd": "subject_sd"}
POOLED = ["accuracy", "accuracy_low", "accuracy_high"]  # over captures, as runs store them; shown over subjects
ON = ("data", "where", "target", "protocol")
SHARES = ("accuracy", "macro_", "subject_accuracy")  # metrics that are shown in percent


class Joined(Mapping[str, pd.DataFrame]):
    """Tables by name, each of all results below each other; a table is made when it is asked for."""

    def __init__(self, runs: Sequence[Result]) -> None:
        self._runs = [*runs]

    def __getitem__(self, name: str) -> pd.DataFrame:
        tables = [(r, r.tables.get(name)) for r in self._runs]
        parts = [table.assign(system=r.method) for r, table in tables if table is not None]
        if not parts:
            raise KeyError(f"no table is called {name!r}; {nearest(name, sorted(self))}")
        return pd.concat(parts, ignore_index=True)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys(name for r in self._runs for name in r.tables))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Results(pd.DataFrame):
    """A row for each run with the columns that matter; all that is known of the runs is one attribute away.

    Attributes:
        runs: the `bench.result.Result` of each run behind the rows, with its ``tables``. In `bench.results` a run may
            have several rows.
        tables: tables of all runs below each other by name, each with the column ``system`` (with the seed, where that
            is not the usual one).
    """

    _metadata = ["runs", "tables"]
    runs: list[Result]
    tables: Mapping[str, pd.DataFrame]

    @property
    def _constructor(self) -> type[pd.DataFrame]:
        return pd.DataFrame  # what is cut out of it or copied is a plain table

    def __reduce__(self) -> str | tuple[object, ...]:
        return pd.DataFrame(self).__reduce__()  # so is what is pickled: a store is of one process

    @property
    def full(self) -> pd.DataFrame:
        """A row for each run with every number that was measured, in percent; ``accuracy`` is pooled over captures."""
        return table_of(self.runs)


def results(full: bool = False, against: str = "", **values: object) -> Results | pd.DataFrame:
    """Tracked evaluations, accuracies in percent, with published numbers.

    Args:
        full: one row per run with every tag, parameter and metric, as MLflow has them: accuracies are fractions there.
        against: system that p values compare with, in the groups that have it; default the best one of each.
        values: the runs to keep: ``data``, ``where``, ``target``, ``protocol``, ``model`` and ``features`` of `run`,
            ``run`` (their ids), ``latest`` (True: of each model and feature set, only the newest parameters and
            captures).

    Returns:
        One row per run and way to score it, as `bench.reports.comparison.comparison` makes them; ``runs`` as of
        `Results`.

    Raises:
        InputError: nothing is tracked for them.
    """
    typed = values_of(values, SELECTING)
    runs = wanted(stored(connect()), asked_of(typed))
    if full:
        return frame_of(runs)
    if against and against not in (systems := sorted({r.system for r in runs})):
        raise InputError(f"against={against}: no run of this system is stored; {nearest(against, systems)}")
    table = comparison(grouped(runs), published(), against)
    return _with(Results(table), runs)


def compare(system: str | Mapping[str, object], other: str | Mapping[str, object], **values: object) -> Compared:
    """Two tracked systems on whole captures, paired over subjects; seeds are averaged.

    Args:
        system: system name as in tables, such as ``"svm · jung54"``, or its values as `run` takes them, such as
            ``{"model": "svm", "features": "jung28"}``. With ``data``, ``where``, ``target`` or ``protocol`` among
            these, only matching runs are searched.
        other: the system to compare it with.
        values: the runs of both, as `results` selects them.

    Returns:
        ``difference`` (first less second, mean over subjects, in points), its 95 % t-interval ``low`` and ``high``,
        ``p`` (two-sided Wilcoxon test), ``subjects`` (their number), ``gain`` and ``lose`` (the subjects on whom the
        first or the second is more accurate) and ``accuracy`` (a table [subjects, 2]).

    Raises:
        InputError: a system has no complete run, or the two were not run on the same data, subset and protocol.
    """
    asked = asked_of(values_of(values, SELECTING))
    every = selected(stored(connect()), asked)
    sides = []
    for one in (system, other):
        typed = {} if isinstance(one, str) else values_of(one, KEYS)
        among = {key: items(key, value) for key, value in typed.items() if key in ON}
        name = one if isinstance(one, str) else _system({k: v for k, v in typed.items() if k not in ON})
        groups = {group: selected(members, among) for group, members in grouped(every).items()}
        sides.append((name, {group: members for group, members in groups.items() if members}))
    return compared(sides)


def results_of(runs: Sequence[Result]) -> Results:
    """Results as a table with a row each."""
    scored = Table([over_people("accuracy")], runs).frame()
    scored = scored.reindex(columns=POOLED if scored["accuracy"].notna().any() else [])
    named = table_of(runs).drop(columns=POOLED, errors="ignore").join(scored).rename(columns=RENAMED)
    return _with(Results(named[[name for name in SHOWN if name in named]]), runs)


def _with(table: Results, runs: Sequence[Result]) -> Results:
    """The table with its results, and their tables below each other."""
    table.runs, table.tables = [*runs], Joined(runs)
    return table


def _system(values: dict[str, object]) -> str:
    """The name of the one system that some values mean."""
    from bench.plan.cells import cells  # heavy

    systems = {cell.system() for cell in cells(values)}
    if len(systems) > 1:
        raise InputError(f"{values} describe {len(systems)} systems; give one")
    return systems.pop()


def table_of(runs: Sequence[Result]) -> pd.DataFrame:
    """A table with a row per run and all its measurements; accuracies in percent."""
    rows = []
    for r in runs:
        data, _, protocol = r.context
        row: dict[str, object] = {"system": r.system, "data": data, "subset": r["subset"], "target": r["target"]}
        row |= {"protocol": protocol, "seed": r["seed"]}
        row |= {k: 100 * v if any(s in k for s in SHARES) else v for k, v in r.metrics.items() if k not in COUNTS}
        rows.append(row | {"folds": r.folds, "run_id": r["run_id"]})
    return pd.DataFrame(rows)
