"""The figures of ``bench data show`` on recordings: pressure over time with the labels, durations and gaps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.corpora.recordings import DOUBT, Recordings
from bench.corpora.streams import StreamSurvey
from bench.reports.figures import Picture, new_figure, plain, save, short, width_of

if TYPE_CHECKING:
    from matplotlib.artist import Artist

DRAWN = 24  # recordings of a figure
POINTS = 1500  # of a line; of more frames, the highest of each part is drawn
HIGH, BETWEEN = 0.8, 0.27  # inches of a recording, and between two
ACROSS = 8  # gestures of a line of the key
DARK = "0.15"


def pictures(recordings: Recordings, found: StreamSurvey, group: str, folder: Path) -> list[Picture]:
    """The figures, as they were written.

    Args:
        recordings: the recordings.
        found: survey of them.
        group: the corpus, in words.
        folder: destination folder.
    """
    return [levels_figure(recordings, found, group, folder), durations_figure(found, group, folder)]


def levels_figure(recordings: Recordings, found: StreamSurvey, group: str, folder: Path) -> Picture:
    """Mean pressure over time, a panel for each recording, with the labels and the background that looks touched."""
    shown = min(DRAWN, len(recordings))
    rate_hz, labelled = recordings.corpus.rate_hz, recordings.labelled
    gestures = sorted(set(recordings.events["gesture"]))
    colours = {gesture: f"C{i % 10}" for i, gesture in enumerate(gestures)} | {DOUBT: "0.6"}
    rows = -(-len(colours) // ACROSS)
    key = 0.22 * (rows + 1) + 0.1
    size = (11.0, shown * HIGH + (shown - 1) * BETWEEN + 0.9 + key)
    figure, axes = new_figure(size, (shown, 1), (0.7, 0.15, 0.5, 0.4 + key), (0.7, BETWEEN))
    figure.suptitle(f"Mean pressure of each recording, {plain([group])[0]}", y=1 - 0.08 / size[1], va="top")
    longest = max(len(level) for level in found.levels[:shown]) / rate_hz
    drawn: dict[str, Artist] = {}
    lines: dict[str, Artist] = {}
    for i, ax in enumerate(axes[:, 0]):
        level, row = found.levels[i], found.recordings.iloc[i]
        mine = labelled[labelled["recording"] == i]
        for start, end, gesture in zip(mine["start"], mine["end"], mine["gesture"], strict=True):
            hatch = {"hatch": "////", "edgecolor": "white"} if gesture == DOUBT else {}
            span = ax.axvspan(
                start / rate_hz, end / rate_hz, color=None, facecolor=colours[gesture], alpha=0.35, **hatch
            )
            span.set_linewidth(0)
            drawn[gesture] = span
        starts = np.unique(np.arange(POINTS) * len(level) // POINTS)
        ax.plot((starts + 0.5) / rate_hz, np.maximum.reduceat(level, starts), color=DARK, linewidth=0.8)
        name = row.get("recording", i)
        for start, end in found.stretches.loc[found.stretches["recording"] == name, ["start", "end"]].to_numpy():
            (lines["background with the pressure of touches"],) = ax.plot(
                [start, end], [0, 0], color="tab:red", linewidth=4, solid_capstyle="butt", clip_on=False, zorder=4
            )
        if row["touch"] == row["touch"]:
            lines["lower quartile of touch frames"] = ax.axhline(
                row["touch"], color="tab:red", linewidth=0.7, linestyle="--"
            )
        ax.set(xlim=(0, longest), ylim=(min(0.0, float(level.min())), None))
        ax.set_title(plain([f"{short(str(name), 40)}, subject {short(str(row['subject']), 20)}"])[0], loc="left", pad=2)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelbottom=i == shown - 1)
    axes[-1, 0].set_xlabel("seconds of the recording")
    for artists, row, columns in ((dict(sorted(drawn.items())), 0, ACROSS), (lines, rows, 2)):
        corner = (0.02, 1 - (0.3 + 0.22 * row) / size[1])
        look = {"frameon": False, "columnspacing": 1.2, "handlelength": 1.4, "borderpad": 0.2}
        figure.legend(artists.values(), plain(artists), loc="upper left", bbox_to_anchor=corner, ncols=columns, **look)
    rest = f" {len(recordings) - shown} more recordings are not drawn." if len(recordings) > shown else ""
    caption = (
        "Mean reading of each frame; colours: labels. Red below: background with more pressure than the dashed line, "
        f"the lower quartile of the touches of the recording. Label it {DOUBT} where it may be touch.{rest}"
    )
    return save(figure, folder, "recordings", group, caption)


def durations_figure(found: StreamSurvey, group: str, folder: Path) -> Picture:
    """Durations of the touches of each gesture, and the gaps between touches, on one logarithmic scale."""
    names = [*found.events["gesture"], "gaps between touches"]
    left = width_of([short(name, 30) for name in names]) + 0.3
    size = (9.0, 0.28 * len(names) + 1.0)
    figure, axes = new_figure(size, margins=(left, 0.2, 0.55, 0.4), title=f"Durations and gaps, {group}")
    ax = axes[0, 0]
    for y, name in enumerate(names):
        colour = "0.4" if y == len(names) - 1 else f"C{y % 10}"
        values = np.sort(found.seconds[name] if y < len(names) - 1 else found.gaps[found.gaps > 0])
        if not len(values):
            continue
        low, quarter, middle, most, high = np.quantile(values, (0, 0.25, 0.5, 0.75, 1))
        ax.plot([low, high], [y, y], color=colour, linewidth=1)
        ax.plot([quarter, most], [y, y], color=colour, linewidth=7, alpha=0.5, solid_capstyle="butt")
        ax.plot([middle], [y], "o", color=colour, markersize=5)
    ax.set_yticks(range(len(names)), plain(short(name, 30) for name in names))
    ax.set(xscale="log", xlabel="seconds", ylim=(len(names) - 0.5, -0.5))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.grid(axis="x", alpha=0.25)
    ax.spines[["top", "right"]].set_visible(False)
    caption = (
        "Line: all durations; bar: the middle half; dot: the median. A gap of no frame, where a touch follows another "
        "at once, is left out."
    )
    return save(figure, folder, "durations", group, caption)
