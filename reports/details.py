"""Figures of single runs, from their predictions and training: confusions, gestures, calibration, epochs.

Each comes with its caption; `reports.figures.save` writes it.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.outcomes import scores
from bench.outcomes.store import Store
from reports.figures import LINE, MARKERS, WIDEST, bars, log_ticks, new_figure, plain, width_of

BINS = 10
WRITTEN = 20  # classes up to which the numbers fit into their cells
HISTORY = {"loss": "training loss", "held_accuracy": "accuracy on held-out training subjects", "rate": "learning rate"}
FOLDS = 10  # of a run whose training is read and drawn


def confusion_figure(counts: pd.DataFrame, system: str, group: str) -> tuple[Figure, str]:
    """Counts and percent of each true class, side by side or, of many classes, one above the other.

    Args:
        counts: of captures [true, predicted].
        system: whose they are.
        group: captures and protocol, in words.
    """
    values = counts.to_numpy(dtype=float)
    share = 100 * values / np.maximum(values.sum(axis=1, keepdims=True), 1)
    k = len(counts)
    side = max(2.4, 0.34 * min(k, WRITTEN))
    edge = width_of(counts.columns) + 0.4
    beside = 2 * (side + edge) + 0.4 <= WIDEST
    size = (2 * (side + edge) + 0.4, side + edge + 0.75) if beside else (side + edge + 0.2, 2 * (side + edge) + 1.15)
    title = f"{plain([system])[0]}\n{group}"
    margins, between = (edge, 0.2, edge, 0.75), (edge + 0.2, edge + 0.4)
    figure, axes = new_figure(size, (1, 2) if beside else (2, 1), margins, between, title)
    for ax, shown, words in zip(axes.flat, (values, share), ("captures", "% of the true gesture"), strict=True):
        ax.pcolormesh(np.arange(k + 1) - 0.5, np.arange(k + 1) - 0.5, share, cmap="Blues", vmin=0, vmax=100)
        ax.set(aspect="equal", ylim=(k - 0.5, -0.5), xlabel="predicted", ylabel="true", title=words)
        ax.set_xticks(np.arange(k), plain(counts.columns), rotation=90)
        ax.set_yticks(np.arange(k), plain(counts.index))
        for i, j in np.argwhere(shown) if k <= WRITTEN else ():
            colour = "white" if share[i, j] > 60 else "black"
            ax.text(j, i, f"{shown[i, j]:.0f}", ha="center", va="center", color=colour)
    unwritten = "" if k <= WRITTEN else " The numbers are in the run's confusion.csv."
    return figure, f"Confusion of captures by {system}: counts, and percent of each true gesture.{unwritten}"


def recall_interval(labelled: pd.DataFrame, classes: list[str], draws: int = 2000, seed: int = 0) -> pd.DataFrame:
    """Percent of each class that is labelled correctly, with a 95 % bootstrap interval over subjects.

    Args:
        labelled: captures with ``subject``, ``true`` and ``predicted``.
        classes: in the order of the rows.
        draws: of the bootstrap, whole subjects with replacement.
        seed: of the draws.

    Returns:
        ``recall``, ``low``, ``high`` by class; NaN where there is no capture, no interval of a single subject.
    """
    hit = (labelled["true"] == labelled["predicted"]).groupby([labelled["subject"], labelled["true"]])
    right, total = (
        part.unstack(fill_value=0).reindex(columns=classes, fill_value=0) for part in (hit.sum(), hit.size())
    )
    n = len(total)
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), draws)
    with np.errstate(invalid="ignore", divide="ignore"):  # a class that nobody drawn has shown
        shares = 100 * (drawn @ right.to_numpy()) / (drawn @ total.to_numpy())
        recall = 100 * right.sum().to_numpy() / total.sum().to_numpy()
    low, high = (np.full(len(classes), np.nan) for _ in range(2))
    for c in range(len(classes)):
        seen = shares[np.isfinite(shares[:, c]), c]
        if n > 1 and len(seen):
            low[c], high[c] = np.quantile(seen, [0.025, 0.975])
    return pd.DataFrame({"recall": recall, "low": low, "high": high}, index=classes)


def gesture_figure(tables: dict[str, pd.DataFrame], group: str) -> tuple[Figure, str]:
    """Percent of each gesture that is labelled correctly, with intervals over subjects, for some systems.

    Args:
        tables: `recall_interval` by system.
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
    ax.set(ylim=(len(classes) - 0.4, -0.6), xlim=(-2, 102), xlabel="captures of the gesture labelled correctly, %")
    ax.grid(axis="x", alpha=0.25)
    figure.legend(loc="lower center", ncols=1, frameon=False)
    return figure, (
        "Captures of each gesture labelled correctly, with 95 % bootstrap intervals over subjects, one seed each."
    )


def calibration(predictions: pd.DataFrame) -> tuple[pd.DataFrame, float] | None:
    """How often captures labelled with a given confidence are labelled correctly.

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
        ax.set(xlabel="highest probability", ylabel="share labelled correctly")
        ax.set_title(f"{plain([system])[0]}\nexpected calibration error {gap:.3f}")
        ax.grid(alpha=0.25)
    return figure, (
        "Reliability of the probabilities of whole captures in ten bins; the area of a dot is its share of captures, "
        "the dashed line is perfect."
    )


def histories(store: Store, run_id: str) -> dict[str, dict[str, np.ndarray]]:
    """What training tracked, by metric and fold, [epochs, 2]: epoch and value.

    The first `FOLDS` folds; empty for a system without epochs.
    """
    folds = store.finished_folds(run_id)[:FOLDS]
    values = {
        m: {f.data.tags["touchbench.fold"]: store.history(f.info.run_id, m) for f in folds if m in f.data.metrics}
        for m in HISTORY
    }
    long = {m: by_fold for m, by_fold in values.items() if any(len(v) > 1 for v in by_fold.values())}
    return long if values["loss"] else {}


def training_figure(systems: dict[str, dict], group: str) -> tuple[Figure, str]:
    """A column for each system, a row for each metric, a line for each fold.

    Args:
        systems: `histories` by system.
        group: captures and protocol, in words.
    """
    metrics = [m for m in HISTORY if any(m in history for history in systems.values())]
    size = (4.1 * len(systems) + 0.5, 2.3 * len(metrics) + 1.05)
    figure, axes = new_figure(size, (len(metrics), len(systems)), (0.8, 0.15, 0.65, 0.6), (0.85, 0.35), group)
    for column, (system, history) in enumerate(systems.items()):
        for ax, metric in zip(axes[:, column], metrics, strict=True):
            for values in history.get(metric, {}).values():
                ax.plot(*values.T, color="tab:blue", alpha=0.55, linewidth=0.9, marker="." if len(values) < 3 else None)
            if metric not in history:
                ax.text(0.5, 0.5, f"{metric}: not tracked", transform=ax.transAxes, ha="center", color="0.5")
                ax.set_axis_off()
            elif metric == "rate":
                ax.set_yscale("log")
                log_ticks(ax.yaxis)
            ax.set_ylabel(HISTORY[metric].replace("held-out ", "held-out\n"))
            ax.grid(alpha=0.25)
        axes[0, column].set_title(plain([system])[0])
        axes[-1, column].set_xlabel("epoch")
    return figure, "Training by epoch, one line for each of at most ten folds, the lowest seed of each system."
