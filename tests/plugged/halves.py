"""Accuracy on the second half of the captures of each person: a whole study, as a package would add it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from bench import scores
from bench.candidate import Candidate, Wish
from bench.circumstances.base import Study, option
from bench.measures import Cost, Measure, percent, text
from bench.options import Command
from bench.reports.figures import new_figure, save
from bench.reports.part import Part, Section
from bench.reports.views.base import View
from bench.result import Result
from bench.table import Table
from bench.work.fold import computing, decisions, fitted, footprint
from bench.work.results import FoldResult, costs, table_of

COMMAND = Command("compare", "score late captures", "Leaves out the first captures of each person.", makes="halves")


@dataclass(frozen=True)
class Halves(Study):
    """A system is fitted as usual, and tested on what is left after the first captures of each person."""

    key: ClassVar[str] = "halves"
    view: ClassVar[str] = "halves:Shown"

    share: float = option(0.5, "share of the captures to leave out", type="number")

    def fold(self, cell, corpus, fold, threads) -> FoldResult:
        """Fit, and decide on the late test captures."""
        late = fold.test[round(self.share * len(fold.test)) :]
        system = cell.estimator()
        with computing(threads):
            metrics = fitted(system, corpus[fold.train])
            table = decisions(system, corpus, fold.name, late)
        return FoldResult(fold.name, table, metrics | footprint(system, corpus))

    def result(self, plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Accuracy, and how many captures it is of."""
        table = table_of(folds)
        people = scores.per_subject(scores.captures(table))
        numbers = costs(folds) | scores.summary(table, plan.corpus.rate_hz) | {"tested": float(people["n"].sum())}
        return Result(about, numbers, {"predictions": table, "per_subject": people})


class Shown(View):
    heading = "Accuracy in percent on late captures"
    shown: tuple[Measure, ...] = (percent("accuracy", "late %"), Measure("tested", form=".0f"))
    costs = (Cost("tested", unit="captures", noun="test captures", help="most test captures", column=False),)

    def section(self, results: Sequence[Result], folder: Path) -> Section:
        """Bars of all systems, and their table."""
        figure, axes = new_figure((6, 3))
        axes[0, 0].bar(np.arange(len(results)), [100 * r["accuracy"] for r in results])
        picture = save(figure, folder, "0-halves", results[0].context[0], "Accuracy on late captures.")
        table = Table([text("system", read=lambda r: r.method), *self.shown], results)
        return Section("Late captures", [Part(picture, table, self.heading)])

    def sheets(self, results: Sequence[Result]):
        """The table as numbers."""
        return {"halves": Table([text("system", read=lambda r: r.method), *self.shown], results).frame()}

    def candidates(self, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system on late captures."""
        people = result.tables["per_subject"].set_index("subject")
        yield Candidate("late captures", 100 * people["accuracy"], mark="late")
