"""Accuracy against touch seen: tables and figure of ``after=``, rebuilt from MLflow alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.comparable import alike
from bench.measures import Measure, percent, text
from bench.reports.contexts import context_words, contexts, scarce
from bench.reports.figures import DASHES, MARKERS, bars, log_ticks, save
from bench.reports.part import Part, Section
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table
from bench.work.stopping import NO_SAVING, saves

Same = Mapping[str, tuple[str, str]]  # parameters that comparable replays share (`bench.comparable.shared`)
PUBLISHED_PER_SECOND = (6, 9)  # decisions of the systems in the literature
EARLY = "Early decisions"  # heading
OVER_TIME = (  # columns of the table of replayed systems, after system and times
    percent("replay_accuracy", "whole"),
    percent("adaptive_accuracy", "adaptive", spare=1),
    Measure("adaptive_ms", "after ms", form=".0f", spare=1),
    Measure("replay_ms", "decision ms p50 / p95", ("replay_ms_p50", "replay_ms_p95")),
)
CAPTION = (
    "{}: accuracy in percent, mean over subjects, after given milliseconds of touch, and with adaptive stopping after "
    "a mean time of touch; computing time per decision."
)
CONTEXT = ("system", "data", "synthetic", "subset", "target", "protocol_label")  # of a run, in its tables
LEFT_LABEL = "ms of touch seen; a capture that has ended keeps its label"
RIGHT_LABEL = "mean ms of touch seen before the label"


def sheets(results: Sequence[Result]) -> dict[str, pd.DataFrame]:
    """Accuracy by instant of all systems, and of stopping at each threshold where it was learned."""
    made = {}
    for name, table in (("streaming", "instants"), ("stopping", "stopping")):
        parts = []
        for r in (r for r in results if table in r.tables):
            about = {k: r[k] for k in CONTEXT} | {"start": r["stream.start"]}
            parts.append(r.tables[table].assign(**about)[[*about, *r.tables[table]]])
        if parts:
            made[name] = pd.concat(parts, ignore_index=True)
    return made


def stream_section(
    results: Sequence[Result], folder: Path, same: Same, seen: Callable[[Sequence[Result]], list[Measure]]
) -> Section | None:
    """Accuracy against touch seen, and the result of stopping at the learned threshold; ``seen``: columns of times."""
    parts = []
    for i, (context, members) in enumerate(contexts(results, same, "replay_accuracy"), 1):
        caption = "Left: accuracy against milliseconds of touch. Right: fixed windows and adaptive stopping."
        picture = save(draw(members, same), folder, f"0-stream-{i}", context, f"{context}: {caption}")
        columns = [text("system", read=lambda r: r.method), *seen(members), *OVER_TIME]
        parts.append(Part(picture, Table(columns, members), CAPTION.format(context), scarce(members)))
    return Section(EARLY, parts) if parts else None


def early(results: Sequence[Result], same: Same) -> tuple[str, str] | None:
    """A sentence on the best replayed system with early decisions, on the first of all comparable captures."""
    for _, runs in contexts(results, same, "replay_accuracy"):
        runs = [r for r in runs if r.alone and np.isfinite(r.get("adaptive_accuracy", np.nan))]
        if runs:
            best = max(runs, key=lambda r: r["adaptive_accuracy"])
            told = {"context": context_words(best, same), "best": best, "nothing": "" if saves(best) else NO_SAVING}
            return EARLY, sentences("bench.reports", "sentences", "early", **told)[0]
    return None


def draw(results: Sequence[Result], same: Same) -> Figure:
    """Accuracy against time seen, and fixed windows beside adaptive stopping; a row of panels for each comparable set.

    Left, the shade behind a line is the t-interval over subjects. Right, the line joins fixed windows, dashes join the
    thresholds of adaptive stopping, and the star with its interval is the threshold learned on training subjects.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    groups: dict[tuple, list[Result]] = {}
    for r in results:
        groups.setdefault(alike(r, same), []).append(r)
    looks = {
        system: {"color": f"C{i % 10}", "marker": MARKERS[i % len(MARKERS)], "linestyle": DASHES[i % len(DASHES)]}
        for i, system in enumerate(dict.fromkeys(r.method for r in results))
    }
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
    entries = {system: Line2D([], [], **look) for system, look in looks.items()}
    published = "left: one decision at published rates, {} to {} a second".format(*PUBLISHED_PER_SECOND)
    entries[published] = Rectangle((0, 0), 1, 1, color="0.85")
    dashed = {"color": "0.3", "marker": "o", "markerfacecolor": "white", "linestyle": "--", "linewidth": 1}
    entries["right: adaptive stopping, one point a threshold (line: fixed windows)"] = Line2D([], [], **dashed)
    star = {"color": "0.3", "marker": "*", "markersize": 13, "markeredgecolor": "black", "linestyle": ""}
    entries["right: stopped at the threshold learned on training subjects"] = Line2D([], [], **star)
    place = {"loc": "outside lower left", "fontsize": 8, "frameon": False, "handlelength": 4}
    fig.legend([*entries.values()], [*entries], **place)
    return fig


def _lines(seen: Any, mean: Any, result: Result, look: dict[str, Any]) -> None:
    """One system in both panels."""
    fixed = result.tables["instants"]
    seen.plot(fixed["ms"], 100 * fixed["accuracy"], **look)
    seen.fill_between(fixed["ms"], 100 * fixed["low"], 100 * fixed["high"], alpha=0.12, color=look["color"])
    mean.plot(fixed["mean_ms"], 100 * fixed["accuracy"], **look | {"linestyle": "-"})
    if (stopping := result.tables.get("stopping")) is None:
        return
    stopping = stopping.sort_values("mean_ms")
    dashed = look | {"linestyle": "--", "markerfacecolor": "white", "linewidth": 1}
    mean.plot(stopping["mean_ms"], 100 * stopping["accuracy"], **dashed)
    accuracy, low, high = (100 * np.array([result.get(f"adaptive_{k}", np.nan)]) for k in ("accuracy", "low", "high"))
    star = {"fmt": "*", "markersize": 15, "color": look["color"], "markeredgecolor": "black", "zorder": 5}
    ends = None if np.isnan(low[0]) else bars(accuracy, low, high)
    mean.errorbar(result["adaptive_ms"], accuracy, yerr=ends, capsize=3, **star)
