"""The chart of the page: accuracy against one cost, with front, choice, budget, published number.

Its SVG has places in percent of the width and heights in pixels, so it fits every screen with words
of one size.
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
LEFT, WIDTH = 9.0, 86.0  # percent of the width: the lowest cost, and from there to the highest
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


class Axis(NamedTuple):
    """A range of values, or of their logarithms."""

    low: float
    high: float
    log: bool = False

    def relative_places(self, values: Any) -> Any:
        """Places of values, from 0 to 1."""
        values = np.log10(values) if self.log else np.asarray(values)
        return (values - self.low) / (self.high - self.low)

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Places and words of round values."""
        if self.log:
            multiples = (1, 2, 5) if self.high - self.low < 2.2 else (1,)
            locator = LogLocator(subs=multiples, numticks=99)
            values = locator.tick_values(10**self.low, 10**self.high)
        else:
            values = MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(self.low, self.high)
        ticks = [(float(self.relative_places(v)), format_three_digits(v)) for v in values]
        return [(place, words) for place, words in ticks if 0 <= place <= 1]


def chart_points(
    summary: Summary, models: Mapping[str, str], published: Collection[str]
) -> pd.DataFrame:
    """The candidates that are drawn: a row each, with their look and their numbers.

    ``kind`` is the mark of a candidate where that has a look of its own, such as ``C``, else
    ``published``, ``changed`` (a published system with other parameters) or ``other``. ``out`` is
    True for candidates that a budget rules out. The numbers are ``accuracy`` with its interval
    (``low``, ``high``), and a column for each cost.
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
    omitted: int = 0,
    best: tuple[str, str, float] | None = None,
) -> tuple[str, str] | None:
    """Draw accuracy against one cost, on a log axis unless the cost is linear.

    Args:
        group: captures and protocol in words.
        points: candidates (`chart_points`).
        cost: the cost.
        budget: its budget.
        omitted: number of candidates that are not drawn.
        best: source, system and percent of the best published number in the same setting.

    Returns:
        The SVG and its caption; None if the cost of every candidate is unknown.
    """
    points = points[(points[cost.key] > 0) | points[cost.key].notna() & cost.is_linear]
    if not len(points):
        return None
    points = points.sort_values("accuracy", kind="stable", ignore_index=True)
    x, y = points[cost.key].to_numpy(float), points["accuracy"].to_numpy(float)
    front = front_corners(y, cost.as_burden(x))
    ends = points[["low", "high"]].to_numpy(float)
    ends = np.where(np.isnan(ends), y[:, None], ends)
    across = _cost_axis(np.append(x, x[0] if budget is None else budget), cost.is_linear)
    up = _accuracy_axis(np.append(ends, best[-1] if best else y[0]))
    places = np.column_stack([_percent_across(across, x), _pixels_down(up, y)])
    named = np.flatnonzero(points["chosen"] | np.isin(np.arange(len(points)), front))
    sides = _place_names(places, [*points["name"]], named[::-1])
    heights = _pixels_down(up, ends)
    marks = []
    for i, point in enumerate(points.itertuples(index=False)):
        looks = {
            "hollow": point.kind == "changed",
            "chosen": point.chosen,
            "out": point.out,
            "front": i in front,
            "named": i in named,
        }
        mark = {
            "name": point.name,
            "about": _describe_point(point, cost),
            "x": places[i, 0],
            "y": places[i, 1],
            "low": heights[i, 0],
            "high": heights[i, 1],
            "side": sides[i],
            "looks": [look for look, applies in looks.items() if applies],
            "shape": Markup(SHAPES[point.kind if point.kind in LOOKS else point.family]),
        }
        marks.append(mark)
    synthetic = SYNTHETIC if "(synthetic)" in group else ""
    caption = render_sentences(
        *("bench.reports", "sentences", "chart"),
        kinds={*points["kind"]},
        interval=points["low"].notna().any(),
        families={*points["family"][~points["kind"].isin(LOOKS)]},
        chosen=points["chosen"].any(),
        budget=budget is not None,
        out=points["out"].any(),
        best=best,
        omitted=omitted,
        synthetic=f"Synthetic: {synthetic}." if synthetic else "",
    )[0]
    limit = published = None
    if budget is not None:
        limit = float(_percent_across(across, budget)), cost.format_amount(budget)
    if best is not None:
        published = best[0], best[-1], float(_pixels_down(up, best[-1]))
    drawing = render_fragment(
        "chart.jinja",
        about=f"{group}: {caption.split('. ')[0]}.",
        marks=marks,
        corners=places[front],
        limit=limit,
        better=cost.better,
        best=published,
        across=[(LEFT + WIDTH * place, words) for place, words in across.ticks],
        up=[(ABOVE + HEIGHT * (1 - place), words) for place, words in up.ticks],
        axis=textwrap.wrap(cost.axis, NARROW // LETTER - 12),
        synthetic=synthetic,
        bottom=ABOVE + HEIGHT,
    )
    return drawing, caption


def _percent_across(axis: Axis, values: Any) -> Any:
    """Places of costs in percent of the width."""
    return LEFT + WIDTH * axis.relative_places(values)


def _pixels_down(axis: Axis, values: Any) -> Any:
    """Places of accuracies in pixels from the top."""
    return ABOVE + HEIGHT * (1 - axis.relative_places(values))


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
    places: np.ndarray, names: Sequence[str], named: Sequence[int]
) -> list[tuple[str, int, int]]:
    """Anchor and shift in pixels of each name; the named ones cover each other the least."""
    sides = [PLACES[int(x > 50)] for x in places[:, 0]]
    spots, taken = places * [NARROW / 100, 1], np.empty((0, 4))

    def covered(i: int, side: tuple[str, int, int]) -> float:
        """Points and names below a name, and pixels beyond the edges."""
        left, top, right, bottom = name_box(i, side)
        x, y = spots.T
        inside = (x > left - 5) & (x < right + 5) & (y > top - 5) & (y < bottom + 5)
        beside = (taken[:, 0] > right) | (taken[:, 2] < left)
        beside |= (taken[:, 1] > bottom) | (taken[:, 3] < top)
        return inside.sum() + 10 * (~beside).sum() + max(0, -left, right - NARROW) / 10

    def name_box(i: int, side: tuple[str, int, int]) -> tuple[float, float, float, float]:
        width, (x, y), (anchor, right, down) = LETTER * len(names[i]), spots[i], side
        start = x + right - width * (anchor == "end")
        return start, y + down - LINE + 3, start + width, y + down + 3

    for i in named:
        sides[i] = min(PLACES, key=lambda side: covered(i, side))
        taken = np.vstack([taken, name_box(i, sides[i])])
    return sides


def _describe_point(point: Any, cost: Cost) -> str:
    """Name and numbers of a mark."""
    interval = "" if np.isnan(point.low) else f" [{point.low:.1f}, {point.high:.1f}]"
    amount = cost.format_amount(getattr(point, cost.key))
    return f"{point.name}: {point.accuracy:.1f}{interval} %, {amount}; {point.verdict}"
