"""The chart of the page: accuracy against one cost, with the Pareto front, the choice and the budget."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.measures import Cost
from bench.pareto import staircase
from bench.reports.figures import LINE, TEXT, TITLE, bars, log_ticks, new_figure, plain, spread, width_of
from bench.sentences import sentences

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = {  # of a candidate: marker, face, edge
    "published": ("o", "tab:blue", "tab:blue"),
    "changed": ("o", "white", "tab:blue"),
    "other": ("s", "white", "tab:red"),
    "C": ("^", "tab:green", "tab:green"),
}
LOOKS = {"C"}  # marks of candidates that have a look of their own
CHOICE, BUDGET = "#2e8b57", "#b85c00"
NAMED = 16  # points of a chart that all have a name beside it
WHOLE = {"clip_on": False}  # all marks are within the axes
PANEL = 2.2, 5.6  # narrowest and widest panel in inches
WIDTH, HEIGHT = 7.8, 2.7  # inches of a chart beside the answer, with names, and of its axes
Drawn = tuple[Figure, str] | None


def cost_chart(group: str, points: pd.DataFrame, cost: Cost, budget: float | None = None, left: int = 0) -> Drawn:
    """Accuracy against one cost, on a log axis except for shares of captures, and the caption; None if it is unknown.

    Args:
        group: captures and protocol, in words.
        points: table of `bench.reports.candidates.marks`.
        cost: the cost.
        budget: its budget.
        left: number of systems that are not drawn.
    """
    part = points[(points[cost.key] > 0) | points[cost.key].notna() & cost.linear]
    if not len(part):
        return None
    part = _with_names(part.sort_values("accuracy", kind="stable"), cost)
    room = width_of(part["label"]) + 0.3
    width = np.clip(WIDTH - 0.6 - room, *PANEL)
    high = max(HEIGHT, LINE * min(len(points), NAMED) + 0.2)
    figure, axes = new_figure((width + room + 0.6, high + 0.95), (1, 1), (0.6, room, 0.55, 0.4), title=group)
    _panel(axes[0, 0], part, cost, budget, (width, high))
    return figure, _caption(part, budget is not None, left)


def _with_names(points: pd.DataFrame, cost: Cost) -> pd.DataFrame:
    """Points, whether each is on the front, and the name beside it, empty for none."""
    burden = cost.burden(points[cost.key].to_numpy(float))
    best = np.isin(np.arange(len(points)), staircase(points["accuracy"].to_numpy(), burden))
    names = points["name"].where(~points["chosen"], "choice: " + points["name"])
    shown = best | points["chosen"] | (len(points) <= NAMED)
    return points.assign(best=best, label=names.where(shown, ""))


def _caption(points: pd.DataFrame, budget: bool, left: int) -> str:
    """What is drawn, in sentences."""
    return sentences(
        *("bench.reports", "sentences", "chart"),
        kinds={*points["kind"]},
        chosen=points["chosen"].any(),
        budget=budget,
        out=points["out"].any(),
        named=len(points) > NAMED,
        left=left,
    )[0]


def _panel(ax: Axes, points: pd.DataFrame, cost: Cost, budget: float | None, inches: tuple[float, float]) -> None:
    """One cost; the names stand in a column on the right."""
    x, y = (points[c].to_numpy(float) for c in (cost.key, "accuracy"))
    ends = bars(y, points["low"], points["high"])
    low, right, edge = _limits(np.append(x, budget or x[0]), not cost.linear)
    ax.set_xscale("linear" if cost.linear else "log")
    if cost.linear:
        ax.locator_params("x", nbins=6)
    else:
        log_ticks(ax.xaxis, (1, 2, 5) if right < 200 * low else (1,))
        ax.minorticks_off()
    if budget is not None:
        ax.axvspan(budget, right if cost.better == "low" else low, color="0.94", zorder=0)
        ax.axvline(budget, color=BUDGET, linewidth=1.3, linestyle="--", zorder=1)
        side = "right" if edge - budget < budget - low else "left"
        place = ax.get_xaxis_transform()
        ax.text(budget, 1.02, f"budget {cost.amount(budget)}", color=BUDGET, ha=side, va="bottom", transform=place)
    lowest, highest = (y - ends[0]).min(), (y + ends[1]).max()  # no interval is cut off
    reach = max(highest - lowest, 5) * 0.53
    bottom, top = (lowest + highest) / 2 - reach, (lowest + highest) / 2 + reach
    ax.set(xlim=(low, right), ylim=(bottom, top), ylabel="correctly classified captures, %")
    ax.set_xlabel(textwrap.fill(cost.axis or cost.title, int((inches[0] + 0.8) / (TEXT * 0.0075))))
    best = staircase(y, cost.burden(x))
    ax.plot(x[best], y[best], color="0.2", linewidth=1, drawstyle="steps-post", zorder=2)
    for i, point in enumerate(points.itertuples()):
        marker, face, edges = MARKS[point.kind]
        pale = 0.35 if point.out else 1
        ax.plot(
            [x[i]] * 2,
            [y[i] - ends[0][i], y[i] + ends[1][i]],
            color="0.6",
            linewidth=0.8,
            alpha=pale,
            zorder=1,
            **WHOLE,
        )
        style = {"markersize": 6, "markerfacecolor": face, "markeredgecolor": edges, "alpha": pale, **WHOLE}
        ax.plot(x[i], y[i], marker, zorder=3, gid=TITLE + _about(point, cost), **style)
        if point.chosen:
            ring = {
                "markersize": 13,
                "markerfacecolor": "none",
                "markeredgewidth": 2,
                "markeredgecolor": CHOICE,
                **WHOLE,
            }
            ax.plot(x[i], y[i], "o", zorder=2.5, **ring)
    kept = np.flatnonzero(points["label"])
    gap = (top - bottom) * LINE / inches[1]
    heights = spread(y[kept], gap, bottom + gap / 2, top - gap / 2)
    for i, height, point in zip(kept, heights, points.iloc[kept].itertuples(), strict=True):
        style = {"fontweight": "bold" if point.best or point.chosen else "normal"}
        style["color"] = CHOICE if point.chosen else "0.45" if point.out else "black"
        ax.text(edge, height, plain([point.label])[0], va="center", **style)
        ax.plot([x[i], edge], [y[i], height], color="0.75", linewidth=0.5, zorder=1, clip_on=False)
    ax.grid(alpha=0.25)


def _limits(values: np.ndarray, log: bool) -> tuple[float, float, float]:
    """Both ends of an axis with some values, and the place of names right of it."""
    values = np.log10(values) if log else values
    middle, reach = (values.max() + values.min()) / 2, max(np.ptp(values), 0.5 if log else 2)
    low, right, edge = middle + np.array([-0.56, 0.56, 0.6]) * reach
    return (10**low, 10**right, 10**edge) if log else (low, right, edge)


def _about(point: object, cost: Cost) -> str:
    """The numbers of a mark."""
    bounds = "" if np.isnan(point.low) else f" [{point.low:.1f}, {point.high:.1f}]"
    return f"{point.name}: {point.accuracy:.1f}{bounds} %, {cost.amount(getattr(point, cost.key))}; {point.verdict}"
