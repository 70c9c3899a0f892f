"""Captures that get the same wrong label from systems of all models: their label, or the sensor, may be at fault."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from bench.comparable import seed_number
from bench.result import Result
from bench.scores import ABSTAINED, PREFIX, captures, classes_of

LEAST = 5  # models; fewer are too few to doubt a label
PROBABILITY = "mean probability"
COLUMNS = ["capture", "subject", "true", "predicted", PROBABILITY]  # before the conditions


@dataclass(frozen=True)
class Agreement:
    """The labels that systems of several models give the captures of a group.

    Attributes:
        group: captures and protocol, in words.
        run: the most accurate result.
        systems: one of each model, best first.
        table: `agreement` of them.
    """

    group: str
    run: Result
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
        tables: predictions of each system, as in `bench.scores`. Folds that test a capture are averaged.

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
    alike = (groups["predicted"].nunique() == 1) & (found["predicted"] != ABSTAINED)
    found["predicted"] = found["predicted"].where(alike)
    found = found[groups.size() == len(labelled)].reset_index()
    return found[[*COLUMNS, *found.columns.drop(COLUMNS)]]


def agreements(groups: Mapping[str, Sequence[Result]]) -> list[Agreement]:
    """The agreement in the first group of each corpus with complete results of `LEAST` models.

    The most accurate system speaks for its model, the first seed for a system. Results that depend on the batch do not
    count.

    Args:
        groups: results by group, for example from `bench.reports.run_groups.largest_groups`.
    """
    found: dict[str, Agreement] = {}
    for group, results in groups.items():
        seeds: dict[str, Result] = {}
        for r in sorted(results, key=lambda r: seed_number(r["seed"])):
            if r.complete and r.alone:
                seeds.setdefault(r.system, r)
        models: dict[str, Result] = {}
        for r in sorted(seeds.values(), key=lambda r: -r["subject_accuracy_mean"]):
            models.setdefault(r["model_name"], r)
        tables = {r.system: t for r in models.values() if (t := r.tables.get("predictions")) is not None}
        best = next(iter(models.values()), None)
        if best is not None and len(tables) >= LEAST and best["corpus_digest"] not in found:
            found[best["corpus_digest"]] = Agreement(group, best, list(tables), agreement(tables.values()))
    return list(found.values())
