"""Systems beside each other, subject by subject: tables of paired tests and a strip plot."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench import few
from bench.comparable import notes_on
from bench.measures import Measure, p_value, text
from bench.outcomes import statistics
from bench.reports.figures import LINE, new_figure, plain, width_of
from bench.table import Table, rows_of

COLUMNS = (  # of `bench.outcomes.statistics.against_best`
    text("system"),
    Measure("accuracy", "mean over subjects %"),
    Measure("difference", form="+.1f", ends="difference"),
    Measure("p", "p Wilcoxon", form=p_value),
    Measure("p_holm", "p Holm", form=p_value),
    Measure("seeds", form=".0f", spare=1),
)


def statistics_table(rows: pd.DataFrame, data: str = "") -> Table:
    """Every system against the best one, or another one.

    Args:
        rows: `bench.outcomes.statistics.against_best`, with the number of ``seeds``.
        data: name of the corpus, for footnotes.
    """
    named = rows.rename(columns={"low": "difference_low", "high": "difference_high"})
    return Table(COLUMNS, rows_of(named), remarks=[notes_on(system, data) for system in rows["system"]])


def strip_plot(subjects: pd.DataFrame, group: str) -> tuple[Figure, str]:
    """A mark for the accuracy of each subject, with the mean and its t-interval; and the caption.

    Args:
        subjects: accuracy in percent [systems, subjects], best first; `statistics.RANKED` of them are drawn.
        group: captures and protocol, in words.
    """
    kept = subjects.iloc[: statistics.RANKED]
    margins = (width_of(kept.index) + 0.25, 0.15, 0.5, 0.35)
    figure, axes = new_figure((9.5, LINE * 1.5 * len(kept) + 0.85), margins=margins, title=group)
    ax = axes[0, 0]
    values, rows = kept.to_numpy(dtype=float), np.arange(len(kept))
    ax.plot(values.ravel(), rows.repeat(values.shape[1]), "|", color="0.35", markersize=8, markeredgewidth=1)
    low, high = np.array([statistics.interval(v) for v in values]).T.clip(0, 100)
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
