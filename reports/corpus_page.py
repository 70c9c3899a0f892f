"""The page of ``bench data show``: tables of the survey, mean pressure of gestures, a film strip of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.corpora.survey import DURATIONS, PRESSURE, Survey
from bench.reports.figures import SYNTHETIC, Picture, new_figure, plain, save
from bench.reports.layout import page
from bench.table import Table, of_text

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage


FILMED = 8  # frames of a strip
DRAWN = 24  # gestures of a figure
ACROSS = 7  # panels of a row
TITLE, ABOVE = 1.3, 0.36  # inches that a panel's title may take, and above a panel
GAP = 0.15  # inches between panels
ROWS = 200  # of a table of the page
ROOT = 0.5  # colours follow the square root of the pressure, or light touch would all be black
INDEX = "index.html"


def write(found: Survey, folder: Path) -> list[Path]:
    """Write the figures and a page that holds them all into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    synthetic = found.corpus.synthetic
    group = found.corpus.name + (" (synthetic)" if synthetic else "")
    pictures = [pressure_figure(found, group, folder), film_figure(found, group, folder)]
    values = {"survey": found, "sections": _sections(found), "pictures": pictures}
    values["synthetic"] = f"Synthetic: {SYNTHETIC}." if synthetic else ""
    index = folder / INDEX
    index.write_text(page("corpus.jinja", f"Captures of {group}", **values), encoding="utf-8")
    return [*(picture.path for picture in pictures), index]


def _sections(found: Survey) -> list[tuple[str, str, Table | None]]:
    """Heading, words and table of each part of the page; no table where there is nothing to list."""
    parts: list[tuple[str, str, pd.DataFrame | None]] = []
    if (target := found.corpus.target) != "gesture":
        parts.append(("Classes", f"Captures and subjects of each class of target={target}.", found.classes))
    parts += [
        ("Durations", f"{DURATIONS}.", found.durations),
        ("Pressure", f"{PRESSURE}.", found.pressure),
        ("Gaps", f"{found.gap_lines()[0]}.", found.gaps),
        ("Taxels", f"{found.taxel_lines()[0]}.", found.odd_taxels),
        *([("Seams", f"{'; '.join(map(str, found.seams))}.", None)] if found.seams else []),
        ("Duplicates", f"{found.duplicate_lines()[0]}.", found.duplicates),
    ]
    return [_section(*part) for part in parts]


def _section(heading: str, words: str, table: pd.DataFrame | None) -> tuple[str, str, Table | None]:
    """Heading, words and the first rows of a table."""
    words = words.removeprefix(f"{heading}: ")
    caption = words[0].upper() + words[1:]
    if table is None or not len(table):
        return heading, caption, None
    more = f" The first {ROWS} rows of {len(table)}." if len(table) > ROWS else ""
    texts = table.head(ROWS).map(lambda v: f"{v:.4g}" if isinstance(v, float) else str(v))
    return heading, caption + more, of_text(texts)


def _left_out(gestures: list[str]) -> str:
    return f" {len(gestures) - DRAWN} more gestures are not drawn." if len(gestures) > DRAWN else ""


def _panel(grid: Sequence[int], side: float) -> tuple[float, float]:
    """Inches, width and height, of a picture of the grid; a single line of taxels is not too thin to see."""
    rows, cols = grid
    return max(side * cols / max(rows, cols), 0.3), max(side * rows / max(rows, cols), 0.3)


def _frame(ax: Axes, frame: np.ndarray, most: float) -> AxesImage:
    """A frame in colours from 0 to the highest pressure."""
    from matplotlib.colors import PowerNorm

    ax.set(xticks=[], yticks=[])
    return ax.imshow(frame, cmap="magma", norm=PowerNorm(ROOT, vmin=0, vmax=most, clip=True), aspect="auto")


