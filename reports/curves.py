"""Figures of circumstances: curves over a level or a time, and losses under faults."""

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

NAME = 36  # characters of a line of a system's name
PUBLISHED_PER_SECOND = (6, 9)  # decisions of the systems in the literature


def draw_levels(key: str, noun: str, results: Sequence[Result]) -> Figure:
    """Accuracy against the level of a circumstance, a line for each system and case."""
    lines = []
    for i, r in enumerate(results):
        for case, curve in r.tables[key].groupby("case", sort=False):
            name = r.system_with_seed + f", {case}" * (case != key)
            lines.append((i, name, curve))
    return draw_curves(noun, lines, [r["accuracy"] for r in results])


def draw_curves(
    noun: str,
    lines: Sequence[tuple[int, str, pd.DataFrame]],
    clean: Sequence[float] = (),
    title: str = "",
    inches: float = 5.2,
) -> Figure:
    """Shares by ``level`` with intervals; clean accuracy is dotted.

    The axes are so many ``inches`` wide.
    """
    figure, axes = new_figure((inches + 3.3, 4.2), margins=(0.7, 2.6, 0.6, 0.35), title=title)
    ax = axes[0, 0]
    for i, name, curve in lines:
        curve = curve.sort_values("level")
        middle, low, high = (100 * curve[end].to_numpy() for end in ("accuracy", "low", "high"))
        style = line_style(i) | {"capsize": 3, "markersize": 5, "label": shorten_names([name])[0]}
        ax.errorbar(curve["level"], middle, yerr=error_bars(middle, low, high), **style)
    for i, accuracy in enumerate(clean):
        ax.axhline(100 * accuracy, color=f"C{i % 10}", linewidth=0.8, linestyle=":")
    ax.set(xlabel=noun, ylabel="correctly classified captures, %")
    ax.grid(alpha=0.3)
    ax.legend(loc="upper left", bbox_to_anchor=(1.02, 1), frameon=False)
    return figure


def draw_heat_map(losses: pd.DataFrame, clean: Sequence[float], context: str) -> Figure:
    """Mean loss over severities, a row for each system, a column for each fault, worst first."""
    points = 100 * losses[losses.mean().sort_values(ascending=False, kind="stable").index]
    systems, faults = points.shape
    figure = Figure(figsize=(3.6 + 0.43 * faults, 1.9 + 0.5 * systems), layout="constrained")
    ax = figure.subplots()
    edges = np.arange(faults + 1) - 0.5, np.arange(systems + 1) - 0.5
    limits = {"vmin": min(0, points.min().min()), "vmax": max(points.max().max(), 1)}
    image = ax.pcolormesh(*edges, points, cmap="Greys", edgecolors="white", linewidth=1.5, **limits)
    ax.invert_yaxis()
    for i, j in np.ndindex(systems, faults):
        value = points.iloc[i, j]
        text = "-" if np.isnan(value) else f"{value:.0f}".replace("-0", "0")
        colour = "white" if image.norm(value) > 0.55 else "black"
        ax.text(j, i, text, ha="center", va="center", color=colour)
    words = [fault.replace("_", " ") for fault in points.columns]
    ax.set_xticks(range(faults), words, rotation=40, ha="right", rotation_mode="anchor")
    names = [f"{m} ({100 * c:.0f} % clean)" for m, c in zip(points.index, clean, strict=True)]
    ax.set_yticks(range(systems), [fill(name, NAME) for name in names])
    title = f"Points of accuracy lost under each fault, mean over five severities\n{context}"
    figure.suptitle(title, fontsize=10)
    return figure


def draw_touch_seen(results: Sequence[Result]) -> Figure:
    """Accuracy against time seen, and fixed windows beside adaptive stopping.

    Left, the shade behind a line is the t-interval over subjects. Right, the line joins fixed
    windows, dashes join the thresholds of adaptive stopping, and the star with its interval is the
    threshold learned on training subjects.
    """
    figure = Figure(figsize=(11, 5.1 + 0.22 * len(results)), layout="constrained")
    seen, mean = axes = figure.subplots(1, 2, sharey=True)
    data, subset, protocol = results[0].context
    seen.set_title(f"{data}, {subset}\n{protocol}", fontsize=9)
    seen.set_xlabel("ms of touch seen; a capture that has ended keeps its label")
    seen.set_ylabel("correctly classified captures, %")
    seen.axvspan(*(1000 / rate for rate in PUBLISHED_PER_SECOND[::-1]), color="0.85", zorder=0)
    from_onset = results[0]["stream.start"] == "onset"
    start = "from the onset" if from_onset else "from the middle of the capture"
    mean.set_title(f"{start}\nfixed windows and adaptive stopping", fontsize=9)
    mean.set_xlabel("mean ms of touch seen before the label")
    dashed = {"linestyle": "--", "markerfacecolor": "white", "linewidth": 1}
    star = {"marker": "*", "linestyle": "", "markersize": 14, "markeredgecolor": "black"}
    entries: dict[str, Line2D | Rectangle] = {}
    for i, r in enumerate(results):
        style = line_style(i) | {"markersize": 5}
        fixed, stopping, colour = r.tables["instants"], r.tables.get("stopping"), style["color"]
        percent = 100 * fixed[["accuracy", "low", "high"]]
        (entries[r.system_with_seed],) = seen.plot(fixed["ms"], percent["accuracy"], **style)
        seen.fill_between(fixed["ms"], percent["low"], percent["high"], alpha=0.12, color=colour)
        mean.plot(fixed["mean_ms"], percent["accuracy"], **style | {"linestyle": "-"})
        if stopping is not None:
            stopping = stopping.sort_values("mean_ms")
            mean.plot(stopping["mean_ms"], 100 * stopping["accuracy"], **style | dashed)
            names = ("adaptive_accuracy", "adaptive_low", "adaptive_high")
            values = [100 * np.array([r.get(name, np.nan)]) for name in names]
            look = star | {"capsize": 3, "color": colour, "zorder": 5}
            mean.errorbar(r["adaptive_ms"], values[0], yerr=error_bars(*values), **look)
    rates = "left: one decision at published rates, {} to {} a second".format(*PUBLISHED_PER_SECOND)
    entries[rates] = Rectangle((0, 0), 1, 1, color="0.85")
    thresholds = "right: adaptive stopping, one point a threshold (line: fixed windows)"
    entries[thresholds] = Line2D([], [], marker="o", color="0.3", **dashed)
    learned = "right: stopped at the threshold learned on training subjects"
    entries[learned] = Line2D([], [], color="0.3", **star)
    for ax in axes:
        ax.set_xscale("log")
        set_log_ticks(ax.xaxis)
        ax.grid(alpha=0.3)
    place = {"loc": "outside lower left", "fontsize": 8, "frameon": False, "handlelength": 4}
    figure.legend([*entries.values()], [*entries], **place)
    return figure
