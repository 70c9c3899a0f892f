"""Accuracy against touch seen, drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from bench.reports.figures import bars, log_ticks, look
from bench.result import Result, alike

PUBLISHED_PER_SECOND = (6, 9)  # decisions of the systems in the literature
LEFT_LABEL = "ms of touch seen; a capture that has ended keeps its label"
RIGHT_LABEL = "mean ms of touch seen before the label"


def draw(results: Sequence[Result], same: Mapping[str, tuple[str, str]]) -> Figure:
    """Accuracy against time seen, and fixed windows beside adaptive stopping; a row of panels for each comparable set.

    Left, the shade behind a line is the t-interval over subjects. Right, the line joins fixed windows, dashes join the
    thresholds of adaptive stopping, and the star with its interval is the threshold learned on training subjects.
    """
    groups: dict[tuple, list[Result]] = {}
    for r in results:
        groups.setdefault(alike(r, same), []).append(r)
    looks = {system: look(i) for i, system in enumerate(dict.fromkeys(r.method for r in results))}
    fig = Figure(figsize=(11, 4.4 * len(groups) + 0.22 * (len(looks) + 3)), layout="constrained")
    axes = fig.subplots(len(groups), 2, squeeze=False, sharey="row")
    for (seen, mean), members in zip(axes, groups.values(), strict=True):
        low, high = (1000 / rate for rate in PUBLISHED_PER_SECOND[::-1])
        seen.axvspan(low, high, color="0.85", zorder=0)
        for r in members:
            _lines(seen, mean, r, looks[r.method] | {"markersize": 5})
        data, subset, protocol = members[0].context
        begin = "from the onset" if members[0]["stream.start"] == "onset" else "from the middle of the capture"
        seen.set_title(f"{data}, {subset}\n{protocol}", fontsize=9)
        mean.set_title(f"{begin}\nfixed windows and adaptive stopping", fontsize=9)
        seen.set(xlabel=LEFT_LABEL, ylabel="correctly classified captures, %")
        mean.set(xlabel=RIGHT_LABEL)
        for ax in (seen, mean):
            ax.set_xscale("log")
            log_ticks(ax.xaxis)
            ax.grid(alpha=0.3)
    entries = {system: Line2D([], [], **style) for system, style in looks.items()}
    published = "left: one decision at published rates, {} to {} a second".format(*PUBLISHED_PER_SECOND)
    entries[published] = Rectangle((0, 0), 1, 1, color="0.85")
    dashed = {"color": "0.3", "marker": "o", "markerfacecolor": "white", "linestyle": "--", "linewidth": 1}
    entries["right: adaptive stopping, one point a threshold (line: fixed windows)"] = Line2D([], [], **dashed)
    star = {"color": "0.3", "marker": "*", "markersize": 13, "markeredgecolor": "black", "linestyle": ""}
    entries["right: stopped at the threshold learned on training subjects"] = Line2D([], [], **star)
    place = {"loc": "outside lower left", "fontsize": 8, "frameon": False, "handlelength": 4}
    fig.legend([*entries.values()], [*entries], **place)
    return fig


def _lines(seen: Any, mean: Any, result: Result, style: dict[str, Any]) -> None:
    """One system in both panels."""
    fixed = result.tables["instants"]
    seen.plot(fixed["ms"], 100 * fixed["accuracy"], **style)
    seen.fill_between(fixed["ms"], 100 * fixed["low"], 100 * fixed["high"], alpha=0.12, color=style["color"])
    mean.plot(fixed["mean_ms"], 100 * fixed["accuracy"], **style | {"linestyle": "-"})
    if (stopping := result.tables.get("stopping")) is None:
        return
    stopping = stopping.sort_values("mean_ms")
    dashed = style | {"linestyle": "--", "markerfacecolor": "white", "linewidth": 1}
    mean.plot(stopping["mean_ms"], 100 * stopping["accuracy"], **dashed)
    accuracy, low, high = (100 * np.array([result.get(f"adaptive_{k}", np.nan)]) for k in ("accuracy", "low", "high"))
    star = {"fmt": "*", "markersize": 15, "color": style["color"], "markeredgecolor": "black", "zorder": 5}
    ends = None if np.isnan(low[0]) else bars(accuracy, low, high)
    mean.errorbar(result["adaptive_ms"], accuracy, yerr=ends, capsize=3, **star)
