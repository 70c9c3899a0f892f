"""The chart of the page as a figure: accuracy against each cost, with the Pareto front."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench import pareto
from reports.figures import LINE, bars, log_ticks, new_figure, plain, spread, width_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = {  # of a candidate: marker, face, edge
    "published": ("o", "tab:blue", "tab:blue"),
    "changed": ("o", "white", "tab:blue"),
    "other": ("s", "white", "tab:red"),
    "chip": ("^", "tab:green", "tab:green"),
}


def front(cost: np.ndarray, accuracy: np.ndarray) -> np.ndarray:
    """Positions of the points that no other beats in both, cheapest first; those without a cost are never among them.

    A point is beaten by one that is as cheap or cheaper and more accurate, or cheaper and as accurate.
    """
    on = np.flatnonzero(pareto.front(accuracy, cost))
    _, first = np.unique(cost[on], return_index=True)  # of equal points the first one
    return on[first]


def speed_chart(group: Mapping[str, Any], costs: list[str]) -> tuple[Figure, str]:
    """A panel for each cost on a log axis, with the Pareto front and the name of every point; and the caption.

    Args:
        group: group of `reports.candidates.chart_data`.
        costs: names of costs, as in the chart data.
    """
    points = pd.DataFrame(
        [{**p, **dict(zip(("accuracy", "low", "high"), p["y"], strict=True))} for p in group["points"]]
    )
    values = np.array([p["x"] for p in group["points"]], dtype=float)
    shown = [i for i in range(len(costs)) if (values[:, i] > 0).any()]
    high = max(2.8, LINE * len(points) + 0.2)
    rows = -(-len(shown) // 2)
    names = width_of(points["name"]) + 0.3
    size = (9.5 + 2 * names, (high + 0.55) * rows + 0.55)
    figure, axes = new_figure(size, (rows, 2), (0.6, names, 0.55, 0.4), (0.65 + names, 0.6), group["name"])
    for ax, i in zip(axes.flat, shown, strict=False):
        _panel(ax, points[values[:, i] > 0].assign(cost=values[values[:, i] > 0, i]), costs[i], high)
    for ax in [*axes.flat][len(shown) :]:
        ax.set_axis_off()
    return figure, (
        "Accuracy, mean over subjects with 95 % t-intervals, against each cost. Filled circles: published systems run "
        "here. Hollow circles: these with other settings. Squares: other systems. Triangles: measured in C. The line "
        "and the bold names show the Pareto front: no other system is both cheaper and more accurate."
        + (f" {group['left']} less accurate systems are not drawn." if group["left"] else "")
    )


def _panel(ax: Axes, points: pd.DataFrame, words: str, high: float) -> None:
    """One cost; the names stand in a column on the right."""
    points = points.astype({name: float for name in ("accuracy", "low", "high")}).sort_values("accuracy", kind="stable")
    x, y = points["cost"].to_numpy(), points["accuracy"].to_numpy()
    best, ends = front(x, y), bars(y, points["low"], points["high"])
    ax.errorbar(x, y, yerr=ends, fmt="none", ecolor="0.75", elinewidth=0.7, zorder=1)
    for kind, part in points.groupby("kind"):
        marker, face, edge = MARKS[str(kind)]
        ax.scatter(part["cost"], part["accuracy"], 34, face, marker=marker, zorder=3, edgecolors=edge)
    ax.plot(x[best], y[best], color="0.2", linewidth=1, drawstyle="steps-post", zorder=2)
    decades = np.log10(max(x.max() / x.min(), 3))
    middle = np.sqrt(x.max() * x.min())
    lowest, highest = (y - ends[0]).min(), (y + ends[1]).max()  # no interval is cut off
    reach = max(highest - lowest, 5) * 1.06
    low, top = (lowest + highest - reach) / 2, (lowest + highest + reach) / 2
    ax.set(xscale="log", xlim=(middle / 10 ** (0.56 * decades), middle * 10 ** (0.56 * decades)), ylim=(low, top))
    log_ticks(ax.xaxis, (1, 2, 5) if decades < 2 else (1,))
    gap, edge = (top - low) * LINE / high, middle * 10 ** (0.61 * decades)
    heights = spread(y, gap, low + gap / 2, top - gap / 2)
    for i, (name, height) in enumerate(zip(plain(points["name"]), heights, strict=True)):
        ax.text(edge, height, name, va="center", fontweight="bold" if i in best else "normal")
        ax.plot([x[i], edge], [y[i], height], color="0.7", linewidth=0.5, zorder=1, clip_on=False)
    ax.set(xlabel=words, ylabel="correctly classified captures, %")
    ax.grid(alpha=0.25)
