"""Training curves of networks, and accuracy against the length of the window."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from bench.outcomes import runs as tracked
from bench.outcomes.store import Store
from reports.figures import MARKERS, Picture, new_figure, plain, save

HISTORY = {"loss": "training loss", "held_accuracy": "accuracy on held-out training subjects", "rate": "learning rate"}


CAPTION = "Training by epoch, one line for each of at most ten folds, the lowest seed of each system."
FOLDS = 10  # of a run that are read and drawn


def histories(store: Store, run: dict) -> dict[str, dict[str, np.ndarray]]:
    """What training tracked, by metric and fold, [epochs, 2]: epoch and value.

    The first `FOLDS` folds; empty for a system without epochs.
    """
    folds = store.finished_folds(run["run_id"])[:FOLDS]
    tracked = [m for m in HISTORY if any(m in f.data.metrics for f in folds)]
    if "loss" not in tracked:
        return {}
    found = {
        m: {f.data.tags["touchbench.fold"]: store.history(f.info.run_id, m) for f in folds if m in f.data.metrics}
        for m in tracked
    }
    return {m: by_fold for m, by_fold in found.items() if any(len(v) > 1 for v in by_fold.values())}


def training_figure(found: dict[str, dict], group: str, folder: Path, name: str) -> Picture:
    """A column for each system, a row for each metric, a line for each fold.

    Args:
        found: `histories` by system.
        group: in words.
        folder: where the files go.
        name: of the files.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    metrics = [m for m in HISTORY if any(m in h for h in found.values())]
    size = (4.1 * len(found) + 0.5, 2.3 * len(metrics) + 1.05)
    figure, axes = new_figure(size, (len(metrics), len(found)), (0.8, 0.15, 0.65, 0.6), (0.85, 0.35), group)
    for column, (system, history) in enumerate(found.items()):
        for row, metric in enumerate(metrics):
            ax = axes[row, column]
            for values in history.get(metric, {}).values():
                ax.plot(*values.T, color="tab:blue", alpha=0.55, linewidth=0.9, marker="." if len(values) < 3 else None)
            if metric not in history:
                ax.text(0.5, 0.5, f"{metric}: not tracked", transform=ax.transAxes, ha="center", color="0.5")
                ax.set_axis_off()
            elif metric == "rate":
                ax.set_yscale("log")
                ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                ax.yaxis.set_major_formatter("{x:g}")
                ax.yaxis.set_minor_formatter(NullFormatter())
            ax.set_ylabel(HISTORY[metric].replace("held-out ", "held-out\n"))
            ax.grid(alpha=0.25)
        axes[0, column].set_title(plain([system])[0])
        axes[-1, column].set_xlabel("epoch")
    return save(figure, folder, name, "training", group, CAPTION)


def lengths(store: Store, runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Accuracy against window length of systems that are tracked at several, with all else the same.

    Args:
        store: where they are; one predictions table a system is read for the frame rate.
        runs: of one group.

    Returns:
        By system without its frames: ``frames``, ``ms``, ``accuracy``, ``low``, ``high`` (percent, means over seeds).
    """
    if not {"model.frames", "touchbench.arguments"} <= set(runs):
        return {}
    runs = runs[(runs["status"] == "FINISHED") & runs["model.frames"].astype(str).str.fullmatch(r"\d+")]
    runs = runs.assign(frames=runs["model.frames"].astype(int), base=runs["touchbench.arguments"].map(_without_frames))
    found = {}
    for base, part in runs.groupby("base"):
        if not base or part["frames"].nunique() < 2:
            continue
        predictions = tracked.predictions(store, part.iloc[0].to_dict())
        if predictions is None:
            continue
        ms = part["observed_ms"].iloc[0] / predictions["frames"].median()
        table = part.reindex(columns=["frames", "accuracy", "accuracy_low", "accuracy_high"]).groupby("frames").mean()
        table = (100 * table.set_axis(["accuracy", "low", "high"], axis=1)).reset_index()
        found[base] = table.assign(ms=table["frames"] * ms)
    return found


def _without_frames(arguments: object) -> str:
    """A system by its typed arguments but for the frames of a window: ``cnn85[epochs=2]``; ``""`` if not known."""
    if not isinstance(arguments, str):
        return ""
    typed = json.loads(arguments)
    values = [
        f"{k.removeprefix('model.')}={v}" for k, v in typed.items() if k.startswith("model.") and k != "model.frames"
    ]
    return typed["model"] + (f"[{', '.join(values)}]" if values else "")


def length_figure(found: dict[str, pd.DataFrame], group: str, folder: Path, name: str) -> Picture:
    """Accuracy per capture against the frames of a window, with milliseconds above.

    Args:
        found: `lengths` of the group.
        group: in words.
        folder: where the files go.
        name: of the files.
    """
    figure, axes = new_figure((7.5, 4.6), margins=(0.7, 0.2, 0.5, 0.85), title=group)
    ax = axes[0, 0]
    for i, (system, table) in enumerate(found.items()):
        y = table["accuracy"].to_numpy()
        bars = np.nan_to_num([y - table["low"], table["high"] - y]).clip(0)
        ax.errorbar(
            table["frames"],
            y,
            yerr=bars,
            marker=MARKERS[i % len(MARKERS)],
            color=f"C{i}",
            capsize=3,
            elinewidth=0.8,
            linewidth=1,
            label=plain([system])[0],
        )
    table = next(iter(found.values()))
    ms = table["ms"].iloc[0] / table["frames"].iloc[0]
    above = ax.secondary_xaxis("top", functions=(lambda f: f * ms, lambda t: t / ms))
    above.set_xlabel("ms")
    ax.set_xlabel("frames of a window")
    ax.set_ylabel("captures labelled correctly, %")
    ax.grid(alpha=0.25)
    ax.legend(frameon=False)
    caption = (
        "Captures labelled correctly by window length, with 95 % bootstrap intervals over subjects. A length picked "
        "from this curve has seen the test subjects; bench choose picks it inside the training part."
    )
    return save(figure, folder, name, "lengths", group, caption)
