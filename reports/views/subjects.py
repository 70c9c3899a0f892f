"""Accuracy by number of training subjects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.reports.views.base import View
from bench.values.measures import Measure, percent

if TYPE_CHECKING:
    import pandas as pd

    from bench.values.result import Result


class Subjects(View):
    """The learning curve; nobody ships a system that has learned less than it could."""

    noun: ClassVar[str] = "subjects"
    heading: ClassVar[str] = "Accuracy in percent by number of training subjects"
    chooses: ClassVar[bool] = False

    def shows(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy with each number of subjects."""
        begin = f"accuracy.{self.key}."
        numbers = {k.removeprefix(begin) for r in results for k in r.metrics if k.startswith(begin)}
        return [
            percent(f"at_{n}", f"{n} {self.noun}", begin + n, spare=1)
            for n in sorted(numbers, key=float)
        ]

    def section(self, results: Sequence[Result], folder: Path) -> None:
        """None: the curve is a figure of ``bench stress``, and ``bench choose`` tells what it promises."""

    def sheets(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """The curves of all systems."""
        from bench.values.stability import joined

        return {"learning": joined(results, "learning")} if results else {}
