"""Figures of a group and of single runs, each with its caption, and intervals of class scores over subjects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.reading import statistics
from bench.reports.figures import (
    LINE,
    MARKERS,
    WIDEST,
    Picture,
    bars,
    new_figure,
    plain,
    save,
    width_of,
)
from bench.values import few, intervals, scores
from bench.values.intervals import interval
from bench.values.result import Result, seed_number

WRITTEN = 20  # classes up to which the numbers fit into their cells
SYSTEMS = 2  # systems of a group whose predictions are read and drawn


def pictures(
    results: Sequence[Result], subjects: pd.DataFrame, group: str, folder: Path, file: str
) -> dict[str, Picture]:
    """The figures of a group, written into a folder, by kind.

    Predictions are those of the most accurate systems, one seed each, not the luckiest.
    """
    lowest: dict[str, Result] = {}
    for r in sorted((r for r in results if r.complete), key=lambda r: seed_number(r["seed"])):
        lowest.setdefault(r.system, r)
    figures: dict[str, tuple[Figure, str]] = {}
    recalls = {}
    for system in subjects.index[:SYSTEMS]:
        if (table := lowest[system].tables.get("predictions")) is None:
            continue
        labelled, classes = scores.captures(table), scores.classes_of(table)
        if not recalls:
            figures["confusion"] = confusion_figure(
                scores.confusion(labelled, classes), system, group
            )
        recalls[system] = recall_interval(labelled, classes)
    if recalls:
        figures["gestures"] = gesture_figure(recalls, group)
    if len(subjects):
        figures["subjects"] = strip_plot(subjects, group)
    return {
        kind: save(drawn, folder, f"{file}-{kind}", group, words)
        for kind, (drawn, words) in figures.items()
    }


def confusion_figure(counts: pd.DataFrame, system: str, group: str) -> tuple[Figure, str]:
    """Counts [true, predicted] and percent of each true class, side by side, or one below the other."""
    values = counts.to_numpy(dtype=float)
    share = 100 * values / np.maximum(values.sum(axis=1, keepdims=True), 1)
    k, names = len(counts), plain(counts.columns)
    side = max(2.4, 0.34 * min(k, WRITTEN))
    edge = width_of(counts.columns) + 0.4
    beside = 2 * (side + edge) + 0.4 <= WIDEST
    size = (
        (2 * (side + edge) + 0.4, side + edge + 0.75)
        if beside
        else (side + edge + 0.2, 2 * (side + edge) + 1.15)
    )
    title = f"{plain([system])[0]}\n{group}"
    margins, between = (edge, 0.2, edge, 0.75), (edge + 0.2, edge + 0.4)
    figure, axes = new_figure(size, (1, 2) if beside else (2, 1), margins, between, title)
    for ax, shown, words in zip(
        axes.flat, (values, share), ("captures", "% of the true gesture"), strict=True
    ):
        edges = np.arange(len(names) + 1) - 0.5, np.arange(k + 1) - 0.5
        ax.pcolormesh(*edges, share, cmap="Blues", vmin=0, vmax=100, clip_on=False)
        ax.set(aspect="equal", ylim=(k - 0.5, -0.5), xlabel="predicted", ylabel="true", title=words)
        ax.set_xticks(np.arange(len(names)), names, rotation=90)
        ax.set_yticks(np.arange(k), plain(counts.index))
        for i, j in np.argwhere(shown) if k <= WRITTEN else ():
            colour = "white" if share[i, j] > 60 else "black"
            ax.text(j, i, f"{shown[i, j]:.0f}", ha="center", va="center", color=colour)
    unwritten = "" if k <= WRITTEN else " The numbers are in confusion.csv of the run."
    return (
        figure,
        f"Confusion of captures by {system}: counts, and percent of each true gesture.{unwritten}",
    )


def gesture_figure(tables: dict[str, pd.DataFrame], group: str) -> tuple[Figure, str]:
    """Percent of each gesture that is labelled correctly, with intervals over subjects: `recall_interval` by system."""
    classes = list(next(iter(tables.values())).index)
    size = (9, LINE * 1.2 * len(classes) * max(2, len(tables)) + 0.9 + 0.25 * len(tables))
    margins = (width_of(classes) + 0.25, 0.15, 0.55 + 0.25 * len(tables), 0.35)
    figure, axes = new_figure(size, margins=margins, title=group)
    ax = axes[0, 0]
    for i, (system, table) in enumerate(tables.items()):
        y = np.arange(len(classes)) + 0.7 * ((i + 0.5) / len(tables) - 0.5)
        look = {
            "fmt": MARKERS[i % len(MARKERS)],
            "color": f"C{i}",
            "markersize": 5,
            "elinewidth": 0.9,
            "capsize": 2,
        }
        ends = bars(table["recall"], table["low"], table["high"])
        ax.errorbar(table["recall"], y, xerr=ends, label=plain([system])[0], **look)
    ax.set_yticks(np.arange(len(classes)), plain(classes))
    ax.set(
        ylim=(len(classes) - 0.4, -0.6),
        xlim=(-2, 102),
        xlabel="correctly classified captures of the gesture, %",
    )
    ax.grid(axis="x", alpha=0.25)
    figure.legend(loc="lower center", ncols=1, frameon=False)
    known = any(table["low"].notna().any() for table in tables.values())
    ends = ", with 95 % bootstrap intervals over subjects" * known
    return figure, f"Correctly classified captures of each gesture{ends}, one seed each."


def draw(result: Result, folder: Path) -> None:
    """Draw the confusions of a run into a folder."""
    group = ", ".join(result.context)
    figure, caption = confusion_figure(
        result.tables["confusion"].set_index("true"), result.method, group
    )
    save(figure, folder, "confusion", group, caption)


def strip_plot(subjects: pd.DataFrame, group: str) -> tuple[Figure, str]:
    """A mark for the accuracy of each subject, with the mean and its t-interval, of the first systems."""
    kept = subjects.iloc[: statistics.RANKED]
    margins = (width_of(kept.index) + 0.25, 0.15, 0.5, 0.35)
    figure, axes = new_figure((9.5, LINE * 1.5 * len(kept) + 0.85), margins=margins, title=group)
    ax = axes[0, 0]
    values, rows = kept.to_numpy(dtype=float), np.arange(len(kept))
    ax.plot(
        values.ravel(),
        rows.repeat(values.shape[1]),
        "|",
        color="0.35",
        markersize=8,
        markeredgewidth=1,
    )
    low, high = np.array([interval(v) for v in values]).T.clip(0, 100)
    ax.hlines(rows, low, high, color="tab:blue", linewidth=3, alpha=0.35, zorder=1)
    ax.plot(values.mean(axis=1), rows, "o", color="tab:blue", markersize=5)
    ax.set_yticks(rows, plain(kept.index))
    ax.set(ylim=(len(kept) - 0.4, -0.6), xlabel="correctly classified captures of the subject, %")
    ax.grid(axis="x", alpha=0.25)
    left = len(subjects) - len(kept)
    return figure, (
        f"Each tick is one of {subjects.shape[1]} subjects, the dot is their mean"
        + (", the bar is its 95 % t-interval" if subjects.shape[1] >= few.INTERVAL else "")
        + ". Seeds are averaged."
        + (f" {left} less accurate systems are left out." if left else "")
    )


def drawn_confusions(
    labelled: pd.DataFrame, classes: list[str], draws: int, seed: int
) -> np.ndarray:
    """Confusions of whole subjects drawn with replacement, [draws, true, predicted]; the last is of abstentions."""
    people, person = np.unique(labelled["subject"], return_inverse=True)
    true, predicted = (
        pd.Index(classes).get_indexer(pd.Index(labelled[name])) for name in ("true", "predicted")
    )
    counts = np.zeros((len(people), len(classes), len(classes) + 1), np.int64)
    np.add.at(
        counts, (person[true >= 0], true[true >= 0], predicted[true >= 0]), 1
    )  # -1 without a label
    return np.einsum("ds,sij->dij", intervals.weights([len(counts)], draws, seed)[0], counts)


def macro_interval(
    labelled: pd.DataFrame, classes: list[str], metric: str, draws: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Interval of ``macro_precision`` or ``macro_recall``, NaN of too few subjects.

    A class without a case counts 0, as in the score itself.
    """
    if labelled["subject"].nunique() < few.INTERVAL:
        return np.nan, np.nan
    pooled = drawn_confusions(labelled, classes, draws, seed)
    right = np.einsum("dii->di", pooled[..., :-1])
    totals = pooled[..., :-1].sum(axis=1) if metric == "macro_precision" else pooled.sum(axis=2)
    low, high = intervals.percentiles((right / np.maximum(totals, 1)).mean(axis=1))
    return float(low), float(high)


def recall_interval(
    labelled: pd.DataFrame, classes: list[str], draws: int = 2000, seed: int = 0
) -> pd.DataFrame:
    """Percent of each class that is labelled correctly (``recall``), with its interval; NaN where no capture is."""
    counts = scores.confusion(labelled, classes).to_numpy()
    table = pd.DataFrame({"recall": _recalls(counts), "low": np.nan, "high": np.nan}, index=classes)
    if labelled["subject"].nunique() >= few.INTERVAL:
        shares = _recalls(drawn_confusions(labelled, classes, draws, seed))
        for i, drawn in enumerate(shares.T):
            seen = drawn[np.isfinite(drawn)]  # a class that nobody drawn has shown
            if len(seen):
                table.iloc[i, 1:] = intervals.percentiles(seen)
    return table


def _recalls(confusions: np.ndarray) -> np.ndarray:
    """Percent of each class, [..., classes], of confusions with or without a column for abstentions."""
    with np.errstate(invalid="ignore", divide="ignore"):
        right = np.einsum("...ii->...i", confusions[..., : confusions.shape[-2]])
        return 100 * right / confusions.sum(axis=-1)
