"""Accuracy, size and time of each system over git revisions, from stored runs, and the revisions of steps.

A step is a run that `bench check` with its usual limits would not call the same as the reference: the first run of the
system, or the run of the last step. So a slow change is a step, too, where it leaves these limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from bench.grammar.options import options
from bench.reading import gate
from bench.reading.frame import grouped
from bench.reports.contexts import Part, Section
from bench.reports.figures import bars, look, new_figure, plain, save
from bench.values.measures import OF_SYSTEMS, Interval, Measure, percent, text
from bench.values.result import Result
from bench.values.table import Table, rows_of

PANELS = {  # each measure, by the alarms on it
    "worse|better|changed|other": percent("accuracy", "accuracy %", ends="accuracy"),
    "larger": OF_SYSTEMS[0],
    "slower": Measure("predict_relative", "time, x reference", form=".2f"),
}
COLUMNS = (*map(text, ("system", "revision", "before")), text("step", "difference"))
CAPTION = (
    "{}: each stored revision, in the order of its runs. A ring marks a step: bench check with its usual limits would "
    "not report the same. Time is a multiple of the reference workload."
)


def history(results: Sequence[Result]) -> pd.DataFrame:
    """A row for each run of a system with several revisions, oldest first, with ``step``, empty or what differs."""
    systems: dict[tuple[str, ...], dict[str, Result]] = {}
    for r in results:  # the newest run of a revision counts, at its time
        revisions = systems.setdefault(tuple(str(r[name]) for name in gate.NAMES), {})
        revisions.pop(revision := r.get("git") or "unknown", None)
        revisions[revision] = r
    limits = {name: float(options("check")[name].default) for name in ("error", "slower")}
    rows = []
    for runs in (runs for runs in systems.values() if len(runs) > 1):
        level = (
            limits["error"] / 100 / (2 * len(runs) - 2)
        )  # of accuracy and labels, of each run but the first
        reference, before = None, ""
        for revision, r in runs.items():
            now, wrong, details = gate.measured(r, ""), (), ""
            if reference is not None:
                _, wrong, details, _ = gate.judge(reference, now, level, limits["slower"])
            step = f"{', '.join(wrong)}: {details}" if wrong else ""
            about = {
                "system": r.method,
                "revision": revision,
                "before": before,
                "step": step,
                "run_id": r["run_id"],
            }
            rows.append(about | {"started": pd.Timestamp(r["started"], unit="ms"), "result": r})
            reference, before = now if wrong or reference is None else reference, revision
    return pd.DataFrame(rows)


def section(results: Sequence[Result], folder: Path) -> tuple[Section | None, pd.DataFrame]:
    """A figure and a table of steps for each group of comparable runs; all runs as a table."""
    parts, tables = [], []
    for i, (name, members) in enumerate(grouped(results).items(), 1):
        table = history(members)
        if len(table):
            picture = save(drawn(table), folder, f"0-history-{i}", name, CAPTION.format(name))
            steps = Table(COLUMNS, rows_of(table[table["step"] != ""]))
            none = "" if len(steps) else f"{name}: no step."
            parts.append(
                Part(
                    picture, steps if len(steps) else None, f"{name}: steps", [none] if none else []
                )
            )
            numbers = [
                {m.name: _value(m.cell(r)) for m in PANELS.values()} for r in table["result"]
            ]
            tables.append(
                table.drop(columns="result").join(pd.DataFrame(numbers)).assign(group=name)
            )
    every = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    return Section(
        "Over revisions", parts, "accuracy, size and time of each stored revision"
    ) if parts else None, every


def _value(cell: object) -> object:
    return cell.value if isinstance(cell, Interval) else cell


def drawn(table: pd.DataFrame) -> Figure:
    """A panel for each measure, a line for each system, a ring at each step."""
    places = {
        name: i for i, name in enumerate(table.sort_values("started")["revision"].drop_duplicates())
    }
    figure, axes = new_figure((8.5, 6.5), (len(PANELS), 1), (0.7, 2.6, 1.1, 0.2), (0.7, 0.25))
    for i, (system, rows) in enumerate(table.groupby("system", sort=False)):
        at, style, wrong = rows["revision"].map(places), look(i), rows["step"].str.partition(":")[0]
        for ax, (alarms, measure) in zip(axes[:, 0], PANELS.items(), strict=True):
            cells = [measure.cell(r) for r in rows["result"]]
            values = pd.Series([_value(cell) for cell in cells], rows.index, dtype=float)
            ends = [
                (cell.low, cell.high) if isinstance(cell, Interval) else (None, None)
                for cell in cells
            ]
            low, high = (
                pd.Series(side, rows.index, dtype=float) for side in zip(*ends, strict=True)
            )
            ax.errorbar(
                at,
                values,
                yerr=bars(values, low, high),
                capsize=3,
                label=plain([system])[0],
                **style,
            )
            ring = {
                "marker": "o",
                "markersize": 14,
                "fillstyle": "none",
                "linestyle": "",
                "color": style["color"],
            }
            ax.plot(
                at[wrong.str.contains(alarms)],
                values[wrong.str.contains(alarms)],
                clip_on=False,
                **ring,
            )
    for ax, measure in zip(axes[:, 0], PANELS.values(), strict=True):
        ax.set(ylabel=measure.name, xticks=[*places.values()], xticklabels=[])
        ax.grid(alpha=0.3)
    axes[-1, 0].set_xticklabels(
        [name[:8] + "+" * ("+" in name) for name in places], rotation=45, ha="right"
    )
    axes[0, 0].legend(loc="upper left", bbox_to_anchor=(1.02, 1), frameon=False)
    return figure
