"""Figures of the report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

MARKERS = "osD^vP*X<>"


def accuracy_time(table: pd.DataFrame, folder: Path) -> list[Path]:
    """Accuracy per capture against the time to label one capture, a panel for each data, subset and protocol.

    Bars are bootstrap intervals over subjects. Systems differ by marker and name, not only by colour.

    Args:
        table: as `reports.comparison.comparison` makes it.
        folder: where ``accuracy_time.png`` and ``.svg`` go.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = table[table["unit"].str.startswith("capture") & (table["unit"] != "capture vote")]
    panels = list(rows.groupby(["data", "subset", "protocol"], sort=False))
    wide = min(2, len(panels))
    high = -(-len(panels) // wide)
    fig, axes = plt.subplots(high, wide, figsize=(6.4 * wide, 4.6 * high), squeeze=False, layout="constrained")
    models = sorted({s.split(" · ")[0] for s in rows["system"]})
    for ax, ((data, subset, protocol), points) in zip(axes.flat, panels, strict=False):
        for row in points.itertuples():
            kind = models.index(row.system.split(" · ")[0])
            bars = None if np.isnan(row.low) else [[max(row.accuracy - row.low, 0)], [max(row.high - row.accuracy, 0)]]
            ax.errorbar(
                row.predict_ms_p50, row.accuracy, yerr=bars, fmt=MARKERS[kind % len(MARKERS)], color=f"C{kind % 10}",
                capsize=3, elinewidth=0.8, markersize=7,
            )  # fmt: skip
        ax.set_xscale("log")
        low, high_ = points["predict_ms_p50"].min(), points["predict_ms_p50"].max()
        ax.set_xlim(low / 1.8, high_ * 8)
        _name_points(ax, points)
        ax.set_title(f"{data}, {subset}\n{protocol}", fontsize=9)
        ax.set_xlabel("ms from raw frames to the label of one capture (p50, one thread)")
        ax.set_ylabel("captures labelled correctly, %")
        ax.grid(alpha=0.3)
    for ax in axes.flat[len(panels) :]:
        ax.set_axis_off()
    paths = [folder / "accuracy_time.png", folder / "accuracy_time.svg"]
    for path in paths:
        fig.savefig(path, dpi=130)
    plt.close(fig)
    return paths


def _name_points(ax: object, points: pd.DataFrame) -> None:
    """Names in a column right of all points, apart from each other, each tied to its point by a thin line."""
    low, high = ax.get_ylim()
    gap = (high - low) * 0.055
    right = points["predict_ms_p50"].max() * 1.7
    rows = points.sort_values("accuracy")
    heights = rows["accuracy"].to_numpy(dtype=float, copy=True)
    for i in range(1, len(heights)):
        heights[i] = max(heights[i], heights[i - 1] + gap)
    heights -= max(0.0, heights[-1] - (high - gap))
    for row, y in zip(rows.itertuples(), heights, strict=True):
        seed = f", seed {row.seed}" if row.seed not in ("0", "none") else ""
        ax.annotate(
            row.system + seed, (row.predict_ms_p50, row.accuracy), (right, y), fontsize=8, va="center",
            arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.6, "shrinkA": 1, "shrinkB": 4},
        )  # fmt: skip
