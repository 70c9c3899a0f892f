"""Touches in recordings, as shown: a timeline, missed touches against false alarms, sentences, and under faults."""

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
from touchbench_streams.events import DOUBTFUL, FALSE_ALARM, match_reports
from touchbench_streams.stress import FAULTS
from touchbench_streams.view import Continuous

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHORTEST_S, LONGEST_S, TOUCHES = (
    60.0,
    120.0,
    6,
)  # of a timeline, which shows so many touches where it can
TRUTH, REPORTED = 1.3, -0.5  # heights of the bars; the probability has 0 to 1
HIGH = 0.2  # of a bar
Same = Mapping[str, tuple[str, str]]
HEADING = "Continuous touch"  # of the section of the page
ALARMS = "false alarms per hour of background"
TOLD = (
    "touches_found",
    "fragments",
    "end_correct",
    "false_alarms_per_hour",
    "latency_s_p50",
)  # in a sentence
MIDDLE = 3  # severity in the table of the page
SHOWN = {measure.key: measure for measure in Continuous.columns}
COLUMNS = (
    text_measure("system"),
    text_measure("case", "fault"),
    text_measure("amount", spare=1),
    *(
        SHOWN[name]
        for name in (
            "touches_found",
            "first_correct",
            "end_correct",
            "false_alarms_per_hour",
            "fragments",
        )
    ),
    percent_measure("refused"),
)
CAPTION = (
    "{}: touches in recordings of test subjects as they are, and under faults that came after training, at severity "
    f"{MIDDLE} of 5. Means over subjects, 95 % intervals; refused are frames in which the detector refuses or many "
    "taxels are at full scale. recordings_under_faults.csv has all severities."
)


def watch_section(results: Sequence[Result], folder: Path, same: Same) -> list[Exhibit]:
    """A figure for each group of runs that share the parameters ``same``, a sentence on each system; faults, too."""
    exhibits = []
    shown = [
        by_detector(r) for r in results if r.get("background_minutes", 0) > 0
    ]  # else no alarms can be counted
    for i, (context, members) in enumerate(comparable_groups(shown, same, "end_correct"), 1):
        figure, caption_of = (
            watching_figure(members, same),
            f"{context}: {timeline_caption(members[0])}",
        )
        picture = save_figure(figure, folder, f"0-watch-{i}", context, caption_of)
        notes = dict.fromkeys(
            note for r in members for note in footnotes_of_system(r.system, str(r["data"]))
        )
        exhibits.append(
            Exhibit(HEADING, picture, sentences=[*(describe_run(r, same) for r in members), *notes])
        )
    return exhibits + fault_parts(results, same)


def describe_run(run: Result, same: Same) -> str:
    """The scores of a system: data, protocol and unit first."""
    told = {name: SHOWN[name].as_text(run) for name in TOLD}
    context, few = context_words(run, same), few_subjects_notes([run])
    return render_sentences(
        "touchbench_streams",
        "touches",
        "watched",
        context=context,
        run=run,
        told=told,
        unit=ALARMS,
        few=few,
    )[0]


def context_words(run: Result, same: Same) -> str:
    """Corpus and protocol of a run in words, and the shared parameters that differ from their usual values."""
    return ", ".join([*run.context, *setting_phrases(run, same)])


def timeline_caption(result: Result) -> str:
    """The words below a figure whose timeline shows a system."""
    doubtful = bool((result.tables["predictions"]["kind"] == "doubtful").any())
    return render_sentences(
        "touchbench_streams",
        "touches",
        "timeline",
        method=result.system_with_seed,
        doubtful=doubtful,
    )[0]


