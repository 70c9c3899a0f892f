"""Figures of a group and of single runs with captions; intervals of class scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.reading import statistics
from bench.reports.figures import (
    BOTH_COLUMNS,
    COLUMN,
    LINE,
    MARKERS,
    WIDEST,
    Picture,
    error_bars,
    line_style,
    new_figure,
    paper_width,
    save_figure,
    save_for_paper,
    set_log_ticks,
    shorten_names,
    text_width,
)
from bench.reports.sections import runs_of_systems
from bench.values import few, intervals, scores
from bench.values.intervals import mean_interval
from bench.values.measures import Cost
from bench.values.result import Result

WRITTEN = 20  # classes up to which the numbers fit into their cells
CELL = 0.22  # inches of a cell with its number
SYSTEMS = 2  # systems of a group whose predictions are read and drawn


def draw_group_figures(
    results: Sequence[Result], subjects: pd.DataFrame, group: str, folder: Path, file: str
) -> dict[str, Picture]:
    """The figures of a group, written into a folder, by kind; also in the size of a paper.

    Predictions are those of the most accurate systems, one seed each, not the luckiest.
    """
    runs = runs_of_systems(results)
    figures: dict[str, tuple[Figure, str]] = {}
    for_paper: dict[str, tuple[Figure, str]] = {}
    recalls: dict[str, pd.DataFrame] = {}
    for system in subjects.index[:SYSTEMS]:
        first, *others = runs[system]
        if (table := first.tables.get("predictions")) is None:
            continue
        labelled, classes = scores.label_captures(table), scores.classes_of(table)
        name = system + f", seed {first['seed']}" * bool(others)
        if not recalls:
            counts = scores.confusion_table(labelled, classes)
            figures["confusion"] = confusion_figure(counts, name, group)
            for_paper["confusion"] = confusion_figure(counts, name, "", for_paper=True)
        recalls[name] = recall_interval(labelled, classes)
    if recalls:
        figures["gestures"] = gesture_figure(recalls, group)
        width = paper_width(next(iter(recalls.values())).index)
        for_paper["gestures"] = gesture_figure(recalls, "", width)
    if len(subjects):
        figures["subjects"] = subject_figure(subjects, group)
        width = paper_width(subjects.index[: statistics.RANKED])
        for_paper["subjects"] = subject_figure(subjects, "", width)
    for kind, (figure, _) in for_paper.items():
        save_for_paper(figure, folder, f"{file}-{kind}", group)
    return {
        kind: save_figure(figure, folder, f"{file}-{kind}", group, caption)
        for kind, (figure, caption) in figures.items()
    }


def confusion_figure(
    counts: pd.DataFrame, system: str, group: str, for_paper: bool = False
) -> tuple[Figure, str]:
    """Counts [true, predicted] and percent of each true class, in two panels.

    In the size of a paper, there are only percent.
    """
    values = counts.to_numpy(dtype=float)
    share = 100 * values / np.maximum(values.sum(axis=1, keepdims=True), 1)
    classes, names = len(counts), shorten_names(counts.columns)
    side = max(2.4, 0.34 * min(classes, WRITTEN))
    edge = text_width(counts.columns) + 0.4
    size, panels = (2 * (side + edge) + 0.4, side + edge + 0.75), (1, 2)
    if size[0] > WIDEST:
        size, panels = (side + edge + 0.2, 2 * (side + edge) + 1.15), (2, 1)
    if for_paper:
        width = COLUMN if CELL * classes + edge + 0.2 < COLUMN else BOTH_COLUMNS
        size, panels = (width, width + 0.35), (1, 1)
    title = f"{shorten_names([system])[0]}\n{group}".rstrip()
    margins, between = (edge, 0.2, edge, 0.55 if for_paper else 0.75), (edge + 0.2, edge + 0.4)
    figure, axes = new_figure(size, panels, margins, between, title)
    edges = np.arange(len(names) + 1) - 0.5, np.arange(classes + 1) - 0.5
    panels_shown = [(values, "captures"), (share, "% of the true gesture")]
    for ax, (shown, heading) in zip(axes.flat, panels_shown[-axes.size :], strict=True):
        ax.pcolormesh(*edges, share, cmap="Blues", vmin=0, vmax=100, clip_on=False)
        ax.set(aspect="equal", ylim=(classes - 0.5, -0.5), title=heading)
        ax.set(xlabel="predicted", ylabel="true")
        ax.set_xticks(np.arange(len(names)), names, rotation=90)
        ax.set_yticks(np.arange(classes), shorten_names(counts.index))
        for i, j in np.argwhere(shown) if classes <= WRITTEN else ():
            colour = "white" if share[i, j] > 60 else "black"
            ax.text(j, i, f"{shown[i, j]:.0f}", ha="center", va="center", color=colour)
    caption = f"Confusion of captures by {system}: counts, and percent of each true gesture."
    if classes > WRITTEN:
        caption += " The numbers are in confusion.csv of the run."
    return figure, caption


def gesture_figure(
    tables: dict[str, pd.DataFrame], group: str, width: float = 9
) -> tuple[Figure, str]:
    """Percent of correctly classified captures of each gesture (`recall_interval` by system)."""
    classes = list(next(iter(tables.values())).index)
    size = (width, LINE * 1.2 * len(classes) * max(2, len(tables)) + 0.9 + 0.25 * len(tables))
    margins = (text_width(classes) + 0.25, 0.15, 0.55 + 0.25 * len(tables), 0.35)
    figure, axes = new_figure(size, margins=margins, title=group)
    ax = axes[0, 0]
    style = {"markersize": 5, "elinewidth": 0.9, "capsize": 2}
    for i, (system, table) in enumerate(tables.items()):
        y = np.arange(len(classes)) + 0.7 * ((i + 0.5) / len(tables) - 0.5)
        ends = error_bars(table["recall"], table["low"], table["high"])
        look = style | {"fmt": MARKERS[i % len(MARKERS)], "color": f"C{i}"}
        ax.errorbar(table["recall"], y, xerr=ends, label=shorten_names([system])[0], **look)
    ax.set_yticks(np.arange(len(classes)), shorten_names(classes))
    ax.set(ylim=(len(classes) - 0.4, -0.6), xlim=(-2, 102))
    words = "correctly classified captures of the gesture, %" if width > COLUMN else "correct, %"
    ax.set(xlabel=words)
    ax.grid(axis="x", alpha=0.25)
    figure.legend(loc="lower center", ncols=1, frameon=False)
    caption = "Correctly classified captures of each gesture"
    if any(table["low"].notna().any() for table in tables.values()):
        caption += ", with 95 % bootstrap intervals over subjects"
    return figure, f"{caption}, one seed each."


def cost_figure(points: pd.DataFrame, cost: Cost) -> Figure | None:
    """Accuracy against a cost in a column of a paper, all names below; None if none is known.

    The points are those of `bench.reports.chart.chart_points`.
    """
    known = points[(points[cost.key] > 0) | points[cost.key].notna() & cost.is_linear]
    if known.empty:
        return None
    names = shorten_names(known["name"])
    below = LINE * 1.2 * len(names) + 0.1
    figure, axes = new_figure((COLUMN, 2.4 + below), margins=(0.6, 0.15, 0.5 + below, 0.1))
    ax = axes[0, 0]
    if not cost.is_linear:
        low, high = known[cost.key].min(), known[cost.key].max()
        ax.set(xscale="log", xlim=(low / 1.3, high * 1.3))  # all systems may cost the same
        is_wide = high > 30 * low
        set_log_ticks(ax.xaxis, (1,) if is_wide else (1, 2, 5))
    for i, (name, row) in enumerate(zip(names, known.to_dict("records"), strict=True)):
        ends = error_bars(row["accuracy"], row["low"], row["high"])[:, None]
        style = line_style(i) | {"linestyle": "", "capsize": 2, "elinewidth": 0.9}
        ax.errorbar([row[cost.key]], [row["accuracy"]], yerr=ends, label=name, **style)
    ax.set(xlabel=f"{cost.title}, {cost.unit}".rstrip(", "), ylabel="accuracy, %")
    figure.legend(loc="lower left", ncols=1, frameon=False)
    return figure


def draw_confusions(result: Result, folder: Path) -> None:
    """Draw the confusions of a run into a folder."""
    group, counts = ", ".join(result.context), result.tables["confusion"].set_index("true")
    figure, caption = confusion_figure(counts, result.system_with_seed, group)
    save_figure(figure, folder, "confusion", group, caption)


def subject_figure(subjects: pd.DataFrame, group: str, width: float = 9.5) -> tuple[Figure, str]:
    """A mark for the accuracy of each subject, with mean and t-interval, of the first systems."""
    first, people = subjects.iloc[: statistics.RANKED], subjects.shape[1]
    margins = (text_width(first.index) + 0.25, 0.15, 0.5, 0.35)
    figure, axes = new_figure((width, LINE * 1.5 * len(first) + 0.85), margins=margins, title=group)
    ax, values, rows = axes[0, 0], first.to_numpy(dtype=float), np.arange(len(first))
    ticks = {"color": "0.35", "markersize": 8, "markeredgewidth": 1}
    ax.plot(values.ravel(), rows.repeat(people), "|", **ticks)
    low, high = np.array([mean_interval(v) for v in values]).T.clip(0, 100)
    ax.hlines(rows, low, high, color="tab:blue", linewidth=3, alpha=0.35, zorder=1)
    ax.plot(values.mean(axis=1), rows, "o", color="tab:blue", markersize=5)
    ax.set_yticks(rows, shorten_names(first.index))
    words = "correctly classified captures of the subject, %" if width > COLUMN else "correct, %"
    ax.set(ylim=(len(first) - 0.4, -0.6), xlabel=words)
    ax.grid(axis="x", alpha=0.25)
    caption = f"Each tick is one of {people} subjects, the dot is their mean"
    caption += ", the bar is its 95 % t-interval" * (people >= few.FEWEST_FOR_INTERVAL)
    caption += ". Seeds are averaged."
    if omitted := len(subjects) - len(first):
        caption += f" {omitted} less accurate systems are left out."
    return figure, caption


def sample_confusions(
    labelled: pd.DataFrame, classes: list[str], draws: int, seed: int
) -> np.ndarray:
    """Confusions of subjects drawn with replacement [draws, true, predicted or abstained]."""
    people, person = np.unique(labelled["subject"], return_inverse=True)
    true, predicted = (
        pd.Index(classes).get_indexer(pd.Index(labelled[name])) for name in ("true", "predicted")
    )
    counts = np.zeros((len(people), len(classes), len(classes) + 1), np.int64)
    has_label = true >= 0
    np.add.at(counts, (person[has_label], true[has_label], predicted[has_label]), 1)
    return np.einsum("ds,sij->dij", intervals.draw_weights([len(counts)], draws, seed)[0], counts)


def macro_interval(
    labelled: pd.DataFrame, classes: list[str], metric: str, draws: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Interval of ``macro_precision`` or ``macro_recall``, NaN of too few subjects.

    A class without a case counts 0, as in the score itself.
    """
    if labelled["subject"].nunique() < few.FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    pooled = sample_confusions(labelled, classes, draws, seed)
    right = np.einsum("dii->di", pooled[..., :-1])
    totals = pooled[..., :-1].sum(axis=1) if metric == "macro_precision" else pooled.sum(axis=2)
    low, high = intervals.percentile_interval((right / np.maximum(totals, 1)).mean(axis=1))
    return float(low), float(high)


def recall_interval(
    labelled: pd.DataFrame, classes: list[str], draws: int = 2000, seed: int = 0
) -> pd.DataFrame:
    """Percent of correct captures of each class (``recall``) with its interval; NaN without any."""
    counts = scores.confusion_table(labelled, classes).to_numpy()
    table = pd.DataFrame(
        {"recall": _recall_percent(counts), "low": np.nan, "high": np.nan}, index=classes
    )
    if labelled["subject"].nunique() >= few.FEWEST_FOR_INTERVAL:
        shares = _recall_percent(sample_confusions(labelled, classes, draws, seed))
        for i, drawn in enumerate(shares.T):
            seen = drawn[np.isfinite(drawn)]  # a class that nobody drawn has shown
            if len(seen):
                table.iloc[i, 1:] = intervals.percentile_interval(seen)
    return table


def _recall_percent(confusions: np.ndarray) -> np.ndarray:
    """Percent of each class [..., classes] of confusions, also of those with abstentions."""
    with np.errstate(invalid="ignore", divide="ignore"):
        right = np.einsum("...ii->...i", confusions[..., : confusions.shape[-2]])
        return 100 * right / confusions.sum(axis=-1)
