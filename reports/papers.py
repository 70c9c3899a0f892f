"""The published numbers beside ours, as a table of the report."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.outcomes import statistics
from reports.layout import Table
from reports.numbers import bounded, listed, number, with_sd

NAMES = {"cost": "CoST", "haart": "HAART"}
SHARED = ["data", "subset", "protocol", "words"]  # of published numbers that stand together
UNITS = {
    "capture": "captures",
    "subject mean": "captures, mean over subjects",
    "capture vote": "captures, majority vote",
    "window": "windows",
    "window macro precision": "windows, macro precision",
    "window macro recall": "windows, macro recall",
}


def published_section(beside: pd.DataFrame) -> dict[str, object]:
    """Every published number beside ours; numbers on corpora that nothing is tracked on wait behind a switch.

    Args:
        beside: table of `reports.reproduction.against`.

    Returns:
        The table; the verdicts, each with how often it was given; how many rest on few subjects; whether HAART is here.
    """
    units = [UNITS.get(r.unit_key, r.unit) for r in beside.itertuples()]
    beside = beside.assign(away=beside["verdict"] == "data not here", words=units)
    together = beside.groupby(["away", *SHARED], sort=False).ngroup()
    beside = beside.iloc[np.lexsort([together, beside["data"], beside["away"]])]  # the last key first
    rows = [*beside.itertuples()]
    frame = pd.DataFrame(
        {
            "system": [f"{r.reference}: {r.classifier}" for r in rows],
            "published % ± SD": [with_sd(r.published, r.published_sd, "g") for r in rows],
            "ours % [95 %]": [bounded(r.ours, r.low, r.high) for r in rows],
            "verdict": [_verdict(r) for r in rows],
            "difference": [number(r.difference, sign=True) for r in rows],
            "our SD": beside["ours_sd"].map(number),
            "subjects": [number(r.subjects, 0) for r in rows],
            "seed": beside["seed"].replace("", "-"),
            "features": [_features(r) for r in rows],
            "CNN85's Table 4": [with_sd(r.table4, r.table4_sd, "g") for r in rows],
        }
    )
    elsewhere = [NAMES.get(name, name) for name in sorted(set(beside.loc[beside["away"], "data"]))]
    have = "have" if len(elsewhere) > 1 else "has"
    switch = f"Also show the {int(beside['away'].sum())} published numbers on {{}}, which {have} no runs here"
    return {
        "table": Table(
            frame,
            [r.note.split("\n") if r.note else [] for r in rows],
            groups=[_on(r) for r in rows],
            away=[*beside["away"]],
            switch=switch.format(listed(elsewhere)) if elsewhere else "",
        ),
        "counts": beside.loc[beside["ours"].notna(), "verdict"].value_counts().to_dict(),
        "few": int((beside["subjects"] < statistics.FEW_SUBJECTS).sum()),
        "haart": "haart" in set(beside.loc[~beside["away"], "data"]),
    }


def _on(row: object) -> str:
    """Data, subset, protocol and unit of a published number, in words."""
    parts = {"subset": row.subset, "protocol": row.protocol, "unit": row.words}
    words = [f"{name} not published" if text == "unknown" else text for name, text in parts.items()]
    return f"{NAMES.get(row.data, row.data)}: {'; '.join(words)}"


def _verdict(row: object) -> str:
    few = row.subjects < statistics.FEW_SUBJECTS  # False where ours is missing
    return f"{row.verdict}, {row.subjects:.0f} subject{'s' * (row.subjects != 1)} only" if few else row.verdict


def _features(row: object) -> str:
    """Features of a paper, and how many numbers they are."""
    words = row.features if isinstance(row.features, str) else "-"
    return words if pd.isna(row.n_features) else f"{words} ({row.n_features:.0f})"
