"""Touches in continuous recordings, on the page: a timeline, missed touches against false alarms, and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.comparable import notes_on
from bench.measures import Measure, percent
from bench.reports.contexts import context_words, contexts, scarce
from bench.reports.figures import DASHES, LINE, MARKERS, WIDEST, plain, save
from bench.reports.part import Part, Section
from bench.result import Result
from bench.sentences import sentences
from touchbench_streams.events import DOUBTFUL, FALSE_ALARM, matched
from touchbench_streams.fault_page import by_detector, fault_parts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHORTEST_S, LONGEST_S, TOUCHES = 60.0, 120.0, 6  # of a timeline, which shows so many touches where it can
TRUTH, REPORTED = 1.3, -0.5  # heights of the bars; the probability has 0 to 1
HIGH = 0.2  # of a bar
Same = Mapping[str, tuple[str, str]]
ALARMS = "false alarms per hour of background"
TOLD = (
    percent("touches_found", ends="touches_found"),
    Measure("fragments", form=".2f"),
    percent("end_correct", ends="end_correct"),
    Measure("false_alarms_per_hour", ends="false_alarms_per_hour"),
    Measure("latency_s_p50", form=".2f"),
)


def watch_section(results: Sequence[Result], folder: Path, same: Same) -> Section | None:
    """A figure for each group of comparable runs of ``bench watch``, and a sentence on each system.

    Args:
        results: results of ``bench watch``.
        folder: destination folder of the figures.
        same: parameters that comparable results share (`bench.comparable.shared`).
    """
    parts = []
    shown = [by_detector(r) for r in results if r.get("background_minutes", 0) > 0]  # else no alarms can be counted
    for i, (context, members) in enumerate(contexts(shown, same, "end_correct"), 1):
        figure, caption_of = watching_figure(members, same), f"{context}: {caption(members[0])}"
        picture = save(figure, folder, f"0-watch-{i}", context, caption_of)
        notes = dict.fromkeys(note for r in members for note in notes_on(r.system, str(r["data"])))
        parts.append(Part(picture, sentences=[*(sentence(r, same) for r in members), *notes]))
    parts += fault_parts(results, folder, same)
    return Section("Continuous touch", parts) if parts else None


def sentence(run: Result, same: Same) -> str:
    """The scores of a system: data, protocol and unit first."""
    found, reports, end, alarms, latency = (measure.of(run) for measure in TOLD)
    return sentences(
        *("touchbench_streams", "touches", "watched"),
        context=context_words(run, same),
        run=run,
        found=found,
        reports=reports,
        end=end,
        alarms=alarms,
        unit=ALARMS,
        latency=latency,
        few=scarce([run]),
    )[0]


def caption(result: Result) -> str:
    """The words below a figure whose timeline shows a system."""
    doubtful = bool((result.tables["predictions"]["kind"] == "doubtful").any())
    return sentences("touchbench_streams", "touches", "timeline", method=result.method, doubtful=doubtful)[0]


def watching_figure(results: Sequence[Result], same: Same) -> Figure:
    """The timeline of the first system, and the curve of each, in a marker and dashes of its own.

    Args:
        results: comparable results of ``bench watch``.
        same: parameters that they share.
    """
    figure = Figure(figsize=(WIDEST, 5.2 + LINE * len(results)), layout="constrained")
    timeline, curve = figure.subplots(2, 1)
    _timeline(timeline, results[0], same)
    for i, row in enumerate(results):
        look: dict[str, Any] = {"color": f"C{i % 10}", "marker": MARKERS[i % len(MARKERS)], "markersize": 4}
        points = row.tables["curve"].dropna()
        line = {"linestyle": DASHES[i % len(DASHES)], "label": plain([row.method])[0], "clip_on": False}
        curve.plot(points["false_alarms_per_hour"], 100 * points["missed"], **look, **line)
        star = look | {"marker": "*", "markersize": 14, "markeredgecolor": "black", "linestyle": "", "zorder": 5}
        curve.plot(
            [row.get("false_alarms_per_hour", np.nan)], [100 * (1 - row["touches_found"])], **star, clip_on=False
        )
    curve.set_xscale("symlog", linthresh=1, linscale=0.3)  # there may be no false alarm at all
    curve.set_xticks([0, 1, 2, 5, 10, 20, 50, 100, 200, 500], minor=False)
    curve.xaxis.set_major_formatter("{x:g}")
    ends = [value for row in results for value in row.tables["curve"]["false_alarms_per_hour"].dropna()]
    curve.set(xlim=(0, 1.05 * max([10, *ends])), ylim=(0, None), ylabel="missed touches, %", xlabel=ALARMS)
    curve.grid(alpha=0.25)
    figure.legend(loc="outside lower left", frameon=False, handlelength=4)
    return figure


def _timeline(ax: Axes, result: Result, same: Same) -> None:
    """True touches above, reported ones below, the probability of touch between."""
    table = result.tables["predictions"]
    rate_hz = frame_rate(table, result["background_minutes"])
    shown = table[(table["fold"] == table["fold"].iloc[0]) & (table["recording"] == 0)]
    of = {kind: part.reset_index(drop=True) for kind, part in shown.groupby("kind")}
    truth, doubtful, reports = (of.get(kind, shown.iloc[:0]) for kind in ("touch", "doubtful", "report"))
    touches, reports = matched(truth, reports, rate_hz, doubtful=doubtful)
    last = touches["end"].iloc[:TOUCHES].max() / rate_hz + 3 if len(touches) else 0.0
    length = min(float(np.clip(last, SHORTEST_S, LONGEST_S)), of["recording"]["end"].iloc[0] / rate_hz)
    touches, reports = (part[part[at] < length * rate_hz] for part, at in ((touches, "start"), (reports, "reported")))
    names = dict.fromkeys([*touches["gesture"], *reports["label"]])
    colours = {name: f"C{i % 10}" for i, name in enumerate(names)}
    for i, touch in enumerate(touches.itertuples()):
        words = touch.gesture + ("" if touch.found else " (missed)")
        _bar(ax, (touch.start / rate_hz, min(touch.end / rate_hz, length)), TRUTH, colours[touch.gesture], words, i % 2)
    for i, report in enumerate(reports.itertuples()):
        words = report.label if report.first == report.label else f"{report.first} → {report.label}"
        words += {FALSE_ALARM: " (false alarm)", DOUBTFUL: " (doubtful)"}.get(report.touch, "")
        span = (report.reported / rate_hz, min(max(report.end, report.reported) / rate_hz, length))
        _bar(ax, span, REPORTED, colours[report.label], words, -1 - i % 2)
    for start, end in zip(doubtful["start"] / rate_hz, doubtful["end"] / rate_hz, strict=True):
        ax.axvspan(min(start, length), min(end, length), color="0.93", linewidth=0, zorder=0)
        if start < length:
            ax.text(start, TRUTH, "?", va="center", ha="left", color="0.35")
    probability = of.get("probability", shown.iloc[:0])
    ax.fill_between(probability["reported"] / rate_hz, 0, probability["confidence"], color="0.8", linewidth=0)
    ax.plot(probability["reported"] / rate_hz, probability["confidence"], color="0.3", linewidth=0.8)
    ax.set_yticks([TRUTH, 1, 0, REPORTED], ["true touch", "1", "probability of touch   0", "reported touch"])
    ax.tick_params(axis="y", length=0)
    ax.axhline(1, color="0.8", linewidth=0.5, zorder=0)
    ax.set(xlim=(0, length), ylim=(REPORTED - 0.95, TRUTH + 0.95), xlabel="seconds of the recording")
    ax.set_title(f"{plain([result.method])[0]}\n{', '.join(plain([context_words(result, same)]))}")
    ax.spines[["top", "right", "left"]].set_visible(False)


def _bar(ax: Axes, span: tuple[float, float], height: float, colour: str, words: str, line: int) -> None:
    """A touch, and its words above it (line 0 or 1) or below it (-1 or -2)."""
    start, end = span
    ax.barh(height, max(end - start, 0.15), HIGH, start, color=colour, edgecolor="0.2", linewidth=0.5)
    at = height + (0.2 + 0.3 * line if line >= 0 else -0.2 + 0.3 * (line + 1))
    side = "bottom" if line >= 0 else "top"
    ax.text(start, at, plain([words])[0], va=side, ha="left", color="black")


def frame_rate(predictions: pd.DataFrame, background_minutes: float) -> float:
    """Frames per second of the recordings of a run, from its table and the minutes of its background."""
    kinds = predictions["kind"]
    labelled, recording = predictions[kinds.isin(["touch", "doubtful"])], predictions[kinds == "recording"]
    frames = recording["end"].sum() - (labelled["end"] - labelled["start"]).sum()
    return float(frames / (60 * background_minutes))


def draw(result: Result, folder: Path, same: Same) -> None:
    """Draw a run into a folder; without background there is no rate, and nothing to draw."""
    if result.get("background_minutes"):
        group = ", ".join(result.context)
        save(watching_figure([result], same), folder, "watching", group, caption(result))
