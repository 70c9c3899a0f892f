"""What runs measure: circumstances, in which a fitted system labels its test captures again, and studies of other data.

The loop fits, decides, checks and times; then each circumstance follows in turn (`bench.running.evaluation`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bench.ground.words import LABELS as LABELS
from bench.ground.words import Options, typed_as
from bench.ground.words import option as option

if TYPE_CHECKING:
    import pandas as pd

    from bench import contract
    from bench.corpora.corpus import Corpus
    from bench.ground.source import Code
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.running.fitted import Fitted
    from bench.running.results import FoldResult
    from bench.values.result import Result


@dataclass(frozen=True)
class Case:
    """What a circumstance changes, once."""

    case: str = ""  # its name, such as that of a fault; empty for the key of the circumstance
    level: float = 0  # size of the change, to sort and draw by
    amount: str = ""  # size of the change, in words
    corpus: Corpus | None = (
        None  # the captures as they are changed; None for the captures as they are
    )
    system: contract.System | None = None  # which labels in place of the fitted one
    train_subjects: int | None = None  # on which that was fitted


@dataclass(frozen=True)
class Producer(Options):
    """What a run measures; its options are tracked, and part of the key of the run."""

    key: ClassVar[str]  # of ``bench run``; of a study, its command and the tag of its runs
    study: ClassVar[bool] = False  # whether it does whole folds
    view: ClassVar[str] = (
        "bench.reports.views.base:View"  # what shows it; imported only when something is shown
    )
    tracked: ClassVar[tuple[str, ...]] = ()  # names of its options as parameters of a run
    columns: ClassVar[frozenset[str]] = (
        frozenset()
    )  # further columns of its tables; a corpus cannot have them

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
    """Labels the test captures again, in some cases."""

    sliced: ClassVar[bool] = True  # whether groups of captures are tested in its cases, too
    word: ClassVar[str] = "case"  # for one of its cases

    def params(self) -> dict[str, object]:
        """Its options, as they are tracked."""
        texts = {name: typed_as(getattr(self, name)) for name in self.fields()}
        return {
            f"{self.key}.{name}" if i else self.key: text
            for i, (name, text) in enumerate(texts.items())
        }

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

        from bench.running.fold import computing
        from bench.running.results import FoldResult

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
        hits = (
            (rows["true"] == rows["predicted"])
            .groupby([rows["case"], rows["level"]], sort=False)
            .mean()
        )
        return {f"accuracy.{case}.{level:g}": float(value) for (case, level), value in hits.items()}

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Numbers and further tables of a run from the tables of all folds: ``predictions``, and what `fold` returns.

        ``labels`` has the captures as they are, too.
        """
        from bench.values.stability import curve, loss

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

        Its tags and parameters are ``about``; tags that the result adds are stored, too.
        """
        raise NotImplementedError
