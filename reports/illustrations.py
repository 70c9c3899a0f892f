"""The figures that are kept with a run beside its tables."""

from __future__ import annotations

from pathlib import Path

from bench.outcomes.comparable import context_of, method_of
from bench.outcomes.results import Findings


def illustrate(kind: str, tags: dict[str, str], findings: Findings, folder: Path) -> None:
    """Draw what there is of a kind of run into a folder: confusions, or accuracy against touch seen."""
    match kind:
        case "cell":
            from reports.details import confusion_figure

            group = ", ".join(context_of(tags))
            confusion_figure(findings.analysis, method_of(tags), group, folder, "confusion")
        case "stream":
            from reports.streaming import figure

            figure([tags | findings.analysis], folder)
