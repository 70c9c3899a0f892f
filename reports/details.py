"""Figures of single runs, from their predictions: confusions, gestures, calibration.

Each comes with its caption; `bench.reports.figures.save` writes it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench import scores
from bench.reports.figures import LINE, MARKERS, WIDEST, bars, new_figure, plain, save, width_of
from bench.result import Result

BINS = 10
WRITTEN = 20  # classes up to which the numbers fit into their cells


def confusion_figure(counts: pd.DataFrame, system: str, group: str) -> tuple[Figure, str]:
    """Counts and percent of each true class, side by side or, of many classes, one above the other.

    Args:
        counts: counts of captures [true, predicted].
        system: name of the system.
        group: captures and protocol, in words.
    """
    values = counts.to_numpy(dtype=float)
    share = 100 * values / np.maximum(values.sum(axis=1, keepdims=True), 1)
    k, names = len(counts), plain(counts.columns)
    side = max(2.4, 0.34 * min(k, WRITTEN))
    edge = width_of(counts.columns) + 0.4
    beside = 2 * (side + edge) + 0.4 <= WIDEST
    size = (2 * (side + edge) + 0.4, side + edge + 0.75) if beside else (side + edge + 0.2, 2 * (side + edge) + 1.15)
    title = f"{plain([system])[0]}\n{group}"
    margins, between = (edge, 0.2, edge, 0.75), (edge + 0.2, edge + 0.4)
    figure, axes = new_figure(size, (1, 2) if beside else (2, 1), margins, between, title)
    for ax, shown, words in zip(axes.flat, (values, share), ("captures", "% of the true gesture"), strict=True):
        ax.pcolormesh(
            np.arange(len(names) + 1) - 0.5,
            np.arange(k + 1) - 0.5,
            share,
            cmap="Blues",
            vmin=0,
            vmax=100,
            clip_on=False,
        )
        ax.set(aspect="equal", ylim=(k - 0.5, -0.5), xlabel="predicted", ylabel="true", title=words)
        ax.set_xticks(np.arange(len(names)), names, rotation=90)
        ax.set_yticks(np.arange(k), plain(counts.index))
        for i, j in np.argwhere(shown) if k <= WRITTEN else ():
            colour = "white" if share[i, j] > 60 else "black"
            ax.text(j, i, f"{shown[i, j]:.0f}", ha="center", va="center", color=colour)
    unwritten = "" if k <= WRITTEN else " The numbers are in confusion.csv of the run."
    return figure, f"Confusion of captures by {system}: counts, and percent of each true gesture.{unwritten}"


def gesture_figure(tables: dict[str, pd.DataFrame], group: str) -> tuple[Figure, str]:
    """Percent of each gesture that is labelled correctly, with intervals over subjects, for some systems.

    Args:
        tables: `bench.reports.bootstrap.recall_interval` by system.
        group: captures and protocol, in words.
    """
    classes = list(next(iter(tables.values())).index)
    size = (9, LINE * 1.2 * len(classes) * max(2, len(tables)) + 0.9 + 0.25 * len(tables))
    margins = (width_of(classes) + 0.25, 0.15, 0.55 + 0.25 * len(tables), 0.35)
    figure, axes = new_figure(size, margins=margins, title=group)
    ax = axes[0, 0]
    for i, (system, table) in enumerate(tables.items()):
        y = np.arange(len(classes)) + 0.7 * ((i + 0.5) / len(tables) - 0.5)
        look = {"fmt": MARKERS[i % len(MARKERS)], "color": f"C{i}", "markersize": 5, "elinewidth": 0.9, "capsize": 2}
        ends = bars(table["recall"], table["low"], table["high"])
        ax.errorbar(table["recall"], y, xerr=ends, label=plain([system])[0], **look)
    ax.set_yticks(np.arange(len(classes)), plain(classes))
    ax.set(ylim=(len(classes) - 0.4, -0.6), xlim=(-2, 102), xlabel="correctly classified captures of the gesture, %")
    ax.grid(axis="x", alpha=0.25)
    figure.legend(loc="lower center", ncols=1, frameon=False)
    return figure, (
        "Correctly classified captures of each gesture, with 95 % bootstrap intervals over subjects, one seed each."
    )


def calibration(predictions: pd.DataFrame) -> tuple[pd.DataFrame, float] | None:
    """The share of correctly classified captures by confidence.

    Confidence is the highest mean probability of a capture, in ten bins of equal width.

    Returns:
        ``confidence``, ``accuracy`` and ``n`` of each bin that is not empty, and the expected calibration error: the
        mean over captures of the gap between the two in their bin; None where there are labels only.
    """
    columns = [scores.PREFIX + c for c in scores.classes_of(predictions)]
    if np.isin(predictions[columns].to_numpy(), (0, 1)).all():
        return None
    labelled = scores.captures(predictions)
    top = predictions.groupby(["fold", "capture"], sort=False)[columns].mean().to_numpy().max(axis=1)
    hit = (labelled["true"] == labelled["predicted"]).to_numpy()
    bin_of = np.minimum((top * BINS).astype(int), BINS - 1)
    bins = pd.DataFrame({"confidence": top, "accuracy": hit.astype(float), "n": 1}).groupby(bin_of)
    table = bins.agg({"confidence": "mean", "accuracy": "mean", "n": "size"})
    gap = (table["n"] * (table["confidence"] - table["accuracy"]).abs()).sum() / table["n"].sum()
    return table.reset_index(drop=True), float(gap)


def calibration_figure(tables: dict[str, tuple[pd.DataFrame, float]], group: str) -> tuple[Figure, str]:
    """Reliability diagrams of some systems.

    Args:
        tables: `calibration` by system.
        group: captures and protocol, in words.
    """
    size = (3.5 * len(tables) + 0.3, 4.05)
    figure, axes = new_figure(size, (1, len(tables)), (0.6, 0.15, 0.65, 0.75), (0.7, 0), group)
    for i, (ax, (system, (table, gap))) in enumerate(zip(axes[0], tables.items(), strict=True)):
        ax.plot([0, 1], [0, 1], color="0.6", linewidth=0.8, linestyle="--")
        ax.plot(table["confidence"], table["accuracy"], color=f"C{i}", linewidth=1)
        ax.scatter(table["confidence"], table["accuracy"], 10 + 150 * table["n"] / table["n"].sum(), f"C{i}")
        ax.set(xlim=(-0.04, 1.06), ylim=(-0.04, 1.06), aspect="equal")
        ax.set(xlabel="highest probability", ylabel="share classified correctly")
        ax.set_title(f"{plain([system])[0]}\nexpected calibration error {gap:.3f}")
        ax.grid(alpha=0.25)
    return figure, (
        "Reliability of the probabilities of whole captures in ten bins; the area of a dot is its share of captures, "
        "the dashed line is perfect calibration."
    )


def draw(result: Result, folder: Path) -> None:
    """Draw the confusions of a run into a folder."""
    group = ", ".join(result.context)
    figure, caption = confusion_figure(result.tables["confusion"].set_index("true"), result.method, group)
    save(figure, folder, "confusion", group, caption)
