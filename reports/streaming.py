"""Accuracy against touch seen: tables and figure of ``bench stream``, rebuilt from MLflow alone."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bench.errors import InputError
from bench.outcomes.comparable import comparable, context_of, method_of
from bench.outcomes.store import Store
from reports.figures import MARKERS
from reports.spreadsheet import write_sheet

DASHES = ("-", "--", "-.", ":")
PUBLISHED_PER_SECOND = (6, 9)  # decisions of the systems in the literature
TOLD = ("data", "synthetic", "subset", "target", "protocol_label", "start")  # of a run, in its tables


def write_streaming(store: Store, run_ids: list[str], folder: Path) -> list[Path]:
    """Write ``streaming.csv``, ``stopping.csv`` and ``streaming.png`` / ``.svg`` of some runs.

    Args:
        store: where they are.
        run_ids: of parent runs of ``bench stream``; those without a fold that went well are left out.
        folder: where they go; it is created.

    Returns:
        The files written; none where there is nothing to show.

    Raises:
        InputError: the folder cannot be written.
    """
    rows = [stream_of(store, run_id) for run_id in run_ids]
    if not rows:
        return []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths = []
        for name, table in (("streaming", "instants"), ("stopping", "stopping")):
            about = [{k: row[k] for k in ("system", *TOLD)} for row in rows]
            parts = [row[table].assign(**a)[[*a, *row[table]]] for row, a in zip(rows, about, strict=True)]
            paths.append(folder / f"{name}.csv")
            write_sheet(pd.concat(parts, ignore_index=True), paths[-1])
        return paths + figure(rows, folder)
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e


def stream_of(store: Store, run_id: str) -> dict[str, object]:
    """Tags of a run, its tables ``instants`` and ``stopping``, and the learned point ``adaptive``."""
    run = store.run(run_id)
    tables = {n: pd.read_csv(store.fetched(run_id, f"{n}.csv")) for n in ("instants", "stopping")}
    metrics = run.data.metrics
    point = {"mean_ms": metrics["adaptive_ms"]}
    point |= {k: metrics.get(f"adaptive_{k}", float("nan")) for k in ("accuracy", "low", "high")}
    about = run.data.tags | {"corpus_digest": run.data.params["corpus_digest"]}
    return about | {"start": run.data.params["stream.start"], "adaptive": point} | tables


def figure(rows: list[dict[str, object]], folder: Path) -> list[Path]:
    """Write what `draw` draws as ``streaming.png`` and ``.svg``."""
    fig = draw(rows)
    paths = [folder / "streaming.png", folder / "streaming.svg"]
    for path in paths:
        fig.savefig(path, dpi=130)
    return paths


def draw(rows: list[dict[str, object]]) -> object:
    """Accuracy against time seen, and fixed windows beside adaptive stopping; a row of panels for each comparable set.

    Left, the shade behind a line is the bootstrap interval over subjects. Systems differ by marker and dashes, not only
    by colour. Right, the line joins fixed windows, dashes join the thresholds of adaptive stopping, and the star with
    its interval is what stopping at the threshold learned on training subjects gives.

    Args:
        rows: as `stream_of` gives them.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import LogLocator, NullFormatter

    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault((*comparable(row), row["start"]), []).append(row)
    systems = list(dict.fromkeys(method_of(row) for row in rows))
    names = len(systems) + 3
    fig = Figure(figsize=(11, 4.4 * len(groups) + 0.22 * names), layout="constrained")
    axes = fig.subplots(len(groups), 2, squeeze=False, sharey="row")
    for (seen, mean), (group, members) in zip(axes, groups.items(), strict=True):
        low, high = (1000 / rate for rate in PUBLISHED_PER_SECOND[::-1])
        seen.axvspan(low, high, color="0.85", zorder=0)
        for row in members:
            kind = systems.index(method_of(row))
            look = {"color": f"C{kind % 10}", "marker": MARKERS[kind % len(MARKERS)], "markersize": 5}
            fixed, stopping, point = row["instants"], row["stopping"].sort_values("mean_ms"), row["adaptive"]
            seen.plot(fixed["ms"], 100 * fixed["accuracy"], DASHES[kind % len(DASHES)], **look)
            seen.fill_between(fixed["ms"], 100 * fixed["low"], 100 * fixed["high"], alpha=0.12, color=look["color"])
            mean.plot(fixed["mean_ms"], 100 * fixed["accuracy"], "-", **look)
            mean.plot(
                stopping["mean_ms"], 100 * stopping["accuracy"], "--", **look, markerfacecolor="white", linewidth=1
            )
            accuracy = 100 * point["accuracy"]
            bars = [[max(accuracy - 100 * point["low"], 0)], [max(100 * point["high"] - accuracy, 0)]]
            mean.errorbar(
                point["mean_ms"],
                accuracy,
                yerr=None if point["low"] != point["low"] else bars,
                fmt="*",
                markersize=15,
                color=look["color"],
                markeredgecolor="black",
                capsize=3,
                zorder=5,
            )
        data, subset, protocol = context_of(members[0])
        begin = "from the onset" if group[-1] == "onset" else "from the middle of the capture"
        seen.set_title(f"{data}, {subset}\n{protocol}", fontsize=9)
        mean.set_title(f"{begin}\nfixed windows and adaptive stopping", fontsize=9)
        seen.set_xlabel("ms of touch seen; a capture that has ended keeps its label")
        mean.set_xlabel("mean ms of touch seen before the label")
        seen.set_ylabel("captures labelled correctly, %")
        for ax in (seen, mean):
            ax.set_xscale("log")
            ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.xaxis.set_major_formatter("{x:g}")
            ax.xaxis.set_minor_formatter(NullFormatter())
            ax.grid(alpha=0.3)
    handles = [
        Line2D([], [], color=f"C{i % 10}", marker=MARKERS[i % len(MARKERS)], linestyle=DASHES[i % len(DASHES)])
        for i in range(len(systems))
    ]
    handles += [
        Rectangle((0, 0), 1, 1, color="0.85"),
        Line2D([], [], color="0.3", marker="o", markerfacecolor="white", linestyle="--", linewidth=1),
        Line2D([], [], color="0.3", marker="*", markersize=13, markeredgecolor="black", linestyle=""),
    ]
    told = [
        "left: one decision at published rates, {} to {} a second".format(*PUBLISHED_PER_SECOND),
        "right: adaptive stopping, one point a threshold (line: fixed windows)",
        "right: stopped at the threshold learned on training subjects",
    ]
    fig.legend(handles, systems + told, loc="outside lower left", fontsize=8, frameon=False, handlelength=4)
    return fig
