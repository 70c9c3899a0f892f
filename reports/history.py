"""Accuracy, size and time of each system over git revisions, from stored runs, and their steps.

A step is a run that `bench check` with its usual limits would not call the same as the reference:
the first run of the system, or the run of the last step. So a slow change is a step, too, where it
leaves these limits.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.grammar.options import command_options
from bench.reading import gate
from bench.reports.figures import error_bars, line_style, new_figure, save_figure, shorten_names
from bench.reports.sections import Exhibit
from bench.values.measures import OF_SYSTEMS, Interval, Measure, percent_measure, text_measure
from bench.values.result import Result
from bench.values.table import Table, rows_of_frame

PANELS = {  # each measure, by the alarms on it
    "worse|better|changed|other": percent_measure("accuracy", "accuracy %", ends="accuracy"),
    "larger": OF_SYSTEMS[0],
    "slower": Measure("predict_relative", "time, x reference", form=".2f"),
}
COLUMNS = (*map(text_measure, ("system", "revision", "before")), text_measure("step", "difference"))
HEADING = "Over revisions"
SUMMARY = "accuracy, size and time of each stored revision"
CAPTION = (
    "{}: each stored revision, in the order of its runs. A ring marks a step: bench check with its "
    "usual limits would not report the same. Time is a multiple of the reference workload."
)


def find_steps(results: Sequence[Result]) -> pd.DataFrame:
    """A row for each run of a system with several revisions, oldest first, with its ``step``."""
    systems: dict[tuple[str, ...], dict[str, Result]] = {}
    for r in results:  # the newest run of a revision counts, at its time
        revisions = systems.setdefault(tuple(str(r[name]) for name in gate.KEY_TAGS), {})
        revisions.pop(revision := r.get("git") or "unknown", None)
        revisions[revision] = r
    options = command_options("check")
    error, slower = (float(options[name].default) for name in ("error", "slower"))
    rows = []
    for runs in (runs for runs in systems.values() if len(runs) > 1):
        # The error rate is shared by accuracy and labels of each run but the first.
        level, reference, before = error / 100 / (2 * len(runs) - 2), None, ""
        for revision, r in runs.items():
            record, alarms, details = gate.record_of_result(r, ""), (), ""
            if reference is not None:
                _, alarms, details, _ = gate.judge_system(reference, record, level, slower)
            row = {
                "system": r.system_with_seed,
                "revision": revision,
                "before": before,
                "step": f"{', '.join(alarms)}: {details}" if alarms else "",
                "run_id": r["run_id"],
                "started": pd.Timestamp(r["started"], unit="ms"),
                "result": r,
            }
            rows.append(row)
            if alarms or reference is None:
                reference = record
            before = revision
    return pd.DataFrame(rows)


def history_exhibits(tables: Mapping[str, pd.DataFrame], folder: Path) -> list[Exhibit]:
    """A figure and a table of steps for each group of runs (`find_steps` by group)."""
    exhibits = []
    for i, (group, table) in enumerate(tables.items(), 1):
        caption = CAPTION.format(group)
        picture = save_figure(draw_history(table), folder, f"0-history-{i}", group, caption)
        steps = rows_of_frame(table[table["step"] != ""])
        table_of_steps = Table(COLUMNS, steps) if steps else None
        sentences = [] if steps else [f"{group}: no step."]
        exhibit = Exhibit(HEADING, picture, table_of_steps, f"{group}: steps", sentences, SUMMARY)
        exhibits.append(exhibit)
    return exhibits


def history_sheet(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """All rows with their numbers, for a CSV file."""
    parts = [pd.DataFrame()]
    for group, table in tables.items():
        numbers = {m.name: measured_values(m, table["result"])[:, 0] for m in PANELS.values()}
        parts.append(table.drop(columns="result").assign(**numbers, group=group))
    return pd.concat(parts, ignore_index=True)


def measured_values(measure: Measure, results: Iterable[Result]) -> np.ndarray:
    """Value and ends of the interval of each result [results, 3]; NaN for what it has not."""
    values: list[tuple[Any, ...]] = []
    for r in results:
        value = measure.value_of_row(r)
        values.append(tuple(value) if isinstance(value, Interval) else (value, None, None))
    return np.array(values, dtype=float)


def draw_history(table: pd.DataFrame) -> Figure:
    """A panel for each measure, a line for each system, a ring at each step."""
    revisions = table.sort_values("started")["revision"].drop_duplicates().tolist()
    figure, axes = new_figure((8.5, 6.5), (len(PANELS), 1), (0.7, 2.6, 1.1, 0.2), (0.7, 0.25))
    ring = {"marker": "o", "markersize": 14, "fillstyle": "none", "linestyle": ""}
    for i, (system, rows) in enumerate(table.groupby("system", sort=False)):
        places, style = rows["revision"].map(revisions.index).to_numpy(), line_style(i)
        label = shorten_names([system])[0]
        for ax, (alarms, measure) in zip(axes[:, 0], PANELS.items(), strict=True):
            values, low, high = measured_values(measure, rows["result"]).T
            ends = error_bars(values, low, high)
            ax.errorbar(places, values, yerr=ends, capsize=3, label=label, **style)
            steps = rows["step"].str.partition(":")[0].str.contains(alarms).to_numpy()
            ax.plot(places[steps], values[steps], clip_on=False, color=style["color"], **ring)
    for ax, measure in zip(axes[:, 0], PANELS.values(), strict=True):
        ax.set(ylabel=measure.name, xticks=range(len(revisions)), xticklabels=[])
        ax.grid(alpha=0.3)
    labels = [re.sub(r"([0-9a-f]{8})[0-9a-f]*(\+?)\w*", r"\1\2", name) for name in revisions]
    axes[-1, 0].set_xticklabels(labels, rotation=45, ha="right")
    axes[0, 0].legend(loc="upper left", bbox_to_anchor=(1.02, 1), frameon=False)
    return figure
