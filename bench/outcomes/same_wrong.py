"""Captures that get the same wrong label from systems of all models: their label, or the sensor, may be at fault."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import pandas as pd

from bench.comparable import Row, seed_number
from bench.outcomes.runs import artifact, independent, rows_of
from bench.outcomes.scores import PREFIX, captures, classes_of
from bench.outcomes.store import Store

LEAST = 5  # models; fewer are too few to doubt a label
PROBABILITY = "mean probability"
COLUMNS = ["capture", "subject", "true", "predicted", PROBABILITY]  # before the conditions


@dataclass(frozen=True)
class Agreement:
    """The labels that systems of several models give the captures of a group.

    Attributes:
        group: captures and protocol, in words.
        run: tags of the most accurate run.
        systems: one of each model, best first.
        table: `agreement` of them.
    """

    group: str
    run: Row
    systems: list[str]
    table: pd.DataFrame

    @property
    def same_wrong(self) -> pd.DataFrame:
        """Captures with the same wrong label from all systems: ``table`` without ``right``, frequent pairs first."""
        rows = self.table[self.table["predicted"].notna() & (self.table["right"] == 0)]
        rows = rows.assign(right=-rows.groupby(["true", "predicted"])["capture"].transform("size"))
        return rows.sort_values(["right", "true", "predicted", "capture"], ignore_index=True).drop(columns="right")


def agreement(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """The label that systems agree on, of each capture that all were tested on.

    Args:
        tables: predictions of each system, as in `bench.outcomes.scores`. Folds that test a capture are averaged.

    Returns:
        ``capture``, ``subject``, ``true``, ``predicted`` (missing where systems differ), ``mean probability`` (of each
        system's label), the conditions, and ``right`` (number of systems with the correct label).
    """
    labelled = []
    for table in tables:
        table = table.assign(fold="")
        highest = table.groupby("capture", sort=False)[[PREFIX + c for c in classes_of(table)]].mean().max(axis=1)
        labelled.append(captures(table).assign(**{PROBABILITY: highest.to_numpy()}))
    rows = pd.concat(labelled, ignore_index=True).drop(columns=["fold", "start", "frames"])
    groups = rows.assign(right=rows["true"] == rows["predicted"]).groupby("capture")
    found = groups.first().assign(**{PROBABILITY: groups[PROBABILITY].mean()}, right=groups["right"].sum())
    found["predicted"] = found["predicted"].where(groups["predicted"].nunique() == 1)
    found = found[groups.size() == len(labelled)].reset_index()
    return found[[*COLUMNS, *found.columns.drop(COLUMNS)]]


def agreements(store: Store, groups: Mapping[str, pd.DataFrame]) -> list[Agreement]:
    """The agreement in the first group of each corpus with complete runs of `LEAST` models.

    The most accurate system speaks for its model, the first seed for a system. Runs that depend on the batch do not
    count.

    Args:
        store: store of the runs.
        groups: runs by group, for example from `reports.run_groups.largest_groups`.
    """
    found: dict[str, Agreement] = {}
    for group, runs in groups.items():
        complete = independent(runs[runs["status"] == "FINISHED"])
        seeds = complete.sort_values("seed", key=lambda c: c.map(seed_number), kind="stable").drop_duplicates("system")
        rows = rows_of(seeds.sort_values("accuracy", ascending=False, kind="stable").drop_duplicates("model_name"))
        paths = [artifact(store, run, "predictions.parquet") for run in rows]
        tables = {str(run["system"]): path for run, path in zip(rows, paths, strict=True) if path}
        if len(tables) >= LEAST and (digest := str(rows[0]["corpus_digest"])) not in found:
            found[digest] = Agreement(group, rows[0], list(tables), agreement(map(pd.read_parquet, tables.values())))
    return list(found.values())