def watching_figure(results: Sequence[Result], same: Same) -> Figure:
    """The timeline of the first of some comparable systems, and the curve of each."""
    figure = Figure(figsize=(WIDEST, 5.2 + LINE * len(results)), layout="constrained")
    timeline, curve = figure.subplots(2, 1)
    _draw_timeline(timeline, results[0], same)
    for i, row in enumerate(results):
        points, look = row.tables["curve"].dropna(), look_of(i, row)
        curve.plot(points["false_alarms_per_hour"], 100 * points["missed"], **look)
        star = {
            "marker": "*",
            "markersize": 14,
            "markeredgecolor": "black",
            "linestyle": "",
            "zorder": 5,
            "label": "",
        }
        learned = row.get("false_alarms_per_hour", np.nan), 100 * (1 - row["touches_found"])
        curve.plot(*learned, **look | star)
    curve.set_xscale("symlog", linthresh=1, linscale=0.3)  # there may be no false alarm at all
    curve.set_xticks([0, 1, 2, 5, 10, 20, 50, 100, 200, 500], minor=False)
    curve.xaxis.set_major_formatter("{x:g}")
    ends = [
        value for row in results for value in row.tables["curve"]["false_alarms_per_hour"].dropna()
    ]
    curve.set(
        xlim=(0, 1.05 * max([10, *ends])), ylim=(0, None), ylabel="missed touches, %", xlabel=ALARMS
    )
    curve.grid(alpha=0.25)
    figure.legend(loc="outside lower left", frameon=False, handlelength=4)
    return figure


def _draw_timeline(ax: Axes, result: Result, same: Same) -> None:
    """True touches above, reported ones below, the probability of touch between."""
    table = result.tables["predictions"]
    rate_hz = frame_rate(table, result["background_minutes"])
    shown = table[(table["fold"] == table["fold"].iloc[0]) & (table["recording"] == 0)]
    of = {kind: part.reset_index(drop=True) for kind, part in shown.groupby("kind")}
    truth, doubtful, reports = (
        of.get(kind, shown.iloc[:0]) for kind in ("touch", "doubtful", "report")
    )
    touches, reports = match_reports(truth, reports, rate_hz, doubtful=doubtful)
    last = touches["end"].iloc[:TOUCHES].max() / rate_hz + 3 if len(touches) else 0.0
    length = min(
        float(np.clip(last, SHORTEST_S, LONGEST_S)), of["recording"]["end"].iloc[0] / rate_hz
    )
    touches, reports = (
        part[part[at] < length * rate_hz]
        for part, at in ((touches, "start"), (reports, "reported"))
    )
    names = dict.fromkeys([*touches["gesture"], *reports["label"]])
    colours = {name: f"C{i % 10}" for i, name in enumerate(names)}
    for i, touch in enumerate(touches.itertuples()):
        words = touch.gesture + ("" if touch.found else " (missed)")
        _draw_touch(
            ax,
            (touch.start / rate_hz, min(touch.end / rate_hz, length)),
            TRUTH,
            colours[touch.gesture],
            words,
            i % 2,
        )
    for i, report in enumerate(reports.itertuples()):
        words = report.label if report.first == report.label else f"{report.first} → {report.label}"
        words += {FALSE_ALARM: " (false alarm)", DOUBTFUL: " (doubtful)"}.get(report.touch, "")
        span = (report.reported / rate_hz, min(max(report.end, report.reported) / rate_hz, length))
        _draw_touch(ax, span, REPORTED, colours[report.label], words, -1 - i % 2)
    for start, end in zip(doubtful["start"] / rate_hz, doubtful["end"] / rate_hz, strict=True):
        ax.axvspan(min(start, length), min(end, length), color="0.93", linewidth=0, zorder=0)
        if start < length:
            ax.text(start, TRUTH, "?", va="center", ha="left", color="0.35")
    probability = of.get("probability", shown.iloc[:0])
    ax.fill_between(
        probability["reported"] / rate_hz, 0, probability["confidence"], color="0.8", linewidth=0
    )
    ax.plot(
        probability["reported"] / rate_hz, probability["confidence"], color="0.3", linewidth=0.8
    )
    ax.set_yticks(
        [TRUTH, 1, 0, REPORTED], ["true touch", "1", "probability of touch   0", "reported touch"]
    )
    ax.tick_params(axis="y", length=0)
    ax.axhline(1, color="0.8", linewidth=0.5, zorder=0)
    ax.set(
        xlim=(0, length), ylim=(REPORTED - 0.95, TRUTH + 0.95), xlabel="seconds of the recording"
    )
    ax.set_title(
        f"{shorten_names([result.system_with_seed])[0]}\n{', '.join(shorten_names([context_words(result, same)]))}"
    )
    ax.spines[["top", "right", "left"]].set_visible(False)


