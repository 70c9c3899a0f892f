"""One ranking of systems over several corpora, by their ranks within each person (Demsar 2006).

Corpora differ in gestures, sensors and people, so their accuracies are not on one scale. Ranks
within a person are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from bench.reading import statistics
from bench.reading.frame import accuracy_by_subject
from bench.reports.sections import Exhibit
from bench.values import few
from bench.values.intervals import draw_weights, percentile_interval
from bench.values.measures import Measure, text_measure
from bench.values.result import Result, footnotes_of_system
from bench.values.table import Table, rows_of_frame

SAME = ("synthetic", "subset", "target", "protocol")  # tags that all ranked corpora share
COLUMNS = (
    "system mean_rank low high accuracy difference difference_low difference_high p_holm".split()
)
SUMMARY = "systems ranked within each person"
CAPTION = (
    "{}: mean rank of each system over {} people, 1 for the most accurate, with 95 % bootstrap "
    "intervals (people drawn within each corpus); then accuracy (and place) on each corpus. Ranks "
    "depend on which systems are compared. Whether anyone is in two corpora is unknown. "
    "ranking.csv has paired differences to the first system."
)


def rank_over_corpora(groups: Mapping[str, Sequence[Result]]) -> dict[str, pd.DataFrame]:
    """A table of `rank_systems` for each subset and target of LOSO runs on several corpora.

    Corpora that were joined or changed at import do not count, since their people are those of
    another corpus.
    """
    sets: dict[tuple[str, ...], list[tuple[str, Sequence[Result]]]] = {}
    largest = lambda group: max((r.get("subjects", 0), r["started"]) for r in group[1])  # noqa: E731
    for name, results in sorted(groups.items(), key=largest, reverse=True):
        first = results[0]
        if (
            first["protocol_name"] == "loso"
            and "+" not in first["data"]
            and not first.get("touchbench.changes")
        ):
            sets.setdefault(tuple(str(first[tag]) for tag in SAME), []).append((name, results))
    found = {}
    for _, members in sorted(
        (key, each) for key, each in sets.items() if len({r[0]["data"] for _, r in each}) > 1
    ):
        chosen: dict[str, str] = {}
        tables: dict[str, pd.DataFrame] = {}
        for name, results in members:
            data, digest = str(results[0]["data"]), str(results[0]["corpus_digest"])
            if (
                data not in tables and digest not in chosen.values()
            ):  # the largest version of a corpus counts
                chosen[name] = digest
                tables[data] = accuracy_by_subject([r for r in results if r.predicts_alone])[0]
        if (table := rank_systems(tables)) is not None:
            names = [
                name for name, data in zip(chosen, tables, strict=True) if f"{data}_place" in table
            ]
            found["; ".join(names)] = table
    return found


def rank_systems(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame | None:
    """Systems by their mean rank within each person; None unless two are on two corpora.

    Ranked are the corpora with the most results, systems that have all of them times people.
    """
    tables = {data: table.dropna().round(9) for data, table in tables.items()}
    sets = [names for n in range(2, len(tables) + 1) for names in combinations(tables, n)]
    shared = {
        names: sorted(set.intersection(*({*tables[name].index} for name in names)))
        for names in sets
    }
    people = {names: [tables[name].shape[1] for name in names] for names in sets}
    sets = [names for names in sets if len(shared[names]) > 1]
    if not sets:
        return None
    names = max(sets, key=lambda names: (len(shared[names]) * sum(people[names]), len(names)))
    parts = {name: tables[name].loc[shared[names]] for name in names}
    ranks = [rankdata(-part, axis=0) for part in parts.values()]
    everyone = pd.concat(parts, axis=1)
    made = {
        "system": shared[names],
        "mean_rank": np.hstack(ranks).mean(axis=1),
        "low": np.nan,
        "high": np.nan,
    }
    table = pd.DataFrame(made | {"accuracy": everyone.mean(axis=1).to_numpy()})
    if min(people[names]) >= few.FEWEST_FOR_INTERVAL:
        sums = [
            each @ drawn.T for each, drawn in zip(ranks, draw_weights(people[names]), strict=True)
        ]
        table["low"], table["high"] = percentile_interval(
            np.sum(sums, axis=0) / sum(people[names]), axis=1
        )
    for name, part in parts.items():
        mean = part.mean(axis=1).round(9).to_numpy()
        table[f"{name}_accuracy"], table[f"{name}_place"] = mean, rankdata(-mean)
    table = table.sort_values(
        ["mean_rank", "accuracy"], ascending=[True, False], kind="stable", ignore_index=True
    )
    tests = statistics.compare_with_base(everyone.loc[table["system"]])
    tests = tests.rename(columns={"low": "difference_low", "high": "difference_high"})
    table = table.merge(tests[["system", *COLUMNS[5:]]], on="system")
    table.attrs["people"] = sum(people[names])
    return table[[*COLUMNS, *table.columns.drop(COLUMNS)]]


def ranking_exhibits(found: Mapping[str, pd.DataFrame]) -> list[Exhibit]:
    """A small table for each ranking."""
    exhibits = []
    for title, table in found.items():
        corpora = [name.removesuffix("_place") for name in table if name.endswith("_place")]
        columns = [
            text_measure("system"),
            Measure("mean_rank", "mean rank [95 %]", form=".2f", ends="mean_rank"),
        ]
        columns += [text_measure(f"{data} % (place)") for data in corpora]
        rows = rows_of_frame(
            table.rename(columns={"low": "mean_rank_low", "high": "mean_rank_high"}).head(
                statistics.RANKED
            )
        )
        for row, data in product(rows, corpora):
            row[f"{data} % (place)"] = f"{row[f'{data}_accuracy']:.1f} ({row[f'{data}_place']:g})"
        remarks = [
            [note for data in corpora for note in footnotes_of_system(row["system"], data)]
            for row in rows
        ]
        caption = CAPTION.format(title, table.attrs["people"])
        shown = Table(columns, rows, remarks=remarks)
        exhibits.append(Exhibit("Over several corpora", None, shown, caption, summary=SUMMARY))
    return exhibits
