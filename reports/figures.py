"""Shared parts of the report's figures: drawing, marks, files."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

SYNTHETIC = "synthetic captures, not people"
TEXT = 9  # points of all words and numbers of a figure; the page draws all figures on one scale
WIDEST = 11.0  # inches that a page of 1200 pixels has room for
COLUMN, BOTH_COLUMNS = 3.3, 6.9  # inches of a paper: one column, and both
TITLE = "title: "  # begins the gid of an artist; the SVG shows the rest below the mouse
LINE = 0.175  # inches of a line of text
MARKERS = "osD^v"
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 3)), (0, (8, 3)))


@dataclass(frozen=True)
class Picture:
    """A figure as it was written."""

    name: str
    caption: str  # with everything left out
    folder: Path

    @property
    def path(self) -> Path:
        """The SVG."""
        return self.folder / f"{self.name}.svg"


def new_figure(
    size: tuple[float, float],
    panels: tuple[int, int] = (1, 1),
    margins: tuple[float, float, float, float] = (0.7, 0.15, 0.55, 0.4),
    between: tuple[float, float] = (0.7, 0.9),
    title: str = "",
) -> tuple[Figure, np.ndarray]:
    """An empty figure and its axes [rows, columns]; pyplot's global state is not used.

    All places are given in inches (margins: left, right, bottom, top): finding them out by drawing,
    as matplotlib's layout engines do, takes longer than the drawing itself.
    """
    from matplotlib.figure import Figure

    width, height = size
    left, right, bottom, top = margins
    rows, columns = panels
    figure = Figure(figsize=size)
    inner_width = (width - left - right - between[0] * (columns - 1)) / columns
    inner_height = (height - bottom - top - between[1] * (rows - 1)) / rows
    axes = figure.subplots(rows, columns, squeeze=False)
    edges = {
        "left": left / width,
        "right": 1 - right / width,
        "bottom": bottom / height,
        "top": 1 - top / height,
    }
    figure.subplots_adjust(
        **edges, wspace=between[0] / inner_width, hspace=between[1] / inner_height
    )
    if title:
        figure.suptitle(title.replace("$", r"\$"), y=1 - 0.08 / height, va="top")
    return figure, axes


def text_width(names: Iterable[str]) -> float:
    """Inches that the longest of some names takes, about."""
    return max(map(len, shorten_names(names)), default=0) * TEXT * 0.0088


def save_figure(figure: Figure, folder: Path, name: str, group: str, caption: str) -> Picture:
    """Write a figure as SVG, all its text in one size; generated captures are marked on it."""
    if "(synthetic)" in group:
        caption = f"{caption} Synthetic: {SYNTHETIC}."
    picture = Picture(name, caption, folder)
    _finish_text(figure, group)
    write_svg(figure, picture.path)
    drawing = re.sub(
        f'<g id="{TITLE}(.*?)">', r"<g><title>\1</title>", picture.path.read_text(encoding="utf-8")
    )
    drawing = re.sub(
        '<g id="[^"]*"(/?)>', r"<g\1>", drawing
    )  # which every figure of a page would have
    picture.path.write_text(drawing, encoding="utf-8")
    return picture


def save_for_paper(figure: Figure, folder: Path, name: str, group: str) -> None:
    """Write a figure in the size that it has in a paper, as SVG and as PDF."""
    import matplotlib

    _finish_text(figure, group)
    path = folder / f"{name}-paper.svg"
    write_svg(figure, path)
    with matplotlib.rc_context({"pdf.fonttype": 42, "font.sans-serif": ["DejaVu Sans"]}):
        metadata = dict.fromkeys(("Creator", "Producer", "CreationDate"))
        figure.savefig(path.with_suffix(".pdf"), metadata=metadata)


def paper_width(names: Iterable[str]) -> float:
    """Inches of a figure in a paper with names beside its axis: a column if they leave room."""
    return COLUMN if text_width(names) < 0.45 * COLUMN else BOTH_COLUMNS


def _finish_text(figure: Figure, group: str) -> None:
    """Give all text one size, and mark generated captures."""
    from matplotlib.text import Text

    if "(synthetic)" in group:
        figure.text(0.995, 0.004, SYNTHETIC, color="0.4", ha="right", va="bottom", style="italic")
    for ax in figure.axes:
        ax.tick_params(labelsize=TEXT)  # of ticks that are made while it is drawn, too
    for text in figure.findobj(Text):
        text.set_fontsize(TEXT)  # for which places were computed


def write_svg(figure: Figure, path: Path) -> None:
    """Write a figure as SVG, its text as text; drawing it again gives the same file."""
    import matplotlib

    one_font = {"svg.fonttype": "none", "font.sans-serif": ["DejaVu Sans"]}
    with matplotlib.rc_context(one_font | {"svg.hashsalt": path.stem}):
        figure.savefig(path, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))


def error_bars(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The error bars of matplotlib: distances down and up from each value; 0 without interval."""
    value = np.asarray(value)
    return np.nan_to_num([value - np.asarray(low), np.asarray(high) - value]).clip(0)


def line_style(i: int) -> dict[str, object]:
    """Colour, marker and dashes of the line of a system, which differ in print, too."""
    return {
        "color": f"C{i % 10}",
        "marker": MARKERS[i % len(MARKERS)],
        "linestyle": DASHES[i % len(DASHES)],
    }


def set_log_ticks(axis: Axis, subs: tuple[int, ...] = (1, 2, 5)) -> None:
    """Plain numbers at some multiples of each power of ten, on a log axis."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def shorten_names(names: Iterable[str], most: int = 44) -> list[str]:
    """Names that fit into their place, with dollar signs escaped, which would begin formulas."""
    return [(n if len(n) <= most else n[: most - 1] + "…").replace("$", r"\$") for n in names]