def _draw_touch(
    ax: Axes, span: tuple[float, float], height: float, colour: str, words: str, line: int
) -> None:
    """A touch, and its words above it (line 0 or 1) or below it (-1 or -2)."""
    start, end = span
    ax.barh(
        height, max(end - start, 0.15), HIGH, start, color=colour, edgecolor="0.2", linewidth=0.5
    )
    at = height + (0.2 + 0.3 * line if line >= 0 else -0.2 + 0.3 * (line + 1))
    side = "bottom" if line >= 0 else "top"
    ax.text(start, at, shorten_names([words])[0], va=side, ha="left", color="black")


def frame_rate(predictions: pd.DataFrame, background_minutes: float) -> float:
    """Frames per second of the recordings of a run, from its table and the minutes of its background."""
    kinds = predictions["kind"]
    labelled, recording = (
        predictions[kinds.isin(["touch", "doubtful"])],
        predictions[kinds == "recording"],
    )
    frames = recording["end"].sum() - (labelled["end"] - labelled["start"]).sum()
    return float(frames / (60 * background_minutes))


def draw_watch_run(result: Result, folder: Path, same: Same) -> None:
    """Draw a run into a folder; without background there is no rate, and nothing to draw."""
    if result.get("background_minutes"):
        group = ", ".join(result.context)
        save_figure(
            watching_figure([result], same), folder, "watching", group, timeline_caption(result)
        )


def by_detector(result: Result) -> Result:
    """The result under a name that also tells its detector; one of a file without its folder."""
    about = {
        **result.attributes,
        "system": f"{result['system']}, detector={Path(result['watch.detector']).name}",
    }
    return Result(about, result.metrics, result.tables, result.errors)


def look_of(i: int, result: Result) -> dict[str, Any]:
    """How the line of a system looks in a figure."""
    look = {"color": f"C{i % 10}", "marker": MARKERS[i % len(MARKERS)], "markersize": 4}
    return look | {
        "linestyle": DASHES[i % len(DASHES)],
        "label": shorten_names([result.system_with_seed])[0],
        "clip_on": False,
    }


def rows_under(result: Result) -> list[dict[str, Any]]:
    """A row for each case of a run, that without a fault first."""
    rows = [dict(row) for row in rows_of_frame(result.tables[FAULTS])]
    for row in rows:
        row["system"] = result.system_with_seed
        row["case"] = (
            f"{row['fault'].replace('_', ' ')} {row['severity']}" if row["severity"] else NO_FAULT
        )
    return rows


def under_faults(results: Sequence[Result]) -> list[Result]:
    """The results of runs under faults, with their detectors."""
    return [by_detector(r) for r in results if r.has_scores and r.get("watch.under")]


def printed_tables(results: Sequence[Result], same: Same) -> Iterator[str | Table]:
    """All cases of each run under faults, and a line about them."""
    for r in (shown := under_faults(results)):
        yield Table(
            COLUMNS[1:],
            rows_under(r),
            f"{r.system_with_seed}, {context_words(r, same)}, under faults after training",
        )
    if shown:
        yield "refused: percentage of frames that the detector refuses, or with a tenth of the taxels at full scale"


def fault_scores(results: Sequence[Result]) -> pd.DataFrame:
    """All cases of the runs under faults; empty without one."""
    return concat_tables(under_faults(results), FAULTS)


def fault_parts(results: Sequence[Result], same: Same) -> list[Exhibit]:
    """A table for each set of comparable runs under faults; arguments of `watch_section`."""
    exhibits = []
    counted = [
        r for r in under_faults(results) if r.get("background_minutes")
    ]  # else no alarms can be counted
    for context, members in comparable_groups(counted, same, "end_correct"):
        rows = [row for r in members for row in rows_under(r) if row["severity"] in (0, MIDDLE)]
        exhibits.append(
            Exhibit(
                HEADING,
                None,
                Table(COLUMNS, rows),
                CAPTION.format(context),
                few_subjects_notes(members),
            )
        )
    return exhibits
