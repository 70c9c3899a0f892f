"""What is shown of a circumstance, and of the runs of a study: tables, sections, files, candidates of a choice.

Nothing heavy is imported at the top of a view's file, so that help knows all costs. No key of a run depends on it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.ground.words import LABELS
from bench.values.measures import Cost, Measure, percent
from bench.values.result import Result, shared
from bench.values.table import Table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from bench.reports.contexts import Section
    from bench.values.candidate import Candidate, Losses, Wish


class View:
    """How results are shown, and chosen by.

    Args:
        key: key of the circumstance or study; empty for captures.
        tracked: names of its options as parameters of a run; a run that has the first has the circumstance.
        tag: tag of the runs of a study; empty for a circumstance.
    """

    heading: ClassVar[str] = ""  # of the table of results
    shown: ClassVar[
        tuple[Measure, ...]
    ] = ()  # columns of that table, after system, data, subset and protocol
    ranked: ClassVar[bool] = False  # the most accurate result of several is marked in it
    searches: ClassVar[bool] = False  # what a search has chosen in each fold is printed
    score: ClassVar[str] = "accuracy"  # number by which results are ranked
    costs: ClassVar[tuple[Cost, ...]] = ()  # further costs by which systems are chosen
    # Parameters that two results share if they may be compared: words with ``{}`` for the value, and the usual value,
    # which needs no words.
    alike: ClassVar[Mapping[str, tuple[str, str]]] = {}
    noun: ClassVar[str] = ""  # for what its levels count, such as "captures of each class"
    chooses: ClassVar[bool] = True  # its cases are candidates of a choice
    apart: ClassVar[bool] = False  # runs of a study are chosen among alone
    unit: ClassVar[str] = ""  # words for what is labelled
    other: ClassVar[str] = ""  # words for runs that another value of `alike` keeps apart
    meaning: ClassVar[str] = ""  # of the score, in a sentence
    section_heading: ClassVar[str] = ""  # of its section of the page; empty for ``heading``
    line: ClassVar[str] = ""  # beside that heading
    more: ClassVar[str] = (
        ""  # begins names of numbers: of two runs of a system, the page has the one with more of them
    )
    intervals: ClassVar[bool] = True  # its figure or table on the page has intervals

    def __init__(self, key: str, tracked: tuple[str, ...], tag: str = "") -> None:
        self.key, self.tracked, self.tag = key, tracked, tag

    def holds(self, result: Result) -> bool:
        """Whether a run is of the study, or has the circumstance in all folds."""
        if self.tag:
            return result.kind == self.tag
        return self.key not in result.failed and self.tracked[0] in result.about

    def shows(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy in each case, and the mean loss; its own columns alone where it counts nothing."""
        if not self.noun:
            return self.shown
        curves = [table for r in results if (table := r.tables.get(self.key)) is not None]
        cases = dict.fromkeys(case for table in curves for case in table["case"])
        levels = {
            case: {*(n for t in curves for n in t["level"][t["case"] == case])} for case in cases
        }
        columns = [
            percent(f"{case}_at_{n:g}", self.words_of(case, n), f"accuracy.{case}.{n:g}", spare=1)
            for case in cases
            for n in sorted(levels[case])
        ]
        return [*columns, percent("loss", "mean loss", f"loss.{self.key}"), *self.shown]

    def words_of(self, case: str, level: float) -> str:
        """A case in words: its name if it has one, and its level."""
        return f"{case}, " * (case != self.key) + f"{level:g} {self.noun or self.key}"

    def title(self, results: Sequence[Result]) -> str:
        """Heading of the table of some results."""
        return self.heading

    def printed(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """What a command prints behind the table of its results."""
        return iter(())

    def write(self, results: Sequence[Result], folder: Path) -> list[str]:
        """Write tables and figures of scored results into the folder of ``out=``; lines that say so.

        Raises:
            InputError: the folder cannot be written.
        """
        return []

    def then(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        return "bench report"

    def figure(self, result: Result, folder: Path) -> None:
        """Draw what MLflow's page shows of a run into a folder; ``bench ui`` does it, once."""

    def section(self, results: Sequence[Result], folder: Path) -> Section | None:
        """A figure and a table of each set of comparable systems."""
        from bench.reports.contexts import section

        return section(self, results, folder)

    def on_page(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Columns of the table on the page, after the system."""
        return self.shows(results)

    def captions(self) -> tuple[str, str]:
        """Captions of the figure and of the table on the page."""
        by = f"accuracy by {self.noun or self.key}"
        return (
            f"{by}; means over subjects, 95 % t-intervals; dotted: captures as they are.",
            self.heading or by,
        )

    def drawn(self, results: Sequence[Result]) -> Figure | None:
        """The figure on the page: accuracy against the level."""
        from bench.reports.curves import levels

        return levels(self.key, self.noun or self.key, results)

    def sheets(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """CSV files of the report, by name: the curves of all systems."""
        from bench.values.stability import joined

        return {self.key: joined(results, self.key)} if results else {}

    def offers(self, result: Result, wish: Wish) -> bool:
        """Whether a run has a candidate."""
        return self.chooses

    def candidates(self, result: Result, wish: Wish) -> Iterable[Candidate]:
        """The system in each case, scored by whole captures."""
        from bench.values.candidate import Candidate

        told = shared(result, self.alike)
        table = result.tables[LABELS]
        for (case, level), rows in table[table["circumstance"] == self.key].groupby(
            ["case", "level"], sort=False
        ):
            yield Candidate(
                ", ".join([self.words_of(case, level), *told]), wish.reactions.scores(rows)
            )

    def lends(self, result: Result) -> dict[str, float]:
        """Numbers of its costs that hold for the system in other runs, too; those of a study are of its runs alone."""
        if self.tag:
            return {}
        names = [cost.source for cost in self.costs if cost.among is None]
        return {name: result.metrics[name] for name in names if name in result.metrics}

    def lost(self, results: Sequence[Result], asked: Losses, reactions: Any) -> pd.DataFrame | None:
        """Points lost in some cases [cases, subjects], for costs of losses; None if it knows none."""
        return None

    def gestures(self, result: Result) -> tuple[str, ...]:
        """All gestures of the captures of a run."""
        from bench.values.scores import classes_of

        tables = (result.tables.get(name) for name in ("predictions", *result.tables))
        every = (classes_of(table) for table in tables if table is not None)
        return tuple(next(filter(None, every), ()))

    def chosen(self, row: Mapping[str, Any]) -> str:
        """What to say of a chosen candidate, by its costs."""
        return ""
