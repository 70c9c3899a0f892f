"""Losses under faults, as `bench stress` shows them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.reports.views.base import View
from bench.values.measures import Cost, Measure, Row, percent_measure, text_measure
from bench.values.measures import Value as Shown

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from bench.reading.reactions import Reactions
    from bench.reports.sections import Exhibit
    from bench.values.result import Result
    from bench.values.table import Table


def losses_by_fault(row: Row) -> dict[str, float]:
    """Mean loss of accuracy under each fault, of a result."""
    names = str(row.get("faults", "")).split(", ")
    return {name: row[f"loss.{name}"] for name in names if f"loss.{name}" in row}


def _half_margin_words(row: Row) -> str:
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
    return (
        100 * sum(losses_by_fault(row).values()) / len(losses_by_fault(row))
        if losses_by_fault(row)
        else None
    )


def _worst_fault(row: Row) -> Shown:
    worst = max(losses_by_fault(row), key=losses_by_fault(row).__getitem__, default="")
    return f"{worst.replace('_', ' ')} {100 * losses_by_fault(row)[worst]:.1f}" if worst else None


def _count_of(part: str, whole: str) -> Any:
    """A number of a number."""
    return lambda row: f"{row[part]:.0f} of {row[whole]:.0f}" if part in row else None


_failing = _count_of(
    "failing_slices.under", "tested_slices.under"
)  # of captures as they are, and of damaged ones


ON_PAGE = (  # columns of the table on the page, before the worst groups of captures
    percent_measure("accuracy", "clean %"),
    text_measure("halves", "half of the margin is lost at", source=_half_margin_words),
    Measure("failing", "failing of tested groups", _failing),
)
CAPTION = (
    "faults and groups of captures on which each system fails. The number after each fault is the "
    "severity from 1 to 5 at which half of the margin over chance is lost. Groups are subjects, "
    "gestures, conditions, faults and pairs of these; failing groups have an accuracy "
    "significantly below that of the system (Benjamini-Hochberg). faults.csv has every severity, "
    "half_margins.csv the size of the fault at half of the margin."
)
TABLES = ("faults", "conditions", "slices")  # CSV files of the report
HEAT = "Points of accuracy lost under each fault, mean over five severities, worst fault first."
_LOSS = Cost(
    "loss",
    unit="points",
    why_unknown="losses are of whole captures, in runs of bench stress with all these faults",
    command="stress faults={faults}",
    shows=(),
)


class Faults(View):
    """Accuracy under faults; the loss is a cost of a choice."""

    section_heading: ClassVar[str] = "Faults"
    section_summary: ClassVar[str] = "points of accuracy lost under each fault"
    heading: ClassVar[str] = (
        "Accuracy in percent of clean captures, mean over subjects, and mean loss in points over "
        "all faults"
    )
    columns: ClassVar[tuple[Measure, ...]] = (
        percent_measure("accuracy", "clean"),
        Measure("mean_loss", "mean loss", _mean_loss),
        Measure(
            "trained", "faults trained on", _count_of("faults_trained", "faults_tested"), spare=2
        ),
        text_measure("worst_fault", "worst fault", _worst_fault),
        Measure("failing", "failing groups", _failing),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        replace(
            _LOSS,
            key="fault_loss",
            noun="mean loss under faults",
            phrase="lost under faults",
            axis="points lost under faults (mean of all faults and severities)",
            help="largest mean loss under faults, in points of bench stress",
            of_people=lambda people: people.mean_losses().mean(axis=1),
            section="faults.loss",
        ),
        replace(
            _LOSS,
            key="worst_fault",
            noun="loss under the worst fault",
            phrase="lost under the worst fault",
            axis="points lost under the worst fault",
            help="largest loss under the worst fault and severity, in points",
            of_people=lambda people: people.mean_losses().max(axis=1),
            section="faults.worst",
        ),
    )

    def make_exhibits(self, results: Sequence[Result], folder: Path) -> list[Exhibit]:
        """Losses, failing groups, ranks and changed labels, for each set of comparable results."""
        from bench.reports.failures import failure_tables
        from bench.reports.sections import Exhibit, comparable_groups, view_exhibit

        exhibits = []
        for i, (words, runs) in enumerate(comparable_groups(results, more="loss."), 1):
            main = replace(view_exhibit(self, words, runs, folder, i), sentences=[])
            exhibits.append(main)
            values, context = runs[0].values_to_agree, ", ".join(runs[0].context)
            seeds = [r for r in results if r.is_complete and r.values_to_agree == values]
            losses = [losses_by_fault(r) for r in runs]
            for caption, table in failure_tables(runs, losses, seeds):
                exhibits.append(Exhibit(main.heading, table=table, caption=f"{context}: {caption}"))
        return exhibits

    def page_columns(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy, where each system fails first, and its worst groups of captures."""
        worst = dict.fromkeys(
            name for r in results for name in r.metrics if name.startswith("worst.")
        )
        return [*ON_PAGE, *(percent_measure(name, name.replace(".", " ")) for name in worst)]

    def page_captions(self) -> tuple[str, str]:
        """Captions of the figure and of the table on the page."""
        return HEAT, CAPTION

    def draw_for_page(self, results: Sequence[Result]) -> Figure | None:
        """Points lost under each fault; None where there are learning curves alone."""
        import pandas as pd

        from bench.reports.curves import draw_heat_map

        lost = pd.DataFrame({r.system_with_seed: losses_by_fault(r) for r in results}).T
        return (
            draw_heat_map(lost, [r["accuracy"] for r in results], ", ".join(results[0].context))
            if lost.size
            else None
        )

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Accuracy under each fault, half margins, and accuracy of all groups of captures."""
        from bench.values.stability import concat_tables

        tables = {name: concat_tables(results, name) for name in TABLES}
        return tables | {"half_margins": concat_tables(results, "margins")}

    def has_candidate(self, result: Result) -> bool:
        """False: nobody chooses a damaged sensor."""
        return False

    def losses_by_subject(
        self, results: Sequence[Result], faults: Sequence[str], severity: int, reactions: Reactions
    ) -> pd.DataFrame | None:
        """Points lost under each fault at each severity [cases, subjects] of one system."""
        from bench.reading.reactions import points_lost

        return points_lost(results, faults, severity, reactions, self.key)

    def further_output(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """A hint."""
        yield "To train a system on damaged copies too, add model.faults=all."
