"""The chart of the page: accuracy against one cost, with the Pareto front, the choice, the budget, published numbers.

It is an SVG whose places are percentages of its width and whose heights are pixels, so that it fits every screen with
words of one size.
"""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.ticker import LogLocator, MaxNLocator

from bench.reading.choice import Choice, candidate_name
from bench.reports.figures import SYNTHETIC
from bench.reports.layout import render_fragment
from bench.reports.summary import Summary, model_family
from bench.values.intervals import mean_interval
from bench.values.measures import Cost, all_costs, costs_of_run_kind, format_three_digits
from bench.values.pareto import front_corners
from bench.values.sentences import render_sentences
from bench.values.table import rows_of_frame

SHAPES = {  # of a family, around its point
    "features": '<circle r="5"/>',
    "networks": '<path d="M-5-5H5V5H-5z"/>',
    "own": '<path d="M0-6L6 5H-6z"/>',
    "C": '<path d="M0-7L6 0 0 7-6 0z"/>',
}
LOOKS = {"C"}  # marks of candidates that have a look of their own
MOST = 40  # candidates that are drawn, besides those of a front
HEIGHT, ABOVE = 290, 24  # pixels of the plot and above it
EDGES = 9.0, 95.0  # percent of the width from the lowest to the highest cost
NARROW = 430  # width in pixels at which names of the front and the choice still have room
LETTER, LINE = 7, 14  # pixels of a letter and of a line
PLACES = [
    ("start", 7, -8),
    ("end", -7, -8),
    ("end", -11, 4),
    ("start", 7, 17),
    ("end", -7, 17),
    ("start", 11, 4),
]
Drawn = tuple[str, str] | None


