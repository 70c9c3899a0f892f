"""A circumstance: what is changed while a fitted system labels the test captures again.

A new one is a file with `Circumstance.cases`, and an entry in `bench.circumstances` or an entry point
``touchbench.circumstances``. Its labels, their table, a printed column, a CSV file, a section of the page with a
figure, candidates and budgets come from here; it may replace each of them.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.candidate import Candidate, Losses, Wish
from bench.comparable import shared
from bench.kinds.base import Options, Shown
from bench.kinds.base import option as option
from bench.measures import Measure, percent
from bench.result import Result
from bench.usual import LABELS as LABELS
from bench.work.experiment import Case as Case

if TYPE_CHECKING:
    import pandas as pd

    from bench import contract
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.reports.part import Section
    from bench.source import Code
    from bench.work.fitted import Fitted
    from bench.work.results import FoldResult

CASE = ("case", "level")  # its columns that name a case


@dataclass(frozen=True)
class Circumstance(Options, Shown):
    """Labels the test captures again, in some cases.

    Attributes:
        key: its key of ``bench run``.
        tracked: names of its options as parameters of a run; a run that has the first has the circumstance.
        columns: further columns of its tables; a corpus cannot have them.
        noun: words for what its levels count, such as "captures of each class".
        absent: value of that parameter of a run without the circumstance.
        sliced: True if groups of captures are tested in its cases, too.
        word: a word for one of its cases.
        chooses: True if its cases are candidates of a choice.
        views: True if ``bench run`` prints a table of it.
    """

    key: ClassVar[str]
    tracked: ClassVar[tuple[str, ...]] = ()
    columns: ClassVar[frozenset[str]] = frozenset()
    noun: ClassVar[str] = ""
    sliced: ClassVar[bool] = True
    absent: ClassVar[str] = ""
    word: ClassVar[str] = "case"
    chooses: ClassVar[bool] = True
    views: ClassVar[bool] = True

    # producer, part of a run's identity

    @classmethod
    def asked(cls, values: Mapping[str, object]) -> bool:
        """Whether typed values ask for it."""
        name, (_, alias) = next(iter(cls.fields().items()), ("", (None, "")))
        return bool({name, alias} & {*values})

    def options(self) -> dict[str, object]:
        """Tracked as parameters; the first is that of `tracked`."""
        return {f"{self.key}.{name}" if i else self.key: text for i, (name, text) in enumerate(self._texts().items())}

    def _texts(self) -> dict[str, str]:
        from bench.kinds.base import typed_as

        return {name: typed_as(getattr(self, name)) for name in self.fields()}

    def identity(self) -> object:
        """Identity of its options."""
        return repr(self)

    def depends(self) -> list[Code]:
        """Modules, classes or functions whose code its numbers depend on."""
        return [type(self)]

    def refuse(self, plan: Plan) -> None:
        """Refuse impossible plans before anything is run.

        Raises:
            InputError: it cannot be.
        """

    def warnings(self, plan: Plan) -> list[str]:
        """Warnings before the run; equal ones of several runs are printed once."""
        return []

    def cases(self, at: Fitted) -> Iterator[Case]:
        """What is changed, a case at a time.

        Args:
            at: the fitted system of a fold, with its captures.
        """
        raise NotImplementedError

    def fold(self, at: Fitted) -> FoldResult:
        """Label the test captures of a fold in every case."""
        import pandas as pd

        from bench.work.fold import computing
        from bench.work.results import FoldResult

        begun, parts, last = time.perf_counter(), [], None
        with computing(at.threads):
            for last in self.cases(at):
                parts.append(at.labels(self.key, last))
            effects = at.effects(last)
        tables = {LABELS: pd.concat(parts, ignore_index=True)} if parts else {}
        return FoldResult(
            at.fold.name, metrics=self.seconds(time.perf_counter() - begun), tables=tables, batch_effects=effects
        )

    def seconds(self, wall: float) -> dict[str, float]:
        """What its cases took."""
        return {f"{self.key}_seconds": wall}

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Tracked numbers of a fold: the accuracy in each case."""
        table = result.tables[LABELS] if LABELS in result.tables else None
        return {} if table is None else self.accuracies(table[table["circumstance"] == self.key])

    def accuracies(self, rows: pd.DataFrame) -> dict[str, float]:
        """Accuracy in each case, by the name under which it is tracked."""
        hits = (rows["true"] == rows["predicted"]).groupby([rows["case"], rows["level"]], sort=False).mean()
        return {f"accuracy.{case}.{level:g}": float(value) for (case, level), value in hits.items()}

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Numbers and further tables of a run.

        Args:
            tables: tables of all folds: ``predictions``, and those of `fold`; ``labels`` has the captures as they are,
                too.
            folds: results of the folds.
            rate_hz: frames per second.
        """
        from bench.work.curves import curve, loss

        table = curve(tables[LABELS], self.key)
        numbers = {f"accuracy.{r.case}.{r.level:g}": r.accuracy for r in table.itertuples()}
        numbers |= {f"loss.{case}": lost for case, lost in loss(table).items()}
        return numbers | {f"loss.{self.key}": float(table["loss"].mean())}, {self.key: table}

    @staticmethod
    def in_turn(
        circumstances: Sequence[Circumstance],
        cell: Cell,
        corpus: Corpus,
        fold: Fold,
        system: contract.System,
        result: FoldResult,
        threads: int,
    ) -> None:
        """Add what circumstances make of a fold to its result, one after the other; one that fails leaves the rest."""
        import pandas as pd

        from bench.work.fitted import Fitted

        at = Fitted(cell, corpus, fold, system, result.table, threads)
        result.tables = {LABELS: at.clean()}
        for circumstance in circumstances:
            try:
                done = circumstance.fold(at)
            except (Exception, SystemExit):  # a system may raise anything
                result.failed[circumstance.key] = traceback.format_exc()
                continue
            result.metrics |= done.metrics
            result.times |= done.times
            result.batch_effects += done.batch_effects
            for name, table in done.tables.items():
                before = [result.tables[name]] if name in result.tables else []
                result.tables[name] = pd.concat([*before, table], ignore_index=True)

    @staticmethod
    def all_measured(
        circumstances: Sequence[Circumstance],
        tables: Mapping[str, pd.DataFrame],
        folds: Sequence[FoldResult],
        rate_hz: float,
        target: str,
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Numbers and tables of a run in some circumstances, and the groups of captures on which the system fails.

        Args:
            circumstances: circumstances of the run.
            tables: tables of all folds.
            folds: results of the folds.
            rate_hz: frames per second.
            target: columns that define the class.
        """
        import pandas as pd

        from bench.work.curves import unharmed
        from bench.work.stability import sliced

        numbers: dict[str, float] = {}
        made: dict[str, pd.DataFrame] = {}
        for circumstance in circumstances:
            metrics, own = circumstance.result(tables, folds, rate_hz)
            numbers, made = numbers | metrics, made | own
        tested = [c for c in circumstances if c.sliced]
        labels = pd.concat([unharmed(tables[LABELS]), *(c.labels(tables, rate_hz) for c in tested)], ignore_index=True)
        metrics, own = sliced(labels, {c.key: c.word for c in tested}, target)
        return numbers | metrics, made | own

    def labels(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """Its rows of the table ``labels``, also where its own table has more than labels."""
        table = tables[LABELS]
        return table[table["circumstance"] == self.key]

    # consumer

    @classmethod
    def holds(cls, result: Result) -> bool:
        """Whether a run has the circumstance, in all folds."""
        if cls.key in result.failed:
            return False
        return result.about.get(cls.tracked[0] if cls.tracked else cls.key, cls.absent) != cls.absent

    @classmethod
    def shows(cls, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy in each case, and the mean loss; its own columns alone where it counts nothing."""
        if not cls.noun:
            return cls.shown
        curves = [table for r in results if (table := r.tables.get(cls.key)) is not None]
        cases = dict.fromkeys(case for table in curves for case in table["case"])
        levels = {case: {*(n for t in curves for n in t["level"][t["case"] == case])} for case in cases}
        columns = [
            percent(f"{case}_at_{n:g}", cls.words_of(case, n), f"accuracy.{case}.{n:g}", spare=1)
            for case in cases
            for n in sorted(levels[case])
        ]
        return [*columns, percent("loss", "mean loss", f"loss.{cls.key}"), *cls.shown]

    @classmethod
    def words_of(cls, case: str, level: float) -> str:
        """A case in words: its name if it has one, and its level."""
        return f"{case}, " * (case != cls.key) + f"{level:g} {cls.noun or cls.key}"

    @classmethod
    def figure(cls, result: Result, folder: Path) -> None:
        """Draw what is kept with a run into a folder."""

    @classmethod
    def section(cls, results: Sequence[Result], folder: Path) -> Section | None:
        """Accuracy against the level: a figure and a table of comparable systems."""
        from bench.reports.levels import level_section

        return level_section(cls, results, folder)

    @classmethod
    def sheets(cls, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """The curves of all systems."""
        from bench.work.curves import joined

        return {cls.key: joined(results, cls.key)} if results else {}

    @classmethod
    def offers(cls, result: Result, wish: Wish) -> bool:
        """Whether a run has a candidate."""
        return cls.chooses

    @classmethod
    def candidates(cls, result: Result, wish: Wish) -> Iterable[Candidate]:
        """The system in each case, scored by whole captures."""
        told = shared(result, cls.alike)
        table = result.tables[LABELS]
        for (case, level), rows in table[table["circumstance"] == cls.key].groupby(["case", "level"], sort=False):
            yield Candidate(", ".join([cls.words_of(case, level), *told]), wish.reactions.scores(rows))

    @classmethod
    def lends(cls, result: Result) -> dict[str, float]:
        """The numbers that its costs read."""
        names = [cost.read or cost.key for cost in cls.costs if cost.among is None]
        return {name: result.metrics[name] for name in names if isinstance(name, str) and name in result.metrics}

    @classmethod
    def lost(cls, results: Sequence[Result], asked: Losses, reactions: object) -> pd.DataFrame | None:
        """Points lost in some cases [cases, subjects], for costs of losses; None if it knows none."""
        return None
