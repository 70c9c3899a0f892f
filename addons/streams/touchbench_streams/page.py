"""Exhibits of touches in recordings: timeline, missed touches by false alarms, faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.corpora.fault_names import NO_FAULT
from bench.reports.figures import DASHES, LINE, MARKERS, WIDEST, save_figure, shorten_names
from bench.reports.notes import few_subjects_notes
from bench.reports.sections import Exhibit, comparable_groups
from bench.values.measures import percent_measure, text_measure
from bench.values.result import Result, footnotes_of_system, setting_phrases
from bench.values.sentences import render_sentences
from bench.values.stability import concat_tables
from bench.values.table import Table, rows_of_frame
from touchbench_streams.columns import COLUMN_BY_KEY
from touchbench_streams.events import DOUBTFUL, FALSE_ALARM, match_reports
from touchbench_streams.stress import FAULT_SCORES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHORTEST_S, LONGEST_S = 60.0, 120.0  # of a timeline
TIMELINE_TOUCHES = 6  # that a timeline shows where it can
TRUTH_HEIGHT, REPORT_HEIGHT = 1.3, -0.5  # of the bars; the probability lies between 0 and 1
BAR_WIDTH = 0.2
SharedParameters = Mapping[str, tuple[str, str]]
HEADING = "Continuous touch"  # of the section of the page
ALARMS = "false alarms per hour of background"
ALARM_TICKS = [0, 1, 2, 5, 10, 20, 50, 100, 200, 500]
SENTENCE_SCORES = (
    "touches_found",
    "fragments",
    "end_correct",
    "false_alarms_per_hour",
    "latency_s_p50",
)
FAULT_SCORE_KEYS = (
    "touches_found",
    "first_correct",
    "end_correct",
    "false_alarms_per_hour",
    "fragments",
)
MIDDLE_SEVERITY = 3  # the one in the table of the page
FAULT_COLUMNS = (
    text_measure("system"),
    text_measure("case", "fault"),
    text_measure("amount", spare=1),
    *(COLUMN_BY_KEY[name] for name in FAULT_SCORE_KEYS),
    percent_measure("refused"),
)
FAULT_CAPTION = (
    "{}: touches in recordings of test subjects without faults, and under faults that came after "
    f"training, at severity {MIDDLE_SEVERITY} of 5. Means over subjects, 95 % intervals; refused "
    "is the percentage of frames after which the status has a reason not to trust the "
    "sensor. recordings_under_faults.csv has all severities."
)


def make_watch_exhibits(
    results: Sequence[Result], folder: Path, shared: SharedParameters
) -> list[Exhibit]:
    """A figure of each group of comparable runs with a sentence on each system, and fault tables.

    Runs are comparable if they have equal ``shared`` parameters. Runs without background are left
    out, as their false alarms cannot be counted.
    """
    exhibits = []
    with_background = [name_detector(r) for r in results if r.get("background_minutes", 0) > 0]
    groups = comparable_groups(with_background, shared, "end_correct")
    for i, (context, runs) in enumerate(groups, 1):
        figure = draw_watch_figure(runs, shared)
        caption = f"{context}: {timeline_caption(runs[0])}"
        picture = save_figure(figure, folder, f"0-watch-{i}", context, caption)
        sentences = [describe_run(run, shared) for run in runs]
        for run in runs:
            sentences += footnotes_of_system(run.system, str(run["data"]))
        exhibits.append(Exhibit(HEADING, picture, sentences=[*dict.fromkeys(sentences)]))
    return exhibits + make_fault_exhibits(results, shared)


def describe_run(run: Result, shared: SharedParameters) -> str:
    """The scores of a system in sentences: data, protocol and unit first."""
    (text, *_) = render_sentences(
        "touchbench_streams",
        "touches",
        "watched",
        context=context_words(run, shared),
        run=run,
        scores={name: COLUMN_BY_KEY[name].as_text(run) for name in SENTENCE_SCORES},
        unit=ALARMS,
        few=few_subjects_notes([run]),
    )
    return text


def context_words(run: Result, shared: SharedParameters) -> str:
    """Corpus and protocol of a run, and the shared parameters that are not at their default."""
    return ", ".join([*run.context, *setting_phrases(run, shared)])


def timeline_caption(result: Result) -> str:
    """The caption of a figure whose timeline shows a system."""
    is_doubtful = result.tables["predictions"]["kind"] == "doubtful"
    (text, *_) = render_sentences(
        "touchbench_streams",
        "touches",
        "timeline",
        method=result.system_with_seed,
        doubtful=bool(is_doubtful.any()),
    )
    return text


def draw_watch_figure(results: Sequence[Result], shared: SharedParameters) -> Figure:
    """Draw the timeline of the first of some comparable systems, and the curve of each."""
    figure = Figure(figsize=(WIDEST, 5.2 + LINE * len(results)), layout="constrained")
    timeline, curve = figure.subplots(2, 1)
    _draw_timeline(timeline, results[0], shared)
    star = {
        "marker": "*",
        "markersize": 14,
        "markeredgecolor": "black",
        "linestyle": "",
        "zorder": 5,
        "label": "",
    }
    most_alarms = 10.0
    for i, result in enumerate(results):
        points, style = result.tables["curve"].dropna(), line_style(i, result)
        curve.plot(points["false_alarms_per_hour"], 100 * points["missed"], **style)
        alarms = result.get("false_alarms_per_hour", np.nan)
        curve.plot(alarms, 100 * (1 - result["touches_found"]), **style | star)
        most_alarms = max([most_alarms, *result.tables["curve"]["false_alarms_per_hour"].dropna()])
    curve.set_xscale("symlog", linthresh=1, linscale=0.3)  # there may be no false alarm at all
    curve.set_xticks(ALARM_TICKS, minor=False)
    curve.xaxis.set_major_formatter("{x:g}")
    curve.set(xlim=(0, 1.05 * most_alarms), ylim=(0, None), ylabel="missed touches, %")
    curve.set_xlabel(ALARMS)
    curve.grid(alpha=0.25)
    figure.legend(loc="outside lower left", frameon=False, handlelength=4)
    return figure


def _draw_timeline(ax: Axes, result: Result, shared: SharedParameters) -> None:
    """Draw true touches above, reported ones below, and the probability of touch between them."""
    table = result.tables["predictions"]
    rate_hz = frame_rate(table, result["background_minutes"])
    table = table[(table["fold"] == table["fold"].iloc[0]) & (table["recording"] == 0)]
    rows = {kind: part.reset_index(drop=True) for kind, part in table.groupby("kind")}
    no_rows = table.iloc[:0]
    doubtful = rows.get("doubtful", no_rows)
    touches, reports = match_reports(
        rows.get("touch", no_rows), rows.get("report", no_rows), rate_hz, doubtful=doubtful
    )
    seconds = SHORTEST_S
    if len(touches):
        last_end = touches["end"].iloc[:TIMELINE_TOUCHES].max() / rate_hz
        seconds = float(np.clip(last_end + 3, SHORTEST_S, LONGEST_S))
    seconds = min(seconds, rows["recording"]["end"].iloc[0] / rate_hz)
    touches = touches[touches["start"] < seconds * rate_hz]
    reports = reports[reports["reported"] < seconds * rate_hz]
    names = dict.fromkeys([*touches["gesture"], *reports["label"]])
    colours = {name: f"C{i % 10}" for i, name in enumerate(names)}
    for i, touch in enumerate(touches.itertuples()):
        words = touch.gesture + ("" if touch.found else " (missed)")
        span = (touch.start / rate_hz, min(touch.end / rate_hz, seconds))
        _draw_touch(ax, span, TRUTH_HEIGHT, colours[touch.gesture], words, i % 2)
    for i, report in enumerate(reports.itertuples()):
        words = report.label if report.first == report.label else f"{report.first} → {report.label}"
        words += {FALSE_ALARM: " (false alarm)", DOUBTFUL: " (doubtful)"}.get(report.touch, "")
        end = max(report.end, report.reported)
        span = (report.reported / rate_hz, min(end / rate_hz, seconds))
        _draw_touch(ax, span, REPORT_HEIGHT, colours[report.label], words, -1 - i % 2)
    for start, end in zip(doubtful["start"] / rate_hz, doubtful["end"] / rate_hz, strict=True):
        ax.axvspan(min(start, seconds), min(end, seconds), color="0.93", linewidth=0, zorder=0)
        if start < seconds:
            ax.text(start, TRUTH_HEIGHT, "?", va="center", ha="left", color="0.35")
    probability = rows.get("probability", no_rows)
    times, confidence = probability["reported"] / rate_hz, probability["confidence"]
    ax.fill_between(times, 0, confidence, color="0.8", linewidth=0)
    ax.plot(times, confidence, color="0.3", linewidth=0.8)
    ax.set_yticks(
        [TRUTH_HEIGHT, 1, 0, REPORT_HEIGHT],
        ["true touch", "1", "probability of touch   0", "reported touch"],
    )
    ax.tick_params(axis="y", length=0)
    ax.axhline(1, color="0.8", linewidth=0.5, zorder=0)
    ax.set(xlim=(0, seconds), ylim=(REPORT_HEIGHT - 0.95, TRUTH_HEIGHT + 0.95))
    ax.set_xlabel("seconds of the recording")
    system, context = shorten_names([result.system_with_seed, context_words(result, shared)])
    ax.set_title(f"{system}\n{context}")
    ax.spines[["top", "right", "left"]].set_visible(False)


def _draw_touch(
    ax: Axes, span: tuple[float, float], height: float, colour: str, words: str, line: int
) -> None:
    """Draw a touch with its words in a line above (0 or 1) or below it (-1 or -2)."""
    start, end = span
    length = max(end - start, 0.15)
    ax.barh(height, length, BAR_WIDTH, start, color=colour, edgecolor="0.2", linewidth=0.5)
    offset, side = 0.2 + 0.3 * line, "bottom"
    if line < 0:
        offset, side = -0.2 + 0.3 * (line + 1), "top"
    text = shorten_names([words])[0]
    ax.text(start, height + offset, text, va=side, ha="left", color="black")


def frame_rate(predictions: pd.DataFrame, background_minutes: float) -> float:
    """Frames per second of the recordings of a run, from its table and its background."""
    labelled = predictions[predictions["kind"].isin(["touch", "doubtful"])]
    frames = predictions.loc[predictions["kind"] == "recording", "end"].sum()
    background_frames = frames - (labelled["end"] - labelled["start"]).sum()
    return float(background_frames / (60 * background_minutes))


def draw_watch_run(result: Result, folder: Path, shared: SharedParameters) -> None:
    """Draw a run into a folder; without background there is no rate, and nothing to draw."""
    if result.get("background_minutes"):
        figure = draw_watch_figure([result], shared)
        context = ", ".join(result.context)
        save_figure(figure, folder, "watching", context, timeline_caption(result))


def name_detector(result: Result) -> Result:
    """A copy whose system name includes its detector; of one from a file, without the folder."""
    detector = Path(result["watch.detector"]).name
    attributes = {**result.attributes, "system": f"{result['system']}, detector={detector}"}
    return Result(attributes, result.metrics, result.tables, result.errors)


def line_style(i: int, result: Result) -> dict[str, Any]:
    """How the line of a system looks in a figure."""
    return {
        "color": f"C{i % 10}",
        "marker": MARKERS[i % len(MARKERS)],
        "markersize": 4,
        "linestyle": DASHES[i % len(DASHES)],
        "label": shorten_names([result.system_with_seed])[0],
        "clip_on": False,
    }


def fault_rows(result: Result) -> list[dict[str, Any]]:
    """A row for each case of a run; the one without a fault comes first."""
    rows = [dict(row) for row in rows_of_frame(result.tables[FAULT_SCORES])]
    for row in rows:
        row["system"], row["case"] = result.system_with_seed, NO_FAULT
        if row["severity"]:
            row["case"] = f"{row['fault'].replace('_', ' ')} {row['severity']}"
    return rows


def runs_under_faults(results: Sequence[Result]) -> list[Result]:
    """The results of runs under faults, with their detectors in their names."""
    return [name_detector(r) for r in results if r.has_scores and r.get("watch.under")]


def fault_tables(results: Sequence[Result], shared: SharedParameters) -> Iterator[str | Table]:
    """All cases of each run under faults, and a line about them."""
    runs = runs_under_faults(results)
    for run in runs:
        title = f"{run.system_with_seed}, {context_words(run, shared)}, under faults after training"
        yield Table(FAULT_COLUMNS[1:], fault_rows(run), title)
    if runs:
        yield (
            "refused: percentage of frames after which the status has a reason not to trust the "
            "sensor"
        )


def fault_scores(results: Sequence[Result]) -> pd.DataFrame:
    """All cases of the runs under faults; empty without one."""
    return concat_tables(runs_under_faults(results), FAULT_SCORES)


def make_fault_exhibits(results: Sequence[Result], shared: SharedParameters) -> list[Exhibit]:
    """A table of each group of comparable runs under faults; arguments of `make_watch_exhibits`."""
    exhibits = []
    with_background = [r for r in runs_under_faults(results) if r.get("background_minutes")]
    for context, runs in comparable_groups(with_background, shared, "end_correct"):
        rows = [row for run in runs for row in fault_rows(run)]
        rows = [row for row in rows if row["severity"] in (0, MIDDLE_SEVERITY)]
        table, caption = Table(FAULT_COLUMNS, rows), FAULT_CAPTION.format(context)
        exhibits.append(Exhibit(HEADING, None, table, caption, few_subjects_notes(runs)))
    return exhibits
