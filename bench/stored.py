"""Stored runs as tables and text, which load nothing that only making runs needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from bench.arguments import KEYS, values_of
from bench.errors import InputError
from bench.outcomes.frame import frame, grouped, tables
from bench.outcomes.runs import SELECTING, asked_of, every_result, of_captures, selected, stored, wanted
from bench.reports.comparison import comparison, published
from bench.reports.latex import columns_of, papers, side_by_side
from bench.reports.latex import latex as compared_in_latex
from bench.reports.pair import Compared, compared
from bench.store import connect
from bench.words import items

ON = ("data", "where", "target", "protocol")


def runs(cases: bool = False, **values: object) -> pd.DataFrame:
    """Stored runs of all kinds, accuracies in percent.

    Args:
        cases: True for a row for each case of the circumstances of each run, such as a fault at one severity.
        values: the runs to keep: ``data``, ``where``, ``target``, ``protocol``, ``model`` and ``features`` of `run`,
            ``run`` (their ids), ``latest`` (True: of each model and feature set, only the newest parameters and
            captures).

    Returns:
        One row per run: ``name``, which tells what differs from its neighbours; ``accuracy``, the mean over subjects,
        with its 95 % t-interval (``low``, ``high``) and SD, and every other number; system, model, features,
        parameters, seed, unit, subset, target, data and protocol; ``complete``, ``alone``, ``folds`` and ``run_id``.

    Raises:
        InputError: nothing is stored for them.
    """
    asked = asked_of(values_of(values, SELECTING))
    return frame(wanted(every_result(connect(), asked), asked), cases)


def predictions(runs: pd.DataFrame | None = None, table: str = "predictions", **values: object) -> pd.DataFrame:
    """The labels of stored runs as one table, or another table of theirs.

    Args:
        runs: rows of `runs`, or of a function that makes runs; None for all that ``values`` select.
        table: ``predictions`` (a row per decision with the probability of each class), ``per_subject``, ``labels``
            (labels in the cases of circumstances) or another table of a run.
        values: the runs to keep, as `runs` takes them.

    Returns:
        The rows of the table with the ``name`` and ``run_id`` of their run.

    Raises:
        InputError: nothing is stored for them, or no run has such a table.
    """
    asked = asked_of(values_of(values, SELECTING))
    if runs is not None:
        asked["run"] = [*runs["run_id"]]
    return tables(wanted(every_result(connect(), asked), asked), table)


def compare(system: str | Mapping[str, object], other: str | Mapping[str, object], **values: object) -> Compared:
    """Two tracked systems on whole captures, paired over subjects; seeds are averaged.

    Args:
        system: system name as in tables, such as ``"svm · jung54"``, or its values as `run` takes them, such as
            ``{"model": "svm", "features": "jung28"}``. With ``data``, ``where``, ``target`` or ``protocol`` among
            these, only matching runs are searched.
        other: the system to compare it with.
        values: the runs of both, as `runs` selects them.

    Returns:
        ``difference`` (first less second, mean over subjects, in points), its 95 % t-interval ``low`` and ``high``,
        ``p`` (two-sided Wilcoxon test), ``subjects`` (their number), ``gain`` and ``lose`` (the subjects on whom the
        first or the second is more accurate) and ``accuracy`` (a table [subjects, 2]).

    Raises:
        InputError: a system has no complete run, or the two were not run on the same data, subset and protocol.
    """
    every = selected(stored(connect()), asked_of(values_of(values, SELECTING)))
    sides = []
    for one in (system, other):
        typed = {} if isinstance(one, str) else values_of(one, KEYS)
        among = {key: items(key, value) for key, value in typed.items() if key in ON}
        name = one if isinstance(one, str) else _system({k: v for k, v in typed.items() if k not in ON})
        groups = {group: selected(members, among) for group, members in grouped(every).items()}
        sides.append((name, {group: members for group, members in groups.items() if members}))
    return compared(sides)


def latex(runs: pd.DataFrame, paper: Sequence[str] | str = ()) -> str:
    """Tables that compare systems, each with a caption that names corpus, protocol and unit.

    Args:
        runs: rows of `runs`, or of a function that makes runs. Runs on the same captures, under the same protocol and
            in the same unit share one table; p is corrected for all systems of it.
        paper: columns of a table with systems as rows and protocols side by side: ``accuracy`` (mean over people ± SD)
            and ``macro_f1`` under each protocol, ``fit``, ``predict`` and ``flash`` of each system. Protocols that mix
            people are marked. Empty for a table of each protocol.

    Returns:
        Text for a document that loads booktabs.

    Raises:
        InputError: it is no such table.
    """
    if not isinstance(runs, pd.DataFrame) or "run_id" not in runs:
        raise InputError("bench.latex: give the table of bench.runs()")
    results = of_captures(wanted(every_result(connect()), {"run": [*runs["run_id"]]}))
    if paper:
        return side_by_side(papers(results, columns_of(paper)))
    return compared_in_latex(comparison(grouped(results), published()))


def _system(values: dict[str, object]) -> str:
    """The name of the one system that some values mean."""
    from bench.plan.cells import cells  # heavy

    systems = {cell.system() for cell in cells(values)}
    if len(systems) > 1:
        raise InputError(f"{values} describe {len(systems)} systems; give one")
    return systems.pop()
