"""What runs measure: circumstances, in which a fitted system labels its test captures again, and studies of other data.

The loop fits, decides, checks and times; then each circumstance follows in turn (`bench.work.evaluation`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bench.words import LABELS as LABELS
from bench.words import Options, typed_as
from bench.words import option as option
from bench.work.case import Case as Case

if TYPE_CHECKING:
    import pandas as pd

    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.result import Result
    from bench.source import Code
    from bench.work.fitted import Fitted
    from bench.work.results import FoldResult


@dataclass(frozen=True)
class Producer(Options):
    """What a run measures; its options are tracked, and part of the key of the run.

    Attributes:
        key: its key of ``bench run``; of a study, its command and the tag of its runs.
        view: entry of the reading half that shows it, as ``module:Name``; imported only when something is shown.
        tracked: names of its options as parameters of a run.
        columns: further columns of its tables; a corpus cannot have them.
        study: True if it does whole folds.
    """

    key: ClassVar[str]
    study: ClassVar[bool] = False
    view: ClassVar[str] = "bench.reports.views.base:View"
    tracked: ClassVar[tuple[str, ...]] = ()
    columns: ClassVar[frozenset[str]] = frozenset()

    def params(self) -> dict[str, object]:
        """Its options, as they are tracked."""
        raise NotImplementedError

    def identity(self) -> object:
        """Identity of its options."""
        return repr(self)

    def code(self) -> list[Code]:
        """Modules, classes or functions whose files its numbers depend on, with all that these import."""
        return [type(self)]

    def refuse(self, plan: Plan) -> None:
        """Refuse impossible plans before anything is run, with an `InputError`."""

    def warnings(self, plan: Plan) -> list[str]:
        """Warnings before the run; equal ones of several runs are printed once."""
        return []


@dataclass(frozen=True)
class Circumstance(Producer):
    """Labels the test captures again, in some cases.

    Attributes:
        sliced: True if groups of captures are tested in its cases, too.
        word: a word for one of its cases.
    """

    sliced: ClassVar[bool] = True
    word: ClassVar[str] = "case"

    def params(self) -> dict[str, object]:
        """Its options, as they are tracked."""
        texts = {name: typed_as(getattr(self, name)) for name in self.fields()}
        return {f"{self.key}.{name}" if i else self.key: text for i, (name, text) in enumerate(texts.items())}

    @property
    def spent(self) -> tuple[str, ...]:
        """Names of the seconds of a fold, of which a run has the mean; the first are those of all cases."""
        return (f"{self.key}_seconds",)

    def cases(self, at: Fitted) -> Iterator[Case]:
        """What is changed, a case at a time, of the fitted system of a fold and its captures."""
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
        seconds = {self.spent[0]: time.perf_counter() - begun}
        return FoldResult(at.fold.name, metrics=seconds, tables=tables, batch_effects=effects)

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Tracked numbers of a fold: the accuracy in each case, by name."""
        if LABELS not in result.tables:
            return {}
        rows = self.labels(result.tables, rate_hz)
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

    def labels(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """Its rows of the table ``labels``, also where its own table has more than labels."""
        return tables[LABELS][tables[LABELS]["circumstance"] == self.key]


@dataclass(frozen=True)
class Study(Producer):
    """Whole folds on other data than single captures; its command has its key."""

    study: ClassVar[bool] = True

    def params(self) -> dict[str, object]:
        """Its options, as they are tracked."""
        return {f"{self.key}.{name}": getattr(self, name) for name in self.fields()}

    def captures(self, cell: Cell) -> Corpus | None:
        """What it is done on, None for the captures of the cell; an `InputError` where they cannot be opened."""
        return None

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Do one fold of a corpus, in a worker process; an exception is recorded as the fold's failure."""
        raise NotImplementedError

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Tracked numbers of one fold."""
        return result.metrics

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """The run from the folds that went well, at least one, in the order of the protocol.

        Args:
            plan: plan of the run.
            about: tags and parameters of the run; tags that the result adds are stored, too.
            folds: results of the folds.
        """
        raise NotImplementedError