class Axis(NamedTuple):
    """A range of values, or of their logarithms."""

    low: float
    high: float
    log: bool = False

    def place(self, values: Any) -> Any:
        """Places of values, from 0 to 1."""
        return ((np.log10(values) if self.log else np.asarray(values)) - self.low) / (
            self.high - self.low
        )

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Places and words of round values."""
        if self.log:
            locator = LogLocator(
                subs=(1, 2, 5) if self.high - self.low < 2.2 else (1,), numticks=99
            )
            values = locator.tick_values(10**self.low, 10**self.high)
        else:
            values = MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(self.low, self.high)
        return [
            (float(self.place(v)), format_three_digits(v))
            for v in values
            if 0 <= self.place(v) <= 1
        ]


def chart_points(
    summary: Summary, models: Mapping[str, str], published: Collection[str]
) -> pd.DataFrame:
    """The candidates that are drawn: ``name``, ``family``, ``kind``, ``verdict``, ``chosen``, ``out``, their numbers.

    ``kind`` is the mark of a candidate where that has a look of its own, such as ``C``, else ``published``, ``changed``
    (a published system with other parameters) or ``other``. ``out`` is True for candidates that a budget rules out.
    The numbers are ``accuracy`` with its interval (``low``, ``high``), and a column for each cost.
    """
    assert summary.choice is not None
    rows = drawn_candidates(summary.choice)
    subjects = summary.choice.candidates.subjects.loc[rows.index].to_numpy(dtype=float)
    bounds = np.array([mean_interval(row) for row in subjects]).clip(0, 100)
    kinds = []
    for row in rows_of_frame(rows):
        kind = "changed" if models[row["system"]] in published else "other"
        kind = "published" if row["system"] in published else kind
        kinds.append(row["mark"] if row["mark"] in LOOKS else kind)
    points = {
        "name": [candidate_name(row) for row in rows_of_frame(rows)],
        "kind": kinds,
        "verdict": rows["verdict"],
        "family": [model_family(models[system]) for system in rows["system"]],
        "chosen": rows.index == summary.choice.chosen,
        "out": rows["verdict"].str.startswith("ruled out"),
        "accuracy": rows["accuracy"],
        "low": bounds[:, 0],
        "high": bounds[:, 1],
    }
    return pd.DataFrame(points | {cost: rows[cost] for cost in summary.costs}, index=rows.index)


def drawn_candidates(choice: Choice) -> pd.DataFrame:
    """The most accurate candidates, with all that are on a front or chosen."""
    table = choice.table
    accuracy = table["accuracy"].to_numpy()
    burdens = {
        name: all_costs()[name].as_burden(table[name].to_numpy(float))
        for name in costs_of_run_kind("")
    }
    best = {i for burden in burdens.values() for i in table.index[front_corners(accuracy, burden)]}
    best |= {choice.chosen, *table.sort_values("accuracy", ascending=False).index[:MOST]}
    return table[table.index.isin(best)]


def draw_cost_chart(
    group: str,
    points: pd.DataFrame,
    cost: Cost,
    budget: float | None = None,
    left: int = 0,
    best: tuple[str, str, float] | None = None,
) -> Drawn:
    """Accuracy against one cost as an SVG, on a log axis unless the cost is linear, and the caption; None if unknown.

    ``best`` is the best published number on the same data under the same protocol, behind its source and system.
    """
    points = points[(points[cost.key] > 0) | points[cost.key].notna() & cost.is_linear]
    if not len(points):
        return None
    points = points.sort_values("accuracy", kind="stable", ignore_index=True)
    x, y = (points[c].to_numpy(float) for c in (cost.key, "accuracy"))
    front = front_corners(y, cost.as_burden(x))
    ends = points[["low", "high"]].to_numpy(float)
    ends = np.where(np.isnan(ends), y[:, None], ends)
    across = _cost_axis(np.append(x, x[0] if budget is None else budget), cost.is_linear)
    up = _accuracy_axis(np.append(ends, best[-1] if best else y[0]))
    left_edge, width = EDGES[0], EDGES[1] - EDGES[0]
    places = np.column_stack(
        [left_edge + width * across.place(x), ABOVE + HEIGHT * (1 - up.place(y))]
    )
    kept = np.flatnonzero(points["chosen"] | np.isin(np.arange(len(points)), front))
    sides = _place_names(places, [*points["name"]], kept[::-1])
    high, low = (ABOVE + HEIGHT * (1 - up.place(ends[:, i])) for i in (1, 0))
    marks = []
    for i, point in enumerate(points.itertuples(index=False)):
        looks = {"hollow": point.kind == "changed", "chosen": point.chosen, "out": point.out}
        looks |= {"front": i in front, "named": i in kept}
        mark = {
            "name": point.name,
            "about": _describe_point(point, cost),
            "x": places[i, 0],
            "y": places[i, 1],
        }
        mark |= {
            "low": low[i],
            "high": high[i],
            "side": sides[i],
            "looks": [look for look, so in looks.items() if so],
        }
        marks.append(
            mark | {"shape": Markup(SHAPES[point.kind if point.kind in LOOKS else point.family])}
        )
    caption = render_sentences(
        *("bench.reports", "sentences", "chart"),
        kinds={*points["kind"]},
        interval=points["low"].notna().any(),
        families={*points["family"][~points["kind"].isin(LOOKS)]},
        chosen=points["chosen"].any(),
        budget=budget is not None,
        out=points["out"].any(),
        best=best,
        left=left,
        synthetic=f"Synthetic: {SYNTHETIC}." if "(synthetic)" in group else "",
    )[0]
    limit = (
        None
        if budget is None
        else (left_edge + width * float(across.place(budget)), cost.format_amount(budget))
    )
    text = render_fragment(
        "chart.jinja",
        about=f"{group}: {caption.split('. ')[0]}.",
        marks=marks,
        corners=places[front],
        limit=limit,
        better=cost.better,
        best=best and (best[0], best[-1], ABOVE + HEIGHT * (1 - float(up.place(best[-1])))),
        across=[(left_edge + width * place, words) for place, words in across.ticks],
        up=[(ABOVE + HEIGHT * (1 - place), words) for place, words in up.ticks],
        axis=textwrap.wrap(cost.axis, NARROW // LETTER - 12),
        synthetic=SYNTHETIC if "(synthetic)" in group else "",
        bottom=ABOVE + HEIGHT,
    )
    return text, caption


def _cost_axis(values: np.ndarray, linear: bool) -> Axis:
    """The axis of some costs."""
    values = values if linear else np.log10(values)
    middle, reach = (values.max() + values.min()) / 2, max(np.ptp(values), 2 if linear else 0.5) / 2
    return Axis(middle - reach, middle + reach, not linear)


def _accuracy_axis(values: np.ndarray) -> Axis:
    """The axis of some accuracies; no interval is cut off."""
    reach = max(np.ptp(values), 5) * 0.53
    middle = (values.max() + values.min()) / 2
    return Axis(middle - reach, middle + reach)


def _place_names(
    places: np.ndarray, names: Sequence[str], kept: Sequence[int]
) -> list[tuple[str, int, int]]:
    """Anchor and shift in pixels of each name; those that are kept cover each other and other points the least."""
    sides = [PLACES[int(x > 50)] for x in places[:, 0]]
    spots, taken = places * [NARROW / 100, 1], np.empty((0, 4))

    def cover(i: int, side: tuple[str, int, int]) -> float:
        left, top, right, bottom = box(i, side)
        within = (
            (spots[:, 0] > left - 5)
            & (spots[:, 0] < right + 5)
            & (spots[:, 1] > top - 5)
            & (spots[:, 1] < bottom + 5)
        )
        apart = (
            (taken[:, 0] > right)
            | (taken[:, 2] < left)
            | (taken[:, 1] > bottom)
            | (taken[:, 3] < top)
        )
        return within.sum() + 10 * (~apart).sum() + max(0, -left, right - NARROW) / 10

    def box(i: int, side: tuple[str, int, int]) -> tuple[float, float, float, float]:
        wide, (x, y), (anchor, right, down) = LETTER * len(names[i]), spots[i], side
        start = x + right - wide * (anchor == "end")
        return start, y + down - LINE + 3, start + wide, y + down + 3

    for i in kept:
        sides[i] = min(PLACES, key=lambda side: cover(i, side))
        taken = np.vstack([taken, box(i, sides[i])])
    return sides


def _describe_point(point: object, cost: Cost) -> str:
    """The numbers of a mark."""
    bounds = "" if np.isnan(point.low) else f" [{point.low:.1f}, {point.high:.1f}]"
    return f"{point.name}: {point.accuracy:.1f}{bounds} %, {cost.format_amount(getattr(point, cost.key))}; {point.verdict}"
