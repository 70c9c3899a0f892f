"""The chart of the page: accuracy against one cost, with the Pareto front, the choice and the budget."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.measures import Cost, costs, costs_of
from bench.outcomes.choice import Choice, named
from bench.paired import interval
from bench.pareto import staircase
from bench.reports.figures import LINE, TEXT, TITLE, bars, log_ticks, new_figure, plain, spread, width_of
from bench.reports.summary import Summary
from bench.sentences import sentences
from bench.table import rows_of

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
MOST = 40  # candidates that are drawn, besides those of a front
NAMED = 16  # points of a chart that all have a name beside it
WHOLE = {"clip_on": False}  # all marks are within the axes
PANEL = 2.2, 5.6  # narrowest and widest panel in inches
WIDTH, HEIGHT = 7.8, 2.7  # inches of a chart beside the answer, with names, and of its axes
Drawn = tuple[Figure, str] | None


def marks(summary: Summary, models: Mapping[str, str], published: Collection[str]) -> pd.DataFrame:
    """The candidates that are drawn: ``name``, ``kind``, ``verdict``, ``chosen``, ``out``, and their numbers.

    ``kind`` is the mark of a candidate where that has a look of its own, such as ``C``, else ``published``, ``changed``
    (a published system with other parameters) or ``other``. ``out`` is True for candidates that a budget rules out.
    The numbers are ``accuracy`` with its interval (``low``, ``high``), and a column for each cost.
    """
    assert summary.choice is not None and summary.among is not None
    rows = drawn(summary.choice)
    subjects = summary.among.subjects.loc[rows.index].to_numpy(dtype=float)
    bounds = np.array([interval(row) for row in subjects]).clip(0, 100)
    kinds = []
    for row in rows_of(rows):
        kind = "changed" if models[row["system"]] in published else "other"
        kind = "published" if row["system"] in published else kind
        kinds.append(row["mark"] if row["mark"] in LOOKS else kind)
    made = {"name": [named(row) for row in rows_of(rows)], "kind": kinds, "verdict": rows["verdict"]}
    made |= {"chosen": rows.index == summary.choice.chosen, "out": rows["verdict"].str.startswith("ruled out")}
    made |= {"accuracy": rows["accuracy"], "low": bounds[:, 0], "high": bounds[:, 1]}
    return pd.DataFrame(made | {cost: rows[cost] for cost in summary.costs}, index=rows.index)


def drawn(choice: Choice) -> pd.DataFrame:
    """The most accurate candidates, with all that are on a front or chosen."""
    table = choice.table
    accuracy = table["accuracy"].to_numpy()
    burdens = {name: costs()[name].burden(table[name].to_numpy(float)) for name in costs_of("")}
    best = {i for burden in burdens.values() for i in table.index[staircase(accuracy, burden)]}
    best |= {choice.chosen, *table.sort_values("accuracy", ascending=False).index[:MOST]}
    return table[table.index.isin(best)]


def cost_chart(group: str, points: pd.DataFrame, cost: Cost, budget: float | None = None, left: int = 0) -> Drawn:
    """Accuracy against one cost, on a log axis unless the cost is linear, and the caption; None if it is unknown."""
    points, every = points[(points[cost.key] > 0) | points[cost.key].notna() & cost.linear], len(points)
    if not len(points):
        return None
    points = points.sort_values("accuracy", kind="stable")
    burden = cost.burden(points[cost.key].to_numpy(float))
    best = np.isin(np.arange(len(points)), staircase(points["accuracy"].to_numpy(), burden))
    names = points["name"].where(~points["chosen"], "choice: " + points["name"])
    points = points.assign(best=best, label=names.where(best | points["chosen"] | (len(points) <= NAMED), ""))
    room = width_of(points["label"]) + 0.3
    width = np.clip(WIDTH - 0.6 - room, *PANEL)
    high = max(HEIGHT, LINE * min(every, NAMED) + 0.2)
    figure, axes = new_figure((width + room + 0.6, high + 0.95), (1, 1), (0.6, room, 0.55, 0.4), title=group)
    _panel(axes[0, 0], points, cost, budget, (width, high))
    caption = sentences(
        *("bench.reports", "sentences", "chart"),
        kinds={*points["kind"]},
        chosen=points["chosen"].any(),
        budget=budget is not None,
        out=points["out"].any(),
        named=len(points) > NAMED,
        left=left,
    )
    return figure, caption[0]


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
        pale = {"alpha": 0.35 if point.out else 1, **WHOLE}
        ax.plot([x[i]] * 2, [y[i] - ends[0][i], y[i] + ends[1][i]], color="0.6", linewidth=0.8, zorder=1, **pale)
        style = {"markersize": 6, "markerfacecolor": face, "markeredgecolor": edges, **pale}
        ax.plot(x[i], y[i], marker, zorder=3, gid=TITLE + _about(point, cost), **style)
        if point.chosen:
            ring = {"markersize": 13, "markerfacecolor": "none", "markeredgewidth": 2, "markeredgecolor": CHOICE}
            ax.plot(x[i], y[i], "o", zorder=2.5, **ring, **WHOLE)
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
