"""The base of all views: tables, exhibits, files and candidates of a circumstance or run kind.

Nothing heavy is imported at the top of a view's file, so that help knows all costs. No key of a run
depends on it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.values.measures import Cost, Measure, percent_measure
from bench.values.result import LABELS_TABLE, Result, setting_phrases
from bench.values.table import Table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from bench.reading.reactions import Reactions
    from bench.reports.sections import Exhibit
    from bench.values.candidate import Candidate


class View:
    """Shows the results of a circumstance or study, and finds the candidates in them.

    Args:
        key: key of the circumstance or study; ``run`` for captures.
        tracked: names of its options as parameters of a run, which has the circumstance if it has
            the first one.
        tag: kind of the runs of captures or of a study; empty for a circumstance.
    """

    # Heading of the table of results, and its columns after system, data, subset and protocol.
    heading: ClassVar[str] = ""
    columns: ClassVar[tuple[Measure, ...]] = ()
    marks_best: ClassVar[bool] = False  # True if the table marks the most accurate of several
    score: ClassVar[str] = "accuracy"  # number by which results are ranked
    costs: ClassVar[tuple[Cost, ...]] = ()  # further costs by which systems are chosen
    # Parameters that two results share if they may be compared: words with ``{}`` for the value,
    # and the usual value, which needs no words.
    shared_parameters: ClassVar[Mapping[str, tuple[str, str]]] = {}
    noun: ClassVar[str] = ""  # for what its levels count, such as "captures of each class"
    section_heading: ClassVar[str] = ""  # of its section of the page; empty for ``heading``
    section_summary: ClassVar[str] = ""  # line beside that heading

    def __init__(self, key: str, tracked: tuple[str, ...], tag: str = "") -> None:
        self.key, self.tracked, self.tag = key, tracked, tag

    @property
    def shows_run_kind(self) -> bool:
        """True for the runs of a study, which are chosen among themselves."""
        return self.tag == self.key

    def applies_to(self, result: Result) -> bool:
        """True if a run is of the study, or has the circumstance in all folds."""
        if self.tag:
            return result.kind == self.tag
        return self.key not in result.failed_circumstances and self.tracked[0] in result.attributes

    def table_columns(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy in each case and the mean loss, then ``columns``; these alone without a noun."""
        if not self.noun:
            return self.columns
        curves = [table for r in results if (table := r.tables.get(self.key)) is not None]
        cases = dict.fromkeys(case for table in curves for case in table["case"])
        levels = {
            case: {*(n for t in curves for n in t["level"][t["case"] == case])} for case in cases
        }
        columns = [
            percent_measure(
                f"{case}_at_{n:g}", self.case_words(case, n), f"accuracy.{case}.{n:g}", spare=1
            )
            for case in cases
            for n in sorted(levels[case])
        ]
        return [*columns, percent_measure("loss", "mean loss", f"loss.{self.key}"), *self.columns]

    def case_words(self, case: str, level: float) -> str:
        """A case in words: its name if it has one, and its level."""
        return f"{case}, " * (case != self.key) + f"{level:g} {self.noun or self.key}"

    def table_title(self, results: Sequence[Result]) -> str:
        """Heading of the table of some results."""
        return self.heading

    def further_output(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """Lines and tables that a command prints below the table of its results."""
        return iter(())

    def next_command(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        return "bench report"

    def draw_run(self, result: Result, folder: Path) -> None:
        """Draw the figures of a run for MLflow's page into a folder; ``bench ui`` calls it once."""

    def make_exhibits(self, results: Sequence[Result], folder: Path) -> list[Exhibit]:
        """A figure and a table of each set of comparable systems; figures lie in the folder."""
        from bench.reports.sections import comparable_groups, view_exhibit

        groups = comparable_groups(results, self.shared_parameters, self.score)
        return [view_exhibit(self, *group, folder, i) for i, group in enumerate(groups, 1)]

    def page_columns(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Columns of the table on the page, after the system."""
        return self.table_columns(results)

    def page_captions(self) -> tuple[str, str]:
        """Captions of the figure and of the table on the page."""
        caption = f"accuracy by {self.noun or self.key}"
        details = "means over subjects, 95 % t-intervals; dotted: captures as they are"
        return f"{caption}; {details}.", self.heading or caption

    def draw_for_page(self, results: Sequence[Result]) -> Figure | None:
        """The figure on the page: accuracy against the level."""
        from bench.reports.curves import draw_levels

        return draw_levels(self.key, self.noun or self.key, results)

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """CSV files of the report, by name: the curves of all systems."""
        from bench.values.stability import concat_tables

        return {self.key: concat_tables(results, self.key)}

    def has_candidate(self, result: Result) -> bool:
        """True if a run has a candidate."""
        return True

    def clean_candidates(
        self, result: Result, reactions: Reactions, windows: bool
    ) -> Iterable[Candidate]:
        """The system on captures as they are, or on their single windows."""
        return ()

    def candidates(
        self, result: Result, reactions: Reactions, latest_ms: float | None
    ) -> Iterable[Candidate]:
        """The system in each case, scored by whole captures."""
        from bench.values.candidate import Candidate

        settings = setting_phrases(result, self.shared_parameters)
        table = result.tables[LABELS_TABLE]
        cases = table[table["circumstance"] == self.key].groupby(["case", "level"], sort=False)
        for (case, level), rows in cases:
            words = ", ".join([self.case_words(case, level), *settings])
            yield Candidate(words, reactions.score_by_subject(rows))

    def shared_costs(self, result: Result) -> dict[str, float]:
        """Numbers of its costs that hold for other runs of the system, too; none for a study."""
        if self.tag:
            return {}
        names = [cost.source_name for cost in self.costs if cost.of_people is None]
        return {name: result.metrics[name] for name in names if name in result.metrics}

    def losses_by_subject(
        self, results: Sequence[Result], faults: Sequence[str], severity: int, reactions: Reactions
    ) -> pd.DataFrame | None:
        """Points lost in each case [cases, subjects], for costs of losses; None without any."""
        return None

    def gesture_names(self, result: Result) -> tuple[str, ...]:
        """All gestures of the captures of a run."""
        from bench.values.scores import classes_of

        tables = (result.tables.get(name) for name in ("predictions", *result.tables))
        every = (classes_of(table) for table in tables if table is not None)
        return tuple(next(filter(None, every), ()))

    def describe_choice(self, row: Mapping[str, Any]) -> str:
        """A sentence on the costs of a chosen candidate; may be empty."""
        return ""
