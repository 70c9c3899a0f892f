"""Points that systems lose under faults, from their labels."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from bench.candidate import Losses
from bench.outcomes.reactions import Reactions
from bench.result import Result
from bench.words import CLEAN
from bench.work.curves import unharmed


def points_lost(results: Sequence[Result], asked: Losses, reactions: Reactions, key: str) -> pd.DataFrame | None:
    """Points lost [circumstances, subjects] in some runs of one system; None if a fault is not in any of them.

    These runs store labels, so the reaction is that to the most probable gesture, also of clean captures.
    """
    tested = [(r, {*str(r.get("faults", "")).split(", ")}) for r in sorted(results, key=lambda r: r["started"])]
    if not {*asked.names} <= {name for _, names in tested for name in names}:
        return None  # without reading any table
    lost: dict[tuple[str, int], pd.Series] = {}
    for result, names in tested:
        if not names & {*asked.names}:
            continue
        table = result.tables["labels"]
        under = (table["circumstance"] == key) & table["case"].isin(asked.names) & (table["level"] <= asked.severity)
        rows = pd.concat([unharmed(table), table[under]], ignore_index=True)
        keys = [rows["case"], rows["level"], rows["subject"].astype(str)]
        mean = 100 * pd.Series(reactions.mistakes(rows)).groupby(keys).mean().unstack()
        for fault, severity in {*mean.index} & {*asked.circumstances}:
            lost[fault, severity] = mean.loc[(fault, severity)] - mean.loc[(CLEAN, 0)]
    if not {*asked.circumstances} <= {*lost}:
        return None
    return pd.DataFrame({key: lost[key] for key in asked.circumstances}).T
