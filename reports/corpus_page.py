"""The page of ``bench data show``: tables of the survey and a film strip of each gesture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.corpora.survey import DURATIONS, PRESSURE, SENSOR, Survey
from bench.reports.figures import SYNTHETIC, Picture, new_figure, save_figure, shorten_names
from bench.reports.layout import render_page
from bench.values.table import Table, text_table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


FILMED = 8  # frames of a strip
DRAWN = 24  # gestures of a figure
SIDE, GAP = 0.72, 0.1  # inches of the longer side of a panel, and between panels
ROWS = 200  # of a table of the page
ROOT = 0.5  # colours follow the square root of the pressure, or light touch would all be black
INDEX = "index.html"


def write_page(survey: Survey, folder: Path) -> list[Path]:
    """Write the figures and a page that holds them all into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    corpus, index = survey.corpus, folder / INDEX
    group = corpus.name + " (synthetic)" * corpus.synthetic
    picture = draw_film(survey, group, folder)
    values = {"survey": survey, "sections": _make_sections(survey), "picture": picture}
    values["synthetic"] = f"Synthetic: {SYNTHETIC}." if corpus.synthetic else ""
    page = render_page("corpus.jinja", f"Captures of {group}", **values)
    index.write_text(page, encoding="utf-8")
    return [picture.path, index]


def _make_sections(survey: Survey) -> list[tuple[str, str, Table | None]]:
    """Heading, words and table of each part of the page; no table if there is nothing to list."""
    parts: list[tuple[str, str, pd.DataFrame | None]] = [
        ("Durations", f"{DURATIONS}.", survey.durations),
        ("Pressure", f"{PRESSURE}.", survey.pressure),
        ("Sensor", f"{SENSOR}.", survey.sensor),
        ("Gaps", f"{survey.gap_lines()[0]}.", survey.gaps),
        ("Taxels", f"{survey.taxel_lines()[0]}.", survey.odd_taxels),
        ("Duplicates", f"{survey.duplicate_lines()[0]}.", survey.duplicates),
    ]
    if survey.seams:
        parts.insert(-1, ("Seams", f"{'; '.join(map(str, survey.seams))}.", None))
    if (target := survey.corpus.target) != "gesture":
        words = f"Captures and subjects of each class of target={target}."
        parts.insert(0, ("Classes", words, survey.classes))
    return [_make_section(*part) for part in parts]


def _make_section(
    heading: str, words: str, table: pd.DataFrame | None
) -> tuple[str, str, Table | None]:
    """Heading, words and the first rows of a table."""
    words = words.removeprefix(f"{heading}: ")
    caption = words[0].upper() + words[1:]
    if table is None or not len(table):
        return heading, caption, None
    more = f" The first {ROWS} rows of {len(table)}." if len(table) > ROWS else ""
    texts = table.head(ROWS).map(lambda v: f"{v:.4g}" if isinstance(v, float) else str(v))
    return heading, caption + more, text_table(texts)


def _draw_frame(ax: Axes, frame: np.ndarray, most: float) -> None:
    """A frame in colours from 0 to the highest pressure."""
    from matplotlib.colors import PowerNorm

    ax.set(xticks=[], yticks=[])
    ax.imshow(
        frame, cmap="magma", norm=PowerNorm(ROOT, vmin=0, vmax=most, clip=True), aspect="auto"
    )


def draw_film(survey: Survey, group: str, folder: Path) -> Picture:
    """A row for each gesture: mean pressure, frames of a typical capture, its total pressure."""
    corpus, names = survey.corpus, survey.gestures[:DRAWN]
    wide, high = (max(SIDE * side / max(corpus.grid), 0.3) for side in corpus.grid[::-1])
    size = (2.75 + (FILMED + 2) * (wide + GAP), 0.85 + len(names) * (high + 2 * GAP))
    title = f"Mean pressure and a typical capture of each gesture, {shorten_names([group])[0]}"
    figure, axes = new_figure(
        size, (len(names), FILMED + 2), (1.95, 0.8, 0.45, 0.4), (GAP, 2 * GAP), title
    )
    most = max(float(survey.means.max()), 1e-9)
    for row, gesture, mean in zip(axes, names, survey.means, strict=False):
        capture = survey.typical[gesture]
        position = int(np.flatnonzero(corpus.index == capture)[0])
        frames = corpus[position]
        middles = (np.arange(FILMED) + 0.5) / FILMED  # of each eighth
        shown = (len(frames) * middles).astype(int)
        highest = max(float(frames[shown].max()), 1e-9)
        words = [
            gesture,
            f"mean: 0 to {_format_pressure(most)}",
            f"capture {capture}: 0 to {_format_pressure(highest)}",
            f"subject {corpus.subjects[position]}",
        ]
        text = "\n".join(shorten_names(words, 26))
        row[0].text(-0.1, 1, text, ha="right", va="top", transform=row[0].transAxes)
        _draw_frame(row[0], mean, most)
        row[0].plot(
            survey.odd_taxels["col"], survey.odd_taxels["row"], "x", color="cyan", markersize=5
        )
        for ax, frame in zip(row[1:], frames[shown], strict=False):
            _draw_frame(ax, frame, highest)
        _draw_total_pressure(row[-1], frames, corpus.rate_hz, shown)
    axes[-1, -1].set_xlabel("s")
    caption = (
        "Left: mean pressure of all frames of each gesture, with one scale for all. Then the most "
        "typical capture in duration, mean pressure and highest pressure: "
        f"{FILMED} frames, evenly spaced in time. Colours follow the square root of pressure. "
        "Right: pressure summed over the taxels against seconds; grey lines mark the frames."
    )
    caption += " Crosses: odd taxels." * (len(survey.odd_taxels) > 0)
    if omitted := len(survey.gestures) - len(names):
        caption += f" {omitted} more gestures are not drawn."
    return save_figure(figure, folder, "captures", group, caption)


def _draw_total_pressure(ax: Axes, frames: np.ndarray, rate_hz: float, shown: np.ndarray) -> None:
    """The pressure summed over the taxels against seconds, with a line at each shown frame."""
    total = frames.sum(axis=(1, 2), dtype=np.float64)
    times = (np.arange(len(frames)) + 0.5) / rate_hz
    ax.plot(times, total, color="tab:blue", linewidth=0.9, marker="." if len(frames) < 3 else None)
    ax.set(xlim=(0, len(frames) / rate_hz), ylim=(min(0.0, float(total.min())), None))
    ax.vlines(times[shown], *ax.get_ylim(), color="0.8", linewidth=0.6, zorder=0)
    ax.spines[["top", "left"]].set_visible(False)
    ax.yaxis.tick_right()
    ax.set_yticks([float(total.max())], [_format_pressure(total.max())])
    ax.tick_params(length=2, pad=1.5)


def _format_pressure(number: float) -> str:
    """A sensor value, or a sum of some, without an exponent where it is not huge."""
    return f"{number:.0f}" if 100 <= number < 1e7 else f"{number:.3g}"
