"""Runs on captures, as they are and in their circumstances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.ground.registry import circumstance_views
from bench.reports.views.base import View
from bench.values.columns import run_columns
from bench.values.measures import Measure
from bench.values.result import Result
from bench.values.table import Table

if TYPE_CHECKING:
    import pandas as pd

    from bench.values.candidate import Candidate, Wish


NAMED = 3  # systems that a line names


def held(results: Sequence[Result]) -> Iterator[tuple[View, list[Result]]]:
    """Each circumstance that some results have, with these results."""
    for view in circumstance_views():
        if members := [r for r in results if view.holds(r)]:
            yield view, members


def one_label(results: Sequence[Result]) -> str:
    """A warning of systems that predict one label for all test captures of a fold with several classes."""
    from bench.values.scores import captures

    systems = []
    for result in results:
        predictions = result.tables.get("predictions")
        if predictions is None:
            continue
        labels = captures(predictions).groupby("fold", sort=False)[["true", "predicted"]].nunique()
        if count := int(((labels["true"] > 1) & (labels["predicted"] == 1)).sum()):
            systems.append(f"{result['system']} in {count} of {len(labels)} folds")
    named = "; ".join(systems[:NAMED]) + (
        f" and {len(systems) - NAMED} more systems" if len(systems) > NAMED else ""
    )
    return f"warning: all test captures of a fold get the same label: {named}" if systems else ""


class Captures(View):
    """Accuracy and costs of captures as they are."""

    heading: ClassVar[str] = "Accuracy in percent: mean and SD over subjects"
    ranked: ClassVar[bool] = True
    searches: ClassVar[bool] = True

    def printed(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """A warning of systems that predict one label."""
        if line := one_label(results):
            yield line

    def shows(self, results: Sequence[Result]) -> Sequence[Measure]:
        """The columns of runs that a terminal shows."""
        return run_columns("terminal")

    def then(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choosing

        return choosing(results)

    def figure(self, result: Result, folder: Path) -> None:
        """Draw confusions, and what each circumstance draws."""
        from bench.reports.details import draw

        draw(result, folder)
        for view, _ in held([result]):
            view.figure(result, folder)

    def section(self, results: Sequence[Result], folder: Path) -> None:
        """None: the page is of captures."""

    def sheets(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """None: ``comparison.csv`` has a row for each run."""
        return {}

    def offers(self, result: Result, wish: Wish) -> bool:
        """Whether a run has a candidate."""
        if wish.windows:
            return result.metrics.get("windows", 0) > 0
        return True

    def candidates(self, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system in Python, on whole captures or on windows, and in each circumstance of the run."""
        from bench.reading.reactions import plain_candidates

        if wish.plain:
            yield from _without([plain_candidates(result, wish)], result, None)
        if not wish.windows:
            for view, _ in held([result]):
                if view.offers(result, wish):
                    yield from _without(view.candidates(result, wish), result, view)

    def lends(self, result: Result) -> dict[str, float]:
        """Numbers of its circumstances that hold for the system in other runs, too."""
        return {
            name: value for view, _ in held([result]) for name, value in view.lends(result).items()
        }


def _without(ways: Iterable[Candidate], result: Result, mine: View | None) -> Iterator[Candidate]:
    """Candidates without the costs of other circumstances of the run, unless these lend them."""
    others = [view for view, _ in held([result]) if view is not mine]
    costs = [
        cost
        for v in others
        for cost in v.costs
        if cost.command and cost.source not in v.lends(result)
    ]
    for way in ways:
        yield replace(way, stored={cost.key: "" for cost in costs} | dict(way.stored))
