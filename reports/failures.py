"""Tables on runs under faults: failing groups, ranks, labels that change with the seed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from bench.values.measures import Measure, percent_measure, text_measure
from bench.values.result import Result
from bench.values.stability import clean_labels
from bench.values.table import Table, rows_of_frame

WORST = 10  # failing groups of a system
GROUP_COLUMNS = (
    text_measure("group", source="slice"),
    Measure("correct", source=lambda row: f"{row['right']} of {row['captures']}"),
    Measure("subjects", form=".0f"),
    percent_measure("accuracy"),
    percent_measure("gap", "below system by"),
    Measure("p_corrected", "corrected p", form=".2g"),
)
GROUPS = (
    "failing groups of captures without a fault, the largest gap first, at most 10 of each system. "
    "slices.csv has all groups, also under faults, and conditions.csv every subject, gesture and "
    "condition."
)
RANKS = (
    "rank of each system by accuracy under each fault, mean over severities. Kendall's tau "
    "compares the order with that on clean captures: 1 is the same, -1 the reverse."
)
SEEDS = "clean captures whose label differs between seeds of a system."


def failure_tables(
    results: Sequence[Result], losses: Sequence[Mapping[str, float]], seeds: Sequence[Result]
) -> Iterator[tuple[str, Table]]:
    """Captions and tables of comparable results, one of each system, and of their ``seeds``.

    ``losses`` has the mean loss of each result under each fault.
    """
    tables = {
        GROUPS: failing_groups(results),
        RANKS: fault_ranks(results, losses),
        SEEDS: changed_labels(seeds),
    }
    for caption, table in tables.items():
        if len(table):
            yield caption, table


def failing_groups(results: Sequence[Result]) -> Table:
    """The worst groups of captures without a fault on which each system fails."""
    rows, systems = [], []
    for r in results:
        if (slices := r.tables.get("slices")) is not None:
            failing = slices[slices["failing"] & (slices["fault"] == "")]
            worst = failing.sort_values("gap", ascending=False).head(WORST)
            rows += rows_of_frame(worst)
            systems += [r.system_with_seed] * len(worst)
    return Table(GROUP_COLUMNS, rows, groups=systems)


def fault_ranks(results: Sequence[Result], losses: Sequence[Mapping[str, float]]) -> Table:
    """Rank of each system (1 is best) when clean and under each fault; empty for one system."""
    columns = {}
    for r, lost in zip(results, losses, strict=True):
        under_faults = {fault: r["accuracy"] - points for fault, points in lost.items()}
        columns[r.system_with_seed] = {"clean": r["accuracy"]} | under_faults
    accuracies = pd.DataFrame(columns).dropna().round(9)  # faults that each system was tested under
    if len(accuracies) < 2 or len(results) < 2:
        return Table((), ())
    clean = accuracies.loc["clean"]
    tau = [kendalltau(clean, under_fault).statistic for _, under_fault in accuracies.iterrows()]
    ranks = accuracies.rank(axis=1, ascending=False).assign(tau=tau).rename_axis("fault")
    measures = [
        text_measure("fault", source=lambda row: row["fault"].replace("_", " ")),
        *(Measure(r.system_with_seed, form="g") for r in results),
        Measure("tau", "Kendall's tau", form=".2f"),
    ]
    return Table(measures, rows_of_frame(ranks.reset_index()))


def changed_labels(results: Sequence[Result]) -> Table:
    """Number of clean captures whose label changes with the seed, of each system with several."""
    labels: dict[str, dict[str, pd.Series]] = {}
    for r in results:
        if (table := r.tables.get("labels")) is not None:
            predicted = clean_labels(table).set_index(["fold", "capture"])["predicted"]
            labels.setdefault(r["system"], {})[r["seed"]] = predicted
    rows = []
    for system, by_seed in labels.items():
        if len(by_seed) > 1:
            shared = pd.concat(by_seed.values(), axis=1, join="inner")
            changed = int(np.sum(shared.nunique(axis=1) > 1))
            share = f"{changed} of {len(shared)}"
            rows.append({"system": system, "seeds": ", ".join(by_seed), "changed": share})
    columns = text_measure("system"), text_measure("seeds"), Measure("changed", "changed labels")
    return Table(columns, rows)
