"""Losses under faults, as `bench stress` shows them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.reports.views.base import View
from bench.values.measures import Cell as Shown
from bench.values.measures import Cost, Measure, Row, percent, text

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from bench.values.candidate import Losses
    from bench.values.result import Result
    from bench.values.table import Table


def losses(row: Row) -> dict[str, float]:
    """Mean loss of accuracy under each fault, of a result."""
    names = str(row.get("faults", "")).split(", ")
    return {name: row[f"loss.{name}"] for name in names if f"loss.{name}" in row}


def _halves(row: Row) -> str:
    """Each fault with the severity at which half of the margin is lost, the lowest first."""
    halves = {
        k.removeprefix("half_margin."): v for k, v in row.items() if k.startswith("half_margin.")
    }
    lowest = sorted(halves.items(), key=lambda item: item[1])
    return (
        ", ".join(f"{fault.replace('_', ' ')} {severity:.1f}" for fault, severity in lowest)
        or "nowhere"
    )


def _mean_loss(row: Row) -> Shown:
    return 100 * sum(losses(row).values()) / len(losses(row)) if losses(row) else None


def _worst_fault(row: Row) -> Shown:
    worst = max(losses(row), key=losses(row).__getitem__, default="")
    return f"{worst.replace('_', ' ')} {100 * losses(row)[worst]:.1f}" if worst else None


def _of(part: str, whole: str) -> Any:
    """A number of a number."""
    return lambda row: f"{row[part]:.0f} of {row[whole]:.0f}" if part in row else None


_failing = _of(
    "failing_slices.under", "tested_slices.under"
)  # of captures as they are, and of damaged ones


ON_PAGE = (  # columns of the table on the page, before the worst groups of captures
    percent("accuracy", "clean %"),
    text("halves", "half of the margin is lost at", read=_halves),
    Measure("failing", "failing of tested groups", _failing),
)
CAPTION = (
    "faults and groups of captures on which each system fails. The number after each fault is the severity "
    "from 1 to 5 at which half of the margin over chance is lost. Groups are subjects, gestures, conditions, "
    "faults and pairs of these; failing groups have an accuracy significantly below that of the system "
    "(Benjamini-Hochberg). faults.csv has every severity; bench stress writes all groups, and learning curves."
)
HEAT = "Points of accuracy lost under each fault, mean over five severities, worst fault first."
_LOSS = Cost(
    "loss",
    unit="points",
    unknown="losses are of whole captures, in runs of bench stress with all these faults",
    command="stress faults={faults}",
    shows=(),
)


class Faults(View):
    """A damaged sensor is nothing to choose; its loss is a cost."""

    chooses: ClassVar[bool] = False
    section_heading: ClassVar[str] = "Faults"
    line: ClassVar[str] = "points of accuracy lost under each fault"
    more: ClassVar[str] = "loss."
    intervals: ClassVar[bool] = False
    heading: ClassVar[str] = (
        "Accuracy in percent of clean captures, mean over subjects, and mean loss in points over all faults"
    )
    shown: ClassVar[tuple[Measure, ...]] = (
        percent("accuracy", "clean"),
        Measure("mean_loss", "mean loss", _mean_loss),
        Measure("trained", "faults trained on", _of("faults_trained", "faults_tested"), spare=2),
        text("worst_fault", "worst fault", _worst_fault),
        Measure("failing", "failing groups", _failing),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        replace(
            _LOSS,
            key="fault_loss",
            noun="mean loss under faults",
            words="lost under faults",
            axis="points lost under faults (mean of all faults and severities)",
            help="largest mean loss under faults, in points of bench stress",
            among=lambda people: people.loss().mean(axis=1),
            section="faults.loss",
        ),
        replace(
            _LOSS,
            key="worst_fault",
            noun="loss under the worst fault",
            words="lost under the worst fault",
            axis="points lost under the worst fault",
            help="largest loss under the worst fault and severity, in points",
            among=lambda people: people.loss().max(axis=1),
            section="faults.worst",
        ),
    )

    def write(self, results: Sequence[Result], folder: Path) -> list[str]:
        """Write tables, figures and ``stability.md`` for the results of each context."""
        from bench.reports.stability_tables import write_all

        return write_all(results, folder)

    def on_page(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy, where each system fails first, and its worst groups of captures."""
        worst = dict.fromkeys(
            name for r in results for name in r.metrics if name.startswith("worst.")
        )
        return [*ON_PAGE, *(percent(name, name.replace(".", " ")) for name in worst)]

    def captions(self) -> tuple[str, str]:
        """Captions of the figure and of the table on the page."""
        return HEAT, CAPTION

    def drawn(self, results: Sequence[Result]) -> Figure | None:
        """Points lost under each fault; None where there are learning curves alone."""
        import pandas as pd

        from bench.reports.curves import heat_map

        lost = pd.DataFrame({r.method: losses(r) for r in results}).T
        return (
            heat_map(lost, [r["accuracy"] for r in results], ", ".join(results[0].context))
            if lost.size
            else None
        )

    def sheets(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Accuracy under each fault."""
        from bench.values.stability import joined

        return {"faults": joined(results, "faults")} if results else {}

    def lost(self, results: Sequence[Result], asked: Losses, reactions: Any) -> pd.DataFrame | None:
        """Points lost under each fault at each severity [cases, subjects], in some runs of one system."""
        from bench.reading.reactions import points_lost

        return points_lost(results, asked, reactions, self.key)

    def printed(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """A hint."""
        yield "To train a system on damaged copies too, add model.faults=all."
