"""Figures of accuracy under faults and with fewer training subjects; systems differ by dashes, markers and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.reports.figures import look, write_svg
from bench.reports.levels import drawn
from bench.result import Result
from bench.work.stability import learning

NAME = 36  # characters of a line of a method's name
PANELS = 4  # side by side


def draw(results: Sequence[Result], folder: Path) -> None:
    """Write all figures for which there is something to show, as SVG."""
    figures = {}
    if len(results[0].tables["faults"]):
        losses = pd.DataFrame({r.method: r.tables["margins"].set_index("fault")["loss"] for r in results}).T
        figures["heat_map"] = heat_map(losses, [r["accuracy"] for r in results], ", ".join(results[0].context))
        figures["severities"] = severities(results)
    if any("learning" in r.tables for r in results):
        curves = [learning(r.tables["labels"]).rename(columns={"train_subjects": "level"}) for r in results]
        lines = [(i, r.method, curve) for i, (r, curve) in enumerate(zip(results, curves, strict=True))]
        figures["training_subjects"] = drawn("training subjects", lines, title=", ".join(results[0].context))
    for name, figure in figures.items():
        write_svg(figure, folder / f"stability_{name}.svg")


def heat_map(losses: pd.DataFrame, clean: list[float], context: str) -> Figure:
    """Mean loss of accuracy over severities, a row for each method and a column for each fault, costliest first."""
    points = 100 * losses[losses.mean().sort_values(ascending=False, kind="stable").index]
    methods, faults = points.shape
    figure = Figure(figsize=(3.6 + 0.43 * faults, 1.9 + 0.5 * methods), layout="constrained")
    ax = figure.subplots()
    edges = np.arange(faults + 1) - 0.5, np.arange(methods + 1) - 0.5
    limits = {"vmin": min(0, points.min().min()), "vmax": max(points.max().max(), 1)}
    image = ax.pcolormesh(*edges, points, cmap="Greys", **limits)
    ax.invert_yaxis()
    for i, j in np.ndindex(methods, faults):
        value = points.iloc[i, j]
        dark = image.norm(value) > 0.55
        text = "-" if np.isnan(value) else f"{value:.0f}".replace("-0", "0")
        ax.text(j, i, text, ha="center", va="center", color="white" if dark else "black")
    ax.set_xticks(
        range(faults), [f.replace("_", " ") for f in points.columns], rotation=40, ha="right", rotation_mode="anchor"
    )
    names = [f"{m} ({100 * c:.0f} % clean)" for m, c in zip(points.index, clean, strict=True)]
    ax.set_yticks(range(methods), [fill(name, NAME) for name in names])
    ax.set_xticks(np.arange(faults - 1) + 0.5, minor=True)
    ax.set_yticks(np.arange(methods - 1) + 0.5, minor=True)
    ax.grid(which="minor", color="white", linewidth=1.5)
    ax.tick_params(which="minor", length=0)
    figure.suptitle(f"Points of accuracy lost under each fault, mean over five severities\n{context}", fontsize=10)
    return figure


def severities(results: Sequence[Result]) -> Figure:
    """Accuracy against severity, a panel for each fault."""
    faults = list(results[0].tables["margins"]["fault"])
    wide = min(PANELS, len(faults))
    high = -(-len(faults) // wide)
    figure = Figure(figsize=(max(3.1 * wide, 7), 2.3 * high + 1.4), layout="constrained")
    axes = figure.subplots(high, wide, sharey=True, squeeze=False)
    for ax, fault in zip(axes.flat, faults, strict=False):
        for k, r in enumerate(results):
            part = r.tables["faults"].query("fault == @fault").sort_values("severity")
            accuracy = 100 * np.append(r["accuracy"], part["accuracy"])
            ax.plot(np.append(0, part["severity"]), accuracy, label=r.method, **look(k), markersize=5, linewidth=1.4)
        ax.axhline(100 * results[0]["chance"], color="0.5", linewidth=0.8, linestyle=(0, (1, 2)))
        amounts = [text.partition(" ") for text in part["amount"]]
        ax.set_xticks(range(len(amounts) + 1), ["none", *(number for number, _, _ in amounts)], fontsize=8)
        ax.set_xlabel(amounts[0][2], fontsize=8)
        ax.set_title(fault.replace("_", " "), fontsize=9)
        ax.set_ylim(0, 100)
        ax.grid(alpha=0.3)
    for ax in axes.flat[len(faults) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("accuracy, %", fontsize=8)
    words = "Accuracy under each fault; the dotted line is chance"
    figure.suptitle(f"{words}\n{', '.join(results[0].context)}", fontsize=10)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    columns = max(1, int(figure.get_figwidth() * 11 // (max(map(len, labels)) + 8)))
    figure.legend(handles, labels, loc="outside lower center", ncols=min(columns, len(labels)), fontsize=8)
    return figure
