"""Accuracy against every cost that is tracked, as figures and as data for the interactive chart of the page."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench import pareto
from bench.outcomes import statistics
from reports.figures import LINE, bars, log_ticks, new_figure, plain, spread, width_of

# Column of tracked metrics: words, and what it is divided by.
COSTS = {
    "predict_ms_p50": ("ms to label one capture (p50, one thread)", 1),
    "capture_decision_ms": ("ms until the label: touch observed and computing", 1),
    "fit_seconds": ("s to fit one fold, its search included", 1),
    "flash_bytes": ("kB of flash: learnt numbers, without code", 1e3),
    "ram_bytes": ("kB of RAM during one decision, 32 bits a number", 1e3),
    "peak_rss_bytes": ("MB, peak memory of the process", 1e6),
}
ON_CHIP = {
    "chip_flash_bytes": ("kB of flash as C on a Cortex-M4F, linked", 1e3),
    "chip_ram_bytes": ("kB of RAM as C, of the library touch.c without the program's own stack and buffers", 1e3),
    "chip_most_instructions": ("instructions of the costliest frame and its label as C", 1),
}
COSTS |= ON_CHIP

MARKS = {  # of a system: marker, face, edge
    "published": ("o", "tab:blue", "tab:blue"),
    "changed": ("o", "white", "tab:blue"),
    "other": ("s", "white", "tab:red"),
    "chip": ("^", "tab:green", "tab:green"),
}


def points(runs: pd.DataFrame, subjects: pd.DataFrame, papers: pd.DataFrame | None) -> pd.DataFrame:
    """One row per system of a group: accuracy with its interval over subjects, and costs, means over seeds.

    Args:
        runs: of the group.
        subjects: accuracy in percent [systems, subjects], from `bench.outcomes.runs.by_subject`.
        papers: `reports.comparison.published`, to tell which systems are published ones; None where none is.

    Returns:
        ``system``, ``accuracy``, ``low``, ``high`` (percent; NaN for a single subject), ``kind`` (of `MARKS`) and a
        column per cost; NaN where a cost is not known.
    """
    published = set() if papers is None else set(papers["system"]) - {""}
    models = runs.drop_duplicates("system").set_index("system")["model_name"]
    complete = runs[runs["status"] == "FINISHED"]
    costs = complete.reindex(columns=["system", *COSTS, "search_seconds"])
    costs["fit_seconds"] += costs.pop("search_seconds").fillna(0)
    costs = costs.groupby("system").mean()
    rows = []
    for system, accuracy in subjects.iterrows():
        low, high = statistics.interval(accuracy.to_numpy(dtype=float))
        row = {"system": system, "accuracy": accuracy.mean(), "low": max(low, 0), "high": min(high, 100)}
        row |= {"kind": kind_of(system, models[system], published)}
        rows.append(row | {c: costs.loc[system, c] / unit for c, (_, unit) in COSTS.items()})
    return pd.DataFrame(rows)


def chip_points(runs: pd.DataFrame, subjects: Callable[[pd.DataFrame], pd.DataFrame]) -> pd.DataFrame:
    """The same of systems as C, as far as it was measured: one row per system and bits.

    Args:
        runs: of the kind ``chip``, of a group.
        subjects: gives the accuracy of runs in percent [systems, subjects].
    """
    named = runs.assign(system="C, " + runs["chip.bits"] + " bits: " + runs["system"])
    measured = named.drop(columns=[c for c in COSTS if c not in ON_CHIP], errors="ignore")
    return points(measured, subjects(named), None).assign(kind="chip")


def front(cost: np.ndarray, accuracy: np.ndarray) -> np.ndarray:
    """Positions of the points that no other beats in both, cheapest first; those without a cost are never among them.

    A point is beaten by one that is as cheap or cheaper and more accurate, or cheaper and as accurate.
    """
    on = np.flatnonzero(pareto.front(accuracy, cost))
    _, first = np.unique(cost[on], return_index=True)  # of equal points the first one
    return on[first]


def kind_of(system: str, model: str, published: set[str]) -> str:
    """How a system is marked: ``published``, ``changed`` (published, other settings) or ``other``."""
    return "published" if system in published else "changed" if model in published else "other"


def speed_chart(table: pd.DataFrame, group: str, most: int = 20) -> tuple[Figure, str]:
    """A panel for each cost on a log axis, with the Pareto front and the name of every point; and the caption.

    Args:
        table: `points` of the group.
        group: captures and protocol, in words.
        most: systems that are drawn; half as many more if they are on a front.
    """
    on_front = {i for c in COSTS for i in front(table[c].to_numpy(), table["accuracy"].to_numpy())}
    kept = table[(np.arange(len(table)) < most) | table.index.isin(on_front)].iloc[: most + most // 2]
    shown = [c for c in COSTS if (kept[c] > 0).any()]
    high = max(2.8, LINE * len(kept) + 0.2)
    rows = -(-len(shown) // 2)
    names = width_of(kept["system"]) + 0.3
    size = (9.5 + 2 * names, (high + 0.55) * rows + 0.55)
    title = f"{group}\nfilled circles: published systems; hollow circles: with other settings; squares: others; "
    title += ("triangles: as C; " if (kept["kind"] == "chip").any() else "") + "line and bold names: Pareto front"
    figure, axes = new_figure(size, (rows, 2), (0.6, names, 0.55, 0.5), (0.65 + names, 0.6), title)
    for ax, cost in zip(axes.flat, shown, strict=False):
        _panel(ax, kept[kept[cost] > 0].reset_index(drop=True), cost, high)
    for ax in [*axes.flat][len(shown) :]:
        ax.set_axis_off()
    left = len(table) - len(kept)
    return figure, (
        "Mean over subjects of captures labelled correctly, with 95 % t-intervals over subjects, against each cost. "
        "Filled circles are published systems, run here; hollow circles are these with other settings, such as fewer "
        "epochs; hollow squares are others; triangles are what bench chip exported, with the labels of the C. "
        "The line and bold names are the Pareto front: no other system is both cheaper and more accurate. Seeds are "
        "averaged." + (f" {left} systems of lower accuracy are left out." if left else "")
    )


def _panel(ax: object, table: pd.DataFrame, cost: str, high: float) -> None:
    from matplotlib.collections import LineCollection

    x, y = table[cost].to_numpy(), table["accuracy"].to_numpy()
    best = front(x, y)
    ends = bars(y, table["low"], table["high"])
    ax.errorbar(x, y, yerr=ends, fmt="none", ecolor="0.75", elinewidth=0.7, zorder=1)
    for kind, (marker, face, edge) in MARKS.items():
        chosen = (table["kind"] == kind).to_numpy()
        ax.scatter(x[chosen], y[chosen], 34, face, marker=marker, zorder=3, edgecolors=edge)
    ax.plot(x[best], y[best], color="0.2", linewidth=1, drawstyle="steps-post", zorder=2)
    ax.set_xscale("log")
    decades = np.log10(max(x.max() / x.min(), 3))
    middle = np.sqrt(x.max() * x.min())
    edge = middle * 10 ** (0.61 * decades)  # names stand outside, on the right
    log_ticks(ax.xaxis, (1, 2, 5) if decades < 2 else (1,))
    lowest, highest = (y - ends[0]).min(), (y + ends[1]).max()  # no interval is cut off
    reach = max(highest - lowest, 5) * 1.06
    low, top = (lowest + highest - reach) / 2, (lowest + highest + reach) / 2
    ax.set(xlim=(middle / 10 ** (0.56 * decades), middle * 10 ** (0.56 * decades)), ylim=(low, top))
    gap = (top - low) * LINE / high
    order = np.argsort(y, kind="stable")
    heights = spread(y[order], gap, low + gap / 2, top - gap / 2)
    for i, height in zip(order, heights, strict=True):
        weight = "bold" if i in best else "normal"
        ax.text(edge, height, plain([table["system"][i]])[0], va="center", fontweight=weight)
    ties = [[(x[i], y[i]), (edge, height)] for i, height in zip(order, heights, strict=True)]
    ax.add_collection(LineCollection(ties, colors="0.7", linewidths=0.5, zorder=1, clip_on=False))
    ax.set(xlabel=COSTS[cost][0], ylabel="captures labelled correctly, %")
    ax.grid(alpha=0.25)
