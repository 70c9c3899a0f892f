"""The figures that are kept with a run beside its tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.outcomes.comparable import context_of, method_of
from bench.outcomes.results import Findings


def illustrate(kind: str, tags: dict[str, str], findings: Findings, folder: Path) -> None:
    """Draw the confusions of a cell, accuracy against touch seen of a stream, or the timeline of a watch."""
    from reports import details, figures, streaming, watching

    if kind == "cell":
        group = ", ".join(context_of(tags))
        figure, caption = details.confusion_figure(findings.analysis, method_of(tags), group)
        figures.save(figure, folder, "confusion", group, caption)
    elif kind == "stream":
        streaming.figure([tags | findings.analysis], folder)
    elif kind == "watch" and findings.metrics.get("background_minutes"):  # without background, there is no rate
        tables = {"predictions": findings.tables["predictions.parquet"], "curve": findings.tables["curve.csv"]}
        row: dict[str, Any] = {**tags, **findings.metrics, **tables}
        figure = watching.watching_figure([row])
        figures.save(figure, folder, "watching", ", ".join(context_of(tags)), watching.caption(row))
