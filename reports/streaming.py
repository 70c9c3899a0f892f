"""Accuracy against touch seen: tables and figure of ``bench stream``, rebuilt from MLflow alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.errors import InputError
from bench.outcomes.comparable import Row, comparable, context_of, method_of
from bench.outcomes.store import Store
from reports.figures import DASHES, MARKERS, bars, log_ticks
from reports.spreadsheet import write_sheet

PUBLISHED_PER_SECOND = (6, 9)  # decisions of the systems in the literature
CONTEXT = ("system", "data", "synthetic", "subset", "target", "protocol_label", "start")  # of a run, in its tables
LEFT_LABEL = "ms of touch seen; a capture that has ended keeps its label"
RIGHT_LABEL = "mean ms of touch seen before the label"


def write_streaming(store: Store, run_ids: list[str], folder: Path) -> list[Path]:
    """Write ``streaming.csv``, ``stopping.csv`` and ``streaming.png`` / ``.svg`` of some runs.

    Args:
        store: store of the runs.
        run_ids: ids of parent runs of ``bench stream``; those without a successful fold are left out.
        folder: destination folder; it is created.

    Returns:
        The files written; none where there is nothing to show.

    Raises:
        InputError: the folder cannot be written.
    """
    runs = [store.run(run_id) for run_id in run_ids]
    rows = [
        stream_of(store, run.data.params | run.data.tags | run.data.metrics | {"run_id": run.info.run_id})
        for run in runs
    ]
    if not rows:
        return []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths = []
        for name, table in (("streaming", "instants"), ("stopping", "stopping")):
            contexts = [{k: row[k] for k in CONTEXT} for row in rows]
            parts = [row[table].assign(**c)[[*c, *row[table]]] for row, c in zip(rows, contexts, strict=True)]
            paths.append(folder / f"{name}.csv")
            write_sheet(pd.concat(parts, ignore_index=True), paths[-1])
        return paths + figure(rows, folder)
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e


def stream_of(store: Store, run: Row) -> dict[str, Any]:
    """A run with its tables ``instants`` and ``stopping``, and the learned point ``adaptive``."""
    tables = {n: pd.read_csv(store.fetched(run["run_id"], f"{n}.csv")) for n in ("instants", "stopping")}
    point = {"mean_ms": run["adaptive_ms"]}
    point |= {k: run.get(f"adaptive_{k}", np.nan) for k in ("accuracy", "low", "high")}
    return {**run, "start": run["stream.start"], "adaptive": point, **tables}


def figure(rows: list[dict[str, Any]], folder: Path) -> list[Path]:
    """Write the figure of `draw` as ``streaming.png`` and ``.svg``."""
    fig = draw(rows)
    paths = [folder / "streaming.png", folder / "streaming.svg"]
    for path in paths:
        fig.savefig(path, dpi=130)
    return paths


def draw(rows: list[dict[str, Any]]) -> Figure:
    """Accuracy against time seen, and fixed windows beside adaptive stopping; a row of panels for each comparable set.

    Left, the shade behind a line is the bootstrap interval over subjects. Systems differ by marker and dashes, not only
    by colour. Right, the line joins fixed windows, dashes join the thresholds of adaptive stopping, and the star with
    its interval is what stopping at the threshold learned on training subjects gives.

    Args:
        rows: rows from `stream_of`.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault((*comparable(row), row["start"]), []).append(row)
    systems = list(dict.fromkeys(method_of(row) for row in rows))
    fig = Figure(figsize=(11, 4.4 * len(groups) + 0.22 * (len(systems) + 3)), layout="constrained")
    axes = fig.subplots(len(groups), 2, squeeze=False, sharey="row")
    looks = {
        system: {"color": f"C{i % 10}", "marker": MARKERS[i % len(MARKERS)], "linestyle": DASHES[i % len(DASHES)]}
        for i, system in enumerate(systems)
    }
    for (seen, mean), members in zip(axes, groups.values(), strict=True):
        low, high = (1000 / rate for rate in PUBLISHED_PER_SECOND[::-1])
        seen.axvspan(low, high, color="0.85", zorder=0)
        for row in members:
            _lines(seen, mean, row, looks[method_of(row)] | {"markersize": 5})
        data, subset, protocol = context_of(members[0])
        begin = "from the onset" if members[0]["start"] == "onset" else "from the middle of the capture"
        seen.set_title(f"{data}, {subset}\n{protocol}", fontsize=9)
        mean.set_title(f"{begin}\nfixed windows and adaptive stopping", fontsize=9)
        seen.set(xlabel=LEFT_LABEL, ylabel="correctly classified captures, %")
        mean.set(xlabel=RIGHT_LABEL)
        for ax in (seen, mean):
            ax.set_xscale("log")
            log_ticks(ax.xaxis)
            ax.grid(alpha=0.3)
    handles = [
        *(Line2D([], [], **look) for look in looks.values()),
        Rectangle((0, 0), 1, 1, color="0.85"),
        Line2D([], [], color="0.3", marker="o", markerfacecolor="white", linestyle="--", linewidth=1),
        Line2D([], [], color="0.3", marker="*", markersize=13, markeredgecolor="black", linestyle=""),
    ]
    labels = [
        *systems,
        "left: one decision at published rates, {} to {} a second".format(*PUBLISHED_PER_SECOND),
        "right: adaptive stopping, one point a threshold (line: fixed windows)",
        "right: stopped at the threshold learned on training subjects",
    ]
    fig.legend(handles, labels, loc="outside lower left", fontsize=8, frameon=False, handlelength=4)
    return fig


def _lines(seen: Any, mean: Any, row: dict[str, Any], look: dict[str, Any]) -> None:
    """One system in both panels."""
    fixed, stopping, point = row["instants"], row["stopping"].sort_values("mean_ms"), row["adaptive"]
    seen.plot(fixed["ms"], 100 * fixed["accuracy"], **look)
    seen.fill_between(fixed["ms"], 100 * fixed["low"], 100 * fixed["high"], alpha=0.12, color=look["color"])
    mean.plot(fixed["mean_ms"], 100 * fixed["accuracy"], **look | {"linestyle": "-"})
    dashed = look | {"linestyle": "--", "markerfacecolor": "white", "linewidth": 1}
    mean.plot(stopping["mean_ms"], 100 * stopping["accuracy"], **dashed)
    accuracy, low, high = (100 * np.array([point[k]]) for k in ("accuracy", "low", "high"))
    star = {"fmt": "*", "markersize": 15, "color": look["color"], "markeredgecolor": "black", "zorder": 5}
    ends = None if np.isnan(low[0]) else bars(accuracy, low, high)
    mean.errorbar(point["mean_ms"], accuracy, yerr=ends, capsize=3, **star)
