"""Figures of circumstances: curves over a level or a time, and losses under faults. Systems differ by dashes, too."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from bench.reports.figures import error_bars, line_style, new_figure, set_log_ticks, shorten_names
from bench.values.result import Result

NAME = 36  # characters of a line of a method's name
PUBLISHED_PER_SECOND = (6, 9)  # decisions of the systems in the literature


def draw_levels(key: str, noun: str, results: Sequence[Result]) -> Figure:
    """Accuracy against the level of a circumstance, a line for each system and case."""
    lines = []
    for i, r in enumerate(results):
        for case, curve in r.tables[key].groupby("case", sort=False):
            lines.append(
                (i, r.system_with_seed if case == key else f"{r.system_with_seed}, {case}", curve)
            )
    return draw_curves(noun, lines, [r["accuracy"] for r in results])


def draw_curves(
    noun: str,
    lines: Sequence[tuple[int, str, pd.DataFrame]],
    clean: Sequence[float] = (),
    title: str = "",
    inches: float = 5.2,
) -> Figure:
    """Shares by ``level`` with intervals, each with the number and the name of its system; clean accuracy is dotted.

    The axes are so many ``inches`` wide.
    """
    figure, axes = new_figure((inches + 3.3, 4.2), margins=(0.7, 2.6, 0.6, 0.35), title=title)
    ax = axes[0, 0]
    for i, name, curve in lines:
        curve = curve.sort_values("level")
        middle, low, high = (100 * curve[end].to_numpy() for end in ("accuracy", "low", "high"))
        ends = error_bars(middle, low, high)
        ax.errorbar(
            curve["level"],
            middle,
            yerr=ends,
            capsize=3,
            markersize=5,
            label=shorten_names([name])[0],
            **line_style(i),
        )
    for i, accuracy in enumerate(clean):
        ax.axhline(100 * accuracy, color=f"C{i % 10}", linewidth=0.8, linestyle=":")
    ax.set(xlabel=noun, ylabel="correctly classified captures, %")
    ax.grid(alpha=0.3)
    ax.legend(loc="upper left", bbox_to_anchor=(1.02, 1), frameon=False)
    return figure


def draw_heat_map(losses: pd.DataFrame, clean: Sequence[float], context: str) -> Figure:
    """Mean loss of accuracy over severities, a row for each method and a column for each fault, costliest first."""
    points = 100 * losses[losses.mean().sort_values(ascending=False, kind="stable").index]
    methods, faults = points.shape
    figure = Figure(figsize=(3.6 + 0.43 * faults, 1.9 + 0.5 * methods), layout="constrained")
    ax = figure.subplots()
    edges = np.arange(faults + 1) - 0.5, np.arange(methods + 1) - 0.5
    limits = {"vmin": min(0, points.min().min()), "vmax": max(points.max().max(), 1)}
    image = ax.pcolormesh(*edges, points, cmap="Greys", edgecolors="white", linewidth=1.5, **limits)
    ax.invert_yaxis()
    for i, j in np.ndindex(methods, faults):
        value = points.iloc[i, j]
        text = "-" if np.isnan(value) else f"{value:.0f}".replace("-0", "0")
        ax.text(
            j,
            i,
            text,
            ha="center",
            va="center",
            color="white" if image.norm(value) > 0.55 else "black",
        )
    words = [fault.replace("_", " ") for fault in points.columns]
    ax.set_xticks(range(faults), words, rotation=40, ha="right", rotation_mode="anchor")
    names = [f"{m} ({100 * c:.0f} % clean)" for m, c in zip(points.index, clean, strict=True)]
    ax.set_yticks(range(methods), [fill(name, NAME) for name in names])
    figure.suptitle(
        f"Points of accuracy lost under each fault, mean over five severities\n{context}",
        fontsize=10,
    )
    return figure


def draw_touch_seen(results: Sequence[Result]) -> Figure:
    """Accuracy against time seen, and fixed windows beside adaptive stopping, of comparable results.

    Left, the shade behind a line is the t-interval over subjects. Right, the line joins fixed windows, dashes join the
    thresholds of adaptive stopping, and the star with its interval is the threshold learned on training subjects.
    """
    figure = Figure(figsize=(11, 5.1 + 0.22 * len(results)), layout="constrained")
    seen, mean = axes = figure.subplots(1, 2, sharey=True)
    begin = (
        "from the onset"
        if results[0]["stream.start"] == "onset"
        else "from the middle of the capture"
    )
    data, subset, protocol = results[0].context
    seen.set_title(f"{data}, {subset}\n{protocol}", fontsize=9)
    mean.set_title(f"{begin}\nfixed windows and adaptive stopping", fontsize=9)
    seen.set(
        xlabel="ms of touch seen; a capture that has ended keeps its label",
        ylabel="correctly classified captures, %",
    )
    mean.set(xlabel="mean ms of touch seen before the label")
    seen.axvspan(*(1000 / rate for rate in PUBLISHED_PER_SECOND[::-1]), color="0.85", zorder=0)
    entries: dict[str, Line2D | Rectangle] = {}
    dashed = {"linestyle": "--", "markerfacecolor": "white", "linewidth": 1}
    star = {"markersize": 14, "markeredgecolor": "black"}
    for i, r in enumerate(results):
        style = line_style(i) | {"markersize": 5}
        fixed, stopping, colour = r.tables["instants"], r.tables.get("stopping"), style["color"]
        (entries[r.system_with_seed],) = seen.plot(fixed["ms"], 100 * fixed["accuracy"], **style)
        seen.fill_between(
            fixed["ms"], 100 * fixed["low"], 100 * fixed["high"], alpha=0.12, color=colour
        )
        mean.plot(fixed["mean_ms"], 100 * fixed["accuracy"], **style | {"linestyle": "-"})
        if stopping is not None:
            stopping = stopping.sort_values("mean_ms")
            mean.plot(stopping["mean_ms"], 100 * stopping["accuracy"], **style | dashed)
            end, low, high = (
                100 * np.array([r.get(f"adaptive_{k}", np.nan)])
                for k in ("accuracy", "low", "high")
            )
            mean.errorbar(
                r["adaptive_ms"],
                end,
                yerr=error_bars(end, low, high),
                capsize=3,
                fmt="*",
                color=colour,
                zorder=5,
                **star,
            )
    entries[
        "left: one decision at published rates, {} to {} a second".format(*PUBLISHED_PER_SECOND)
    ] = Rectangle((0, 0), 1, 1, color="0.85")
    grey = {"color": "0.3"}
    entries["right: adaptive stopping, one point a threshold (line: fixed windows)"] = Line2D(
        [], [], marker="o", **grey, **dashed
    )
    words = "right: stopped at the threshold learned on training subjects"
    entries[words] = Line2D([], [], marker="*", linestyle="", **grey, **star)
    for ax in axes:
        ax.set_xscale("log")
        set_log_ticks(ax.xaxis)
        ax.grid(alpha=0.3)
    figure.legend(
        [*entries.values()],
        [*entries],
        loc="outside lower left",
        fontsize=8,
        frameon=False,
        handlelength=4,
    )
    return figure
