"""The published numbers, beside ours and recomputed from the papers' own tables, as tables of the report."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.outcomes import statistics
from reports import published_tables
from reports.layout import Table
from reports.numbers import bounded, listed, number, with_sd
from reports.paired_statistics import shown_statistics

NAMES = published_tables.CORPORA
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


def recomputed_section(tables: pd.DataFrame) -> dict[str, object]:
    """The numbers recomputed from the papers' own tables.

    Args:
        tables: `reports.published_tables.recomputed`.

    Returns:
        The rows of `tables`, the table as text, the exchanges of labels in Albawi et al. 2018, Table 3, and the paired
        statistics of Jung et al. 2017, Table 7.
    """
    frame = pd.DataFrame(
        {
            "table": tables["source"],
            "unit": tables["unit"],
            "claimed %": tables["claimed"].map("{:g}".format),
            "correct": [
                "not printed" if np.isnan(r.of) else f"{r.right:.0f} of {r.of:.0f}" for r in tables.itertuples()
            ],
            "pooled accuracy %": [number(v, 2) for v in tables["pooled"]],
            "macro recall %": [number(v, 2) for v in tables["macro_recall"]],
            "macro precision %": [number(v, 2) for v in tables["macro_precision"]],
            "claim is the pooled accuracy": tables["agrees"],
        }
    )
    subjects = published_tables.subjects_of_jung()
    subjects = subjects.loc[subjects.mean(axis=1).sort_values(ascending=False).index]
    rows = statistics.against_best(subjects, test_over_train=1 / (subjects.shape[1] - 1))
    exchanged = published_tables.swaps(published_tables.albawi_counts(), published_tables.jung_counts())
    return {
        "rows": tables.to_dict("records"),
        "table": Table(frame),
        "exchanged": exchanged.to_dict("records"),
        "printed": exchanged[exchanged["first"] == ""].iloc[0].to_dict(),
        "jung": Table(shown_statistics(rows)),
        "jung_subjects": subjects.shape[1],
        "jung_ranks": statistics.friedman(subjects),
    }
