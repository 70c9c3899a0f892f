"""Columns of the scores of recordings, on the page and as printed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.values.measures import TEXT, Measure, percent_measure
from touchbench_streams import RATES


def _refused_percent(row: Mapping[str, Any]) -> float | None:
    return 100 * row["refused"] if row.get("refused") else None


COLUMNS: tuple[Measure, ...] = (
    Measure("detector", source=lambda row: Path(row["watch.detector"]).name, form=TEXT, spare=1),
    Measure("auroc", "AUROC", form=".2f", spare=1),
    percent_measure("rejected_unknown", "rejected unknown", spare=1),
    percent_measure("rejected_known", "rejected known", spare=1),
    Measure("touches", form=".0f", spare=8),
    percent_measure("touches_found", "found"),
    Measure("fragments", "reports/touch", form=".2f"),
    percent_measure("first_correct", "first"),
    percent_measure("end_correct", "end", ends="end_correct"),
    Measure("false_alarms_per_hour", "alarms/h", ends="false_alarms_per_hour"),
    Measure("doubtful_reports", "alarms in ?", form=".0f", spare=2),
    Measure("latency_s_p50", "latency s", form=".2f"),
    Measure("latency_s_p90", "90 % s", form=".2f", spare=9),
    Measure("refused", source=_refused_percent, spare=3),
    percent_measure("merged", spare=10),
    percent_measure("late", spare=11),
    *(
        percent_measure(f"missed_at_{r}", f"missed at {r}/h", ends=f"missed_at_{r}", spare=12)
        for r in RATES
    ),
)
COLUMN_BY_KEY = {column.key: column for column in COLUMNS}