def pressure_figure(found: Survey, group: str, folder: Path) -> Picture:
    """Mean pressure on the grid, a panel for each gesture, all in the same colours."""
    names, means = found.gestures[:DRAWN], found.means[:DRAWN]
    panel, across = _panel(means.shape[1:], 1.35), min(ACROSS, len(names))
    down, slot = -(-len(names) // across), max(panel[0], TITLE) + GAP
    size = width, height = max(4.5, across * slot + GAP + 1), down * (panel[1] + ABOVE) + 0.6
    figure, axes = new_figure(size, (down, across), (GAP, width - across * slot, 0.25, ABOVE + 0.15), (GAP, ABOVE))
    figure.suptitle(f"Mean pressure of each gesture, {plain([group])[0]}", fontsize=9, y=1 - 0.08 / height, va="top")
    most = max(float(means.max()), 1e-9)
    for ax in [*axes.flat][len(names) :]:
        ax.set_axis_off()
    for ax, name, values in zip(axes.flat, plain(names, 20), means, strict=False):
        ax.set_box_aspect(panel[1] / panel[0])
        image = _frame(ax, values, most)
        ax.set_title(name, fontsize=8, pad=3)
        ax.plot(found.odd_taxels["col"], found.odd_taxels["row"], "x", color="cyan", markersize=5, markeredgewidth=1)
    left = axes.flat[across - 1].get_position().x1 + GAP / width
    bar = figure.add_axes((left, 0.3 / height, 0.12 / width, min(height - 0.8, 2.0) / height))
    figure.colorbar(image, cax=bar).set_label("sensor value", fontsize=8)
    crosses = " Crosses: odd taxels." if len(found.odd_taxels) else ""
    caption = (
        "Mean pressure of all frames of each gesture. All panels have the same colour scale, the square root of "
        f"pressure.{crosses}{_left_out(found.gestures)}"
    )
    return save(figure, folder, "pressure", group, caption)


def film_figure(found: Survey, group: str, folder: Path) -> Picture:
    """A typical capture of each gesture: frames evenly spaced in time, and below them the total pressure."""
    corpus, names = found.corpus, found.gestures[:DRAWN]
    gap = 1 / 12  # between two frames, as a share of one
    wide, high = _panel(corpus.grid, 0.95)
    across = FILMED * wide * (1 + gap) - gap * wide
    left, top, curve, between = 1.75, 0.5, 0.42, 0.42
    row = high + 0.05 + curve + between
    size = width, height = (left + across + 0.75, top + row * len(names) + 0.25)
    figure, _ = new_figure(size, (1, 1), title=f"A typical capture of each gesture, {plain([group])[0]}")
    figure.axes[0].remove()
    for i, gesture in enumerate(names):
        capture = found.typical[gesture]
        position = int(np.flatnonzero(corpus.index == capture)[0])
        frames = corpus[position]
        shown = (len(frames) * (np.arange(FILMED) + 0.5) / FILMED).astype(int)  # the frame in the middle of each eighth
        bottom = height - top - i * row - high
        most = max(float(frames[shown].max()), 1e-9)
        for j, frame in enumerate(frames[shown]):
            x = left + j * wide * (1 + gap)
            _frame(figure.add_axes((x / width, bottom / height, wide / width, high / height)), frame, most)
        ax = figure.add_axes((left / width, (bottom - 0.05 - curve) / height, across / width, curve / height))
        _total(ax, frames, corpus.rate_hz, shown)
        if i == len(names) - 1:
            ax.set_xlabel("s", fontsize=7, labelpad=1)
        words = [f"capture {capture}", f"subject {corpus.subjects[position]}", f"colours 0 to {_value(most)}"]
        (name,), lines = plain([gesture], 19), plain(words, 30)
        figure.text(0.12 / width, (bottom + high) / height, name, fontsize=9, va="top", weight="bold")
        figure.text(0.12 / width, (bottom + high - 0.2) / height, "\n".join(lines), va="top", color="0.35")
    caption = (
        "The most typical capture of each gesture in duration, mean pressure and highest pressure: "
        f"{FILMED} frames, evenly spaced in time. Colours follow the square root of pressure, with one scale per row. "
        "The curve below is the pressure summed over the taxels against seconds; grey lines mark the frames."
        f"{_left_out(found.gestures)}"
    )
    return save(figure, folder, "films", group, caption)


def _total(ax: Axes, frames: np.ndarray, rate_hz: float, shown: np.ndarray) -> None:
    """The pressure summed over the taxels against seconds, with a line at each frame that is shown."""
    total = frames.sum(axis=(1, 2), dtype=np.float64)
    times = (np.arange(len(frames)) + 0.5) / rate_hz
    ax.plot(times, total, color="tab:blue", linewidth=0.9, marker="." if len(frames) < 3 else None)
    ax.set(xlim=(0, len(frames) / rate_hz), ylim=(min(0.0, float(total.min())), None))
    ax.vlines(times[shown], *ax.get_ylim(), color="0.8", linewidth=0.6, zorder=0)
    ax.spines[["top", "left"]].set_visible(False)
    ax.yaxis.tick_right()
    ax.set_yticks([float(total.max())], [_value(total.max())])
    ax.tick_params(length=2, pad=1.5)


def _value(number: float) -> str:
    """A sensor value, or a sum of some, without an exponent where it is not huge."""
    return f"{number:.0f}" if 100 <= number < 1e7 else f"{number:.3g}"
