"""Accuracy by number of training subjects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from bench.reports.views.base import View
from bench.values.measures import Measure, percent_measure

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from bench.values.result import Result


class Subjects(View):
    """The learning curve."""

    noun: ClassVar[str] = "subjects"
    section_heading: ClassVar[str] = "Fewer training subjects"
    heading: ClassVar[str] = "Accuracy in percent by number of training subjects"
    section_summary: ClassVar[str] = "accuracy with fewer training subjects"

    def table_columns(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy with each number of subjects."""
        begin = f"accuracy.{self.key}."
        numbers = {k.removeprefix(begin) for r in results for k in r.metrics if k.startswith(begin)}
        columns = []
        for number in sorted(numbers, key=float):
            heading = f"{number} subject{'s' * (number != '1')}"
            columns.append(percent_measure(f"at_{number}", heading, begin + number, spare=1))
        return columns

    def page_captions(self) -> tuple[str, str]:
        """Captions of the figure and of the table on the page."""
        caption = "accuracy by number of training subjects"
        return f"{caption}; means over subjects, 95 % t-intervals.", f"{caption}."

    def draw_for_page(self, results: Sequence[Result]) -> Figure:
        """Accuracy against the number of training subjects."""
        from bench.reports.curves import draw_curves

        lines = []
        for i, r in enumerate(results):
            curve = r.tables["learning"].rename(columns={"train_subjects": "level"})
            lines.append((i, r.system_with_seed, curve))
        return draw_curves("training subjects", lines)

    def has_candidate(self, result: Result) -> bool:
        """False: nobody ships a system that has learned less than it could."""
        return False

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """The curves of all systems."""
        from bench.values.stability import concat_tables

        return {"learning": concat_tables(results, "learning")}
