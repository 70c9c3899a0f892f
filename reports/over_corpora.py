"""The ranking of systems over several corpora as a table, sentences and a figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import pandas as pd
from matplotlib.figure import Figure

from bench.comparable import notes_on
from bench.measures import Cell, Interval, Measure, Row, known, p_value, text
from bench.outcomes import statistics
from bench.outcomes.ranking import Ranking, distinct, ranking
from bench.outcomes.runs import by_subject
from bench.reports.figures import LINE, bars, new_figure, plain, width_of
from bench.reports.numbers import listed
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table, rows_of

NAMED = 20  # systems that a sentence names
CAPTION = (
    "Systems over several corpora, lowest mean rank first, with 95 % bootstrap intervals: people are drawn with "
    "replacement within each corpus. Accuracy is the mean over all people. Behind the first: difference in points, "
    "paired over all people, with its 95 % t-interval and the p of Wilcoxon's test after Holm's correction. Place: by "
    "mean accuracy on the corpus alone; equal systems share the mean place. Kendall's tau is 1 for equal orders."
)


@dataclass(frozen=True)
class OverCorpora:
    """A ranking in words.

    Attributes:
        title: ranked captures and protocols.
        found: the ranking.
        sentences: unit, number of people, agreement of the corpora, and everything left out.
        table: the ranking as text, `statistics.RANKED` systems at most.
        caption: meaning of the columns.
    """

    title: str
    found: Ranking
    sentences: list[str]
    table: Table
    caption: str = CAPTION


def of_runs(groups: Mapping[str, Sequence[Result]]) -> list[OverCorpora]:
    """The rankings of stored runs, one for each subset and target.

    Args:
        groups: results from `bench.outcomes.runs.grouped`.
    """
    sections = []
    for chosen, left_out in distinct(groups):
        parts = []
        for data, group in chosen.items():
            rows = by_subject([r for r in groups[group] if r.alone])[0].rename_axis("system").reset_index()
            parts.append(rows.melt("system", var_name="subject", value_name="accuracy").assign(data=data))
        if found := ranking(pd.concat(parts)):
            notes: dict[str, list[str]] = {}
            for data, system in product(found.people, found.table["system"]):
                notes.setdefault(system, []).extend(notes_on(system, data))
            sections.append(section(found, chosen, left_out, notes))
    return sections


def section(
    found: Ranking, about: Mapping[str, str], left_out: Mapping[str, str], notes: Mapping[str, list[str]]
) -> OverCorpora:
    """A ranking in words.

    Args:
        found: the ranking.
        about: captures and protocol of each corpus.
        left_out: reason by name of a system or corpus that was left out before.
        notes: footnotes by system.
    """
    title, total = "; ".join(about[data] for data in found.people), sum(found.people.values())
    counts = listed([f"{n} of {data}" for data, n in found.people.items()], len(found.people))
    lacking: dict[str, list[str]] = {}
    for system, corpora in found.lacking.items():
        lacking.setdefault(listed(corpora, len(corpora)), []).append(system)
    reasons = dict(left_out) | dict.fromkeys(found.unranked, "too few systems in common with the ranked corpora")
    kept = found.table.iloc[: statistics.RANKED]
    lines = sentences(
        *("bench.reports", "sentences", "over_corpora"),
        title=title,
        total=total,
        counts=counts,
        synthetic="(synthetic)" in title,
        taus=found.taus,
        lacking={corpora: listed(systems, NAMED) for corpora, systems in lacking.items()},
        left_out=reasons,
        shown=len(kept),
        ranked=len(found.table),
    )
    lines += statistics.warnings(total, len(found.table), min(found.people.values()), mixed=False)
    remarks = [notes.get(system, []) for system in kept["system"]]
    table = Table(_columns([*found.people]), rows_of(kept), "over several corpora", remarks=remarks)
    return OverCorpora(title, found, lines, table)


def _columns(corpora: list[str]) -> list[Measure]:
    """Columns of a ranking."""

    def place(data: str) -> Callable[[Row], str]:
        return lambda row: f"{row[f'{data}_accuracy']:.1f} ({row[f'{data}_place']:g})"

    def rank(row: Row) -> Cell:
        return (
            Interval(row["mean_rank"], row["low"], row["high"]) if known(row["low"]) is not None else row["mean_rank"]
        )

    return [
        text("system"),
        Measure("mean_rank", "mean rank [95 %]", rank, ".2f"),
        Measure("accuracy", "accuracy %", spare=1),
        Measure("difference", "behind the first [95 %]", form="+.1f", ends="difference"),
        Measure("p_holm", "p Holm", form=p_value, spare=2),
        *(Measure(f"{data}_place", f"{data} % (place)", place(data)) for data in corpora),
    ]


def rank_plot(over: OverCorpora) -> tuple[Figure, str]:
    """The mean rank of each system with its interval; and the caption."""
    kept, people = over.found.table.iloc[: statistics.RANKED], sum(over.found.people.values())
    margins = (width_of(kept["system"]) + 0.25, 0.15, 0.5, 0.35)
    figure, axes = new_figure((9.5, LINE * 1.5 * len(kept) + 0.85), margins=margins, title=over.title)
    ax, rows = axes[0, 0], range(len(kept))
    ends = bars(*(kept[name].to_numpy() for name in ("mean_rank", "low", "high")))
    ax.errorbar(kept["mean_rank"], rows, xerr=ends, fmt="o", color="tab:blue", markersize=5, capsize=3)
    ax.set_yticks(rows, plain(kept["system"]))
    ax.set(ylim=(len(kept) - 0.4, -0.6), xlabel=f"mean rank within {people} people (1: most accurate)")
    ax.grid(axis="x", alpha=0.25)
    return figure, (
        f"Mean rank of each system over {people} people of {len(over.found.people)} corpora, with its 95 % bootstrap "
        "interval. Overlapping intervals are no test of a difference, since the people are the same for all systems."
    )
