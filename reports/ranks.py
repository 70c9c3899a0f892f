"""Systems beside each other, subject by subject: a table, critical-difference diagram and strip plot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bench.outcomes import statistics
from reports.figures import LINE, Picture, new_figure, plain, save, width_of
from reports.layout import Table, footnotes
from reports.numbers import bounded, count, notes_on, one, p_value, signed, span

STATISTICS = (
    "Difference is in points with its 95 % t-interval; corrected is the same with Nadeau and Bengio's variance, "
    "which allows for training captures that folds share (- where there is one fold); p is Wilcoxon's signed rank "
    "test, Holm's correction is for all systems of the table; dz is Cohen's effect size of paired differences with "
    "its 95 % interval, r the matched-pairs rank-biserial correlation. Seeds are averaged within subjects. To claim "
    "that a system is better than another cite p Holm; the verdict on top picks by one standard error, which is a rule "
    "of selection, no test."
)


def statistics_table(rows: pd.DataFrame, caption: str, data: str) -> Table:
    """The block of `shown_statistics`, with footnotes.

    Args:
        rows: as `bench.outcomes.statistics.against_best` makes them.
        caption: of the table.
        data: name of the corpus.
    """
    marks, notes = footnotes([notes_on(system, data) for system in rows["system"]])
    return Table(shown_statistics(rows), caption, marks=marks, notes=notes)


def matrix(subjects: pd.DataFrame, pairs: pd.DataFrame, group: str) -> Table:
    """Every pair of systems: the difference above the diagonal, the corrected p below it.

    Args:
        subjects: accuracy in percent [systems, subjects], best first.
        pairs: `bench.outcomes.statistics.pairs` of them.
        group: in words.
    """
    names = [*subjects.index]
    place = {name: i for i, name in enumerate(names)}
    cells = np.full((len(names), len(names)), "\N{MIDDLE DOT}", dtype=object)
    for row in pairs.itertuples():
        i, j = place[row.system], place[row.other]
        cells[i, j], cells[j, i] = signed(row.difference), p_value(row.p_holm)
    frame = pd.DataFrame(cells, columns=[str(i) for i in range(1, len(names) + 1)])
    frame.insert(0, "system", [f"{i} {name}" for i, name in enumerate(names, 1)])
    least = min(1, 2.0 ** (1 - subjects.shape[1]) * len(pairs))
    caption = (
        f"{group}: every pair of the {len(names)} most accurate systems, paired over {subjects.shape[1]} subjects. "
        "Above the diagonal: accuracy of the row less that of the column, in points. Below it: p of the two-sided "
        f"Wilcoxon test with Holm's correction for these {len(pairs)} pairs, which is stricter than against the best. "
    )
    if least >= 0.05:
        caption += (
            f"The smallest p that so few subjects can give here is {least:.2g}, so no pair can reach 0.05; "
            "bench.compare tests two systems that you name beforehand. "
        )
    return Table(frame, caption + "Intervals and numbers of subjects that gain and lose are in pairs.csv.")


def shown_statistics(rows: pd.DataFrame) -> pd.DataFrame:
    """`bench.outcomes.statistics.against_best` as text."""
    frame = {
        "system": rows["system"],
        "mean over subjects %": rows["accuracy"].map(one),
        "difference": [bounded(r.difference, r.low, r.high, sign=True) for r in rows.itertuples()],
        "corrected": [span(r.nb_low, r.nb_high) for r in rows.itertuples()],
        "p corrected": rows["nb_p"].map(p_value),
        "p Wilcoxon": rows["p"].map(p_value),
        "p Holm": rows["p_holm"].map(p_value),
        "dz": [bounded(r.dz, r.dz_low, r.dz_high, sign=True, digits=2) for r in rows.itertuples()],
        "r": rows["rank_biserial"].map(lambda v: "-" if np.isnan(v) else f"{v:+.2f}"),
    }
    if "seeds" in rows:
        frame["seeds"] = rows["seeds"].map(count)
    return pd.DataFrame(frame)


def difference_diagram(ranks: statistics.Ranks, group: str, folder: Path, name: str, left_out: int = 0) -> Picture:
    """Mean ranks with bars that join systems which Nemenyi's test does not tell apart.

    Args:
        ranks: of the systems, at most `reports.statistics.RANKED` of them.
        group: in words.
        folder: where the files go.
        name: of the files.
        left_out: systems of lower accuracy that are not ranked.
    """
    k, cliques = len(ranks.mean), ranks.cliques()
    margins = (width_of(ranks.mean.index) + 0.25, 0.15, 0.5, 0.35)
    figure, axes = new_figure((9.5, LINE * 1.15 * (k + 1.4) + 0.85), margins=margins, title=group)
    ax = axes[0, 0]
    ax.plot(ranks.mean, np.arange(k), "o", color="tab:blue", markersize=5, zorder=3)
    ax.set_yticks(np.arange(k), plain(ranks.mean.index))
    ax.set_ylim(k - 0.4, -1.8)
    low, high = 1, k
    step = (high - low) * 0.035
    ax.plot([low, low + ranks.critical], [-1.1, -1.1], color="0.2", linewidth=2, marker="|")
    ax.text(low + ranks.critical + step / 2, -1.1, f"critical difference {ranks.critical:.1f}", va="center")
    for position, (first, last) in enumerate(cliques):
        x = high + step * (1.2 + position)
        ax.plot([x, x], [first - 0.25, last + 0.25], color="0.2", linewidth=3, solid_capstyle="butt")
    ax.set_xlim(low - step, high + step * (len(cliques) + 2))
    ax.set_xticks(range(1, k + 1, max(1, round(k / 12))))
    ax.set_xlabel(f"mean rank over {ranks.subjects} subjects (1 is best)")
    ax.grid(axis="both", alpha=0.25)
    found = "not defined" if np.isnan(ranks.p) else f"p = {ranks.p:.2g}"
    caption = (
        "Another procedure, and a more conservative one: mean ranks, which depend on all systems of the figure. A bar "
        "on the right joins systems whose mean ranks differ by less than Nemenyi's critical difference (5 %, all "
        f"pairs). No sentence or table is based on it. Friedman's test: {found}."
        + (f" {left_out} systems of lower accuracy are not ranked." if left_out else "")
    )
    return save(figure, folder, name, "ranks", group, caption)


def strip_plot(subjects: pd.DataFrame, group: str, folder: Path, name: str) -> Picture:
    """A mark for the accuracy of each subject, with the mean and its t-interval.

    Args:
        subjects: accuracy in percent [systems, subjects], best first; `reports.statistics.RANKED` of them are drawn.
        group: in words.
        folder: where the files go.
        name: of the files.
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
    ax.set_yticks(np.arange(len(kept)), plain(kept.index))
    ax.set_ylim(len(kept) - 0.4, -0.6)
    ax.set_xlabel("captures of the subject labelled correctly, %")
    ax.grid(axis="x", alpha=0.25)
    left = len(subjects) - len(kept)
    caption = (
        f"Each tick is one of {subjects.shape[1]} subjects, the dot their mean, the bar its 95 % t-interval. Seeds are "
        "averaged." + (f" {left} systems of lower accuracy are left out." if left else "")
    )
    return save(figure, folder, name, "subjects", group, caption)
