"""The published numbers beside ours, as a table of the report."""

from __future__ import annotations

import pandas as pd

from bench import few
from bench.measures import NONE, Measure, Row, known, text
from bench.reports.numbers import listed
from bench.table import Table, rows_of

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
        beside: table of `bench.reports.reproduction.against`.

    Returns:
        The table; the verdicts, each with how often it was given; how many rest on few subjects; whether HAART is here.
    """
    ends = {"low": "ours_low", "high": "ours_high"}
    rows = [
        row | {"away": row["verdict"] == "data not here", "words": _unit(row)}
        for row in rows_of(beside.rename(columns=ends))
    ]
    order = {on: i for i, on in reversed([*enumerate(tuple(row[k] for k in ("away", *SHARED)) for row in rows)])}
    rows.sort(key=lambda row: (row["away"], row["data"], order[tuple(row[k] for k in ("away", *SHARED))]))
    elsewhere = [NAMES.get(name, name) for name in sorted({row["data"] for row in rows if row["away"]})]
    have = "have" if len(elsewhere) > 1 else "has"
    switch = f"Also show the {sum(row['away'] for row in rows)} published numbers on {{}}, which {have} no runs here"
    return {
        "table": Table(
            COLUMNS,
            rows,
            remarks=[row["note"].split("\n") if row["note"] else [] for row in rows],
            groups=[_on(row) for row in rows],
            away=[row["away"] for row in rows],
            switch=switch.format(listed(elsewhere)) if elsewhere else "",
        ),
        "counts": beside.loc[beside["ours"].notna(), "verdict"].value_counts().to_dict(),
        "few": int((beside["subjects"] < few.INTERVAL).sum()),
        "haart": any(row["data"] == "haart" and not row["away"] for row in rows),
    }


def _unit(row: Row) -> str:
    return UNITS.get(row["unit_key"], row["unit"])


def _on(row: Row) -> str:
    """Data, subset, protocol and unit of a published number, in words."""
    parts = {"subset": row["subset"], "protocol": row["protocol"], "unit": row["words"]}
    words = [f"{name} not published" if text == "unknown" else text for name, text in parts.items()]
    return f"{NAMES.get(row['data'], row['data'])}: {'; '.join(words)}"


def _verdict(row: Row) -> str:
    lacking = row["subjects"] < few.INTERVAL  # False where ours is missing
    return few.too_few(int(row["subjects"])) if lacking else row["verdict"]


def _features(row: Row) -> str | None:
    """Features of a paper, and how many numbers they are."""
    words = known(row["features"]) or NONE
    return words if known(row["n_features"]) is None else f"{words} ({row['n_features']:.0f})"


COLUMNS = (
    text("system", read=lambda row: f"{row['reference']}: {row['classifier']}"),
    Measure("published", "published % ± SD", ("published", "published_sd"), "g", join=" ± "),
    Measure("ours", "ours % [95 %]", ends="ours"),
    text("verdict", read=_verdict),
    Measure("difference", form="+.1f"),
    Measure("subjects", form=".0f"),
    text("seed", read=lambda row: row["seed"] or None),
    text("features", read=_features),
    Measure("table4", "CNN85's Table 4", ("table4", "table4_sd"), "g", join=" ± "),
)
