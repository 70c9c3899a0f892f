"""Accuracy against the level of a circumstance, on the page: one figure and one table for any of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from bench.measures import text
from bench.reports.contexts import contexts, scarce
from bench.reports.figures import bars, look, new_figure, plain, save
from bench.reports.part import Part, Section
from bench.result import Result
from bench.table import Table


def level_section(circumstance: Any, results: Sequence[Result], folder: Path) -> Section | None:
    """A figure and a table for each set of comparable results in a circumstance."""
    parts = []
    noun = circumstance.noun or circumstance.key
    for i, (context, members) in enumerate(contexts(results, circumstance.alike), 1):
        caption = f"{context}: accuracy by {noun}; means over subjects, 95 % t-intervals; dotted: captures as they are."
        picture = save(levels(circumstance.key, noun, members), folder, f"0-{circumstance.key}-{i}", context, caption)
        table = Table([text("system", read=lambda r: r.method), *circumstance.shows(members)], members)
        caption = f"{context}: {circumstance.heading or f'accuracy by {noun}'}"
        parts.append(Part(picture, table, caption, scarce(members)))
    return Section(circumstance.heading or noun.capitalize(), parts) if parts else None


def levels(key: str, noun: str, results: Sequence[Result]) -> Figure:
    """Accuracy against the level, a line for each system and case."""
    lines = []
    for i, r in enumerate(results):
        for case, curve in r.tables[key].groupby("case", sort=False):
            lines.append((i, r.method if case == key else f"{r.method}, {case}", curve))
    return drawn(noun, lines, [r["accuracy"] for r in results])


def drawn(
    noun: str, lines: Sequence[tuple[int, str, pd.DataFrame]], clean: Sequence[float] = (), title: str = ""
) -> Figure:
    """Curves by ``level`` with intervals, each with the number and the name of its system; clean accuracy is dotted."""
    figure, axes = new_figure((8.5, 4.2), margins=(0.7, 2.6, 0.6, 0.35), title=title)
    ax = axes[0, 0]
    for i, name, curve in lines:
        curve = curve.sort_values("level")
        middle, low, high = (100 * curve[end].to_numpy() for end in ("accuracy", "low", "high"))
        ends = bars(middle, low, high)
        ax.errorbar(curve["level"], middle, yerr=ends, capsize=3, markersize=5, label=plain([name])[0], **look(i))
    for i, accuracy in enumerate(clean):
        ax.axhline(100 * accuracy, color=f"C{i % 10}", linewidth=0.8, linestyle=":")
    ax.set(xlabel=noun, ylabel="correctly classified captures, %")
    ax.grid(alpha=0.3)
    ax.legend(loc="upper left", bbox_to_anchor=(1.02, 1), frameon=False)
    return figure
