"""Runs on captures, as they are and in their circumstances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.ground.registry import views_of_circumstances
from bench.reports.views.base import View
from bench.values.columns import run_columns
from bench.values.measures import Measure
from bench.values.result import Result
from bench.values.table import Table

if TYPE_CHECKING:
    import pandas as pd

    from bench.reading.reactions import Reactions
    from bench.reports.sections import Exhibit
    from bench.values.candidate import Candidate


NAMED = 3  # systems that a line names


def applied_views(results: Sequence[Result]) -> Iterator[tuple[View, list[Result]]]:
    """Each circumstance that some results have, with these results."""
    for view in views_of_circumstances():
        if members := [r for r in results if view.applies_to(r)]:
            yield view, members


def warn_of_one_label(results: Sequence[Result]) -> str:
    """A warning of systems that predict one label for all test captures of a fold."""
    from bench.values.scores import label_captures

    systems = []
    for result in results:
        predictions = result.tables.get("predictions")
        if predictions is None:
            continue
        labels = (
            label_captures(predictions).groupby("fold", sort=False)[["true", "predicted"]].nunique()
        )
        if count := int(((labels["true"] > 1) & (labels["predicted"] == 1)).sum()):
            systems.append(f"{result['system']} in {count} of {len(labels)} folds")
    named = "; ".join(systems[:NAMED]) + (
        f" and {len(systems) - NAMED} more systems" if len(systems) > NAMED else ""
    )
    return f"warning: all test captures of a fold get the same label: {named}" if systems else ""


class Captures(View):
    """Accuracy and costs of captures as they are."""

    heading: ClassVar[str] = "Accuracy in percent: mean and SD over subjects"
    marks_best: ClassVar[bool] = True

    def further_output(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """A warning of systems that predict one label."""
        if line := warn_of_one_label(results):
            yield line

    def table_columns(self, results: Sequence[Result]) -> Sequence[Measure]:
        """The columns of runs that a terminal shows."""
        return run_columns("terminal")

    def next_command(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choose_command

        return choose_command(results)

    def draw_run(self, result: Result, folder: Path) -> None:
        """Draw confusions, and what each circumstance draws."""
        from bench.reports.details import draw_confusions

        draw_confusions(result, folder)
        for view, _ in applied_views([result]):
            view.draw_run(result, folder)

    def make_exhibits(self, results: Sequence[Result], folder: Path) -> list[Exhibit]:
        """No exhibits: all other sections of the page show runs on captures."""
        return []

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """No tables: ``comparison.csv`` has a row for each run."""
        return {}

    def clean_candidates(
        self, result: Result, reactions: Reactions, windows: bool
    ) -> Iterator[Candidate]:
        """The system in Python, on whole captures or on single windows."""
        from bench.reading.reactions import clean_candidate

        yield from _without_costs([clean_candidate(result, reactions, windows)], result, None)

    def candidates(
        self, result: Result, reactions: Reactions, latest_ms: float | None
    ) -> Iterator[Candidate]:
        """The system in each circumstance of the run."""
        for view, _ in applied_views([result]):
            if view.has_candidate(result):
                found = view.candidates(result, reactions, latest_ms)
                yield from _without_costs(found, result, view)

    def shared_costs(self, result: Result) -> dict[str, float]:
        """Numbers of its circumstances that hold for the system in other runs, too."""
        return {
            name: value
            for view, _ in applied_views([result])
            for name, value in view.shared_costs(result).items()
        }


def _without_costs(
    candidates: Iterable[Candidate], result: Result, mine: View | None
) -> Iterator[Candidate]:
    """Candidates without the costs of other circumstances of the run, unless these lend them."""
    others = [view for view, _ in applied_views([result]) if view is not mine]
    costs = [
        cost
        for v in others
        for cost in v.costs
        if cost.command and cost.source_name not in v.shared_costs(result)
    ]
    for each in candidates:
        yield replace(each, stored={cost.key: "" for cost in costs} | dict(each.stored))
