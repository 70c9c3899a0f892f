"""Measurements of a run: circumstances of its test captures, or a kind of run on other data.

The loop fits, predicts, checks and times; each circumstance follows (`bench.running.evaluation`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bench.ground.typed import Options, format_option
from bench.ground.typed import option as option
from bench.values.result import LABELS_TABLE as LABELS_TABLE

if TYPE_CHECKING:
    import pandas as pd

    from bench import contract
    from bench.corpora.corpus import Corpus
    from bench.ground.source import Code
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.running.fitted import FittedFold
    from bench.running.results import FoldResult
    from bench.values.result import Result


@dataclass(frozen=True)
class Case:
    """One change of a circumstance."""

    name: str = ""  # such as that of a fault; empty for the key of the circumstance
    level: float = 0  # size of the change, to sort and draw by
    amount: str = ""  # size of the change, in words
    corpus: Corpus | None = None  # the changed captures; None for unchanged ones
    system: contract.System | None = None  # predicts in place of the fitted system
    train_subjects: int | None = None  # number of training subjects of that system


@dataclass(frozen=True)
class RunExtension(Options):
    """What a run does besides; its options are tracked, and part of the key of the run."""

    key: ClassVar[str]  # of ``bench run``; of a kind of run, its command and the tag of its runs
    is_run_kind: ClassVar[bool] = False  # True if it evaluates whole folds
    view: ClassVar[str] = "bench.reports.views.base:View"  # imported when something is shown
    tracked: ClassVar[tuple[str, ...]] = ()  # names of its options as parameters of a run
    columns: ClassVar[frozenset[str]] = frozenset()  # further columns of its tables

    def params(self) -> dict[str, object]:
        """Return its options as they are tracked."""
        raise NotImplementedError

    def identity(self) -> object:
        """Return the identity of its options."""
        return repr(self)

    def code(self) -> list[Code]:
        """Return modules, classes or functions whose files its numbers depend on."""
        return [type(self)]

    def check_plan(self, plan: Plan) -> None:
        """Raise an `InputError` for impossible plans, before anything is run."""

    def warnings_of_plan(self, plan: Plan) -> list[str]:
        """Return warnings before the run; equal ones of several runs are printed once."""
        return []


@dataclass(frozen=True)
class Circumstance(RunExtension):
    """Predicts the test captures again in some cases."""

    has_slices: ClassVar[bool] = True  # True if groups of captures are tested in its cases
    case_noun: ClassVar[str] = "case"

    def params(self) -> dict[str, object]:
        """Return its options as they are tracked."""
        first, *others = self.options_by_key()
        names = {first: self.key} | {name: f"{self.key}.{name}" for name in others}
        return {tracked: format_option(getattr(self, name)) for name, tracked in names.items()}

    @property
    def timing_metrics(self) -> tuple[str, ...]:
        """Names of seconds of a fold, of which a run has the mean; the total comes first."""
        return (f"{self.key}_seconds",)

    def cases(self, at: FittedFold) -> Iterator[Case]:
        """Yield each change of the captures or the system of a fold."""
        raise NotImplementedError

    def evaluate_fold(self, at: FittedFold) -> FoldResult:
        """Predict the test captures of a fold in every case."""
        import pandas as pd

        from bench.running.fold import limit_threads
        from bench.running.results import FoldResult

        started, parts, case = time.perf_counter(), [], None
        with limit_threads(at.threads):
            for case in self.cases(at):
                parts.append(at.label_case(self.key, case))
            effects = at.find_batch_effects(case) if case else []
        tables = {LABELS_TABLE: pd.concat(parts, ignore_index=True)} if parts else {}
        seconds = {self.timing_metrics[0]: time.perf_counter() - started}
        return FoldResult(at.fold.name, metrics=seconds, tables=tables, batch_effects=effects)

    def fold_metrics(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> dict[str, float]:
        """Return tracked numbers of the tables of a fold: the accuracy in each case, by name."""
        if LABELS_TABLE not in tables:
            return {}
        rows = self.own_label_rows(tables, rate_hz)
        rows = rows.assign(hit=rows["true"] == rows["predicted"])
        means = rows.groupby(["case", "level"], sort=False, as_index=False)["hit"].mean()
        return {f"accuracy.{r.case}.{r.level:g}": float(r.hit) for r in means.itertuples()}

    def measure_run(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Return numbers and further tables of a run.

        Args:
            tables: of all folds: ``predictions``, and the tables of `evaluate_fold`. ``labels``
                also has the unchanged captures.
            folds: the folds that went well.
            rate_hz: frames per second.
        """
        from bench.values.stability import accuracy_curve, mean_losses

        curve = accuracy_curve(tables[LABELS_TABLE], self.key)
        numbers = {
            f"accuracy.{row['case']}.{row['level']:g}": row["accuracy"]
            for row in curve.to_dict("records")
        }
        numbers |= {f"loss.{name}": loss for name, loss in mean_losses(curve).items()}
        return numbers | {f"loss.{self.key}": float(curve["loss"].mean())}, {self.key: curve}

    def own_label_rows(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """Return its rows of the table ``labels``, or rows like these from its own table."""
        labels = tables[LABELS_TABLE]
        return labels[labels["circumstance"] == self.key]


@dataclass(frozen=True)
class RunKind(RunExtension):
    """A kind of run: whole folds on other data than single captures; its command has its key."""

    is_run_kind: ClassVar[bool] = True

    def params(self) -> dict[str, object]:
        """Return its options as they are tracked."""
        return {f"{self.key}.{name}": getattr(self, name) for name in self.options_by_key()}

    def open_captures(self, cell: Cell) -> Corpus | None:
        """Open its own captures; None for those of the cell.

        Raises:
            InputError: they cannot be opened.
        """
        return None

    def evaluate_fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Evaluate one fold, in a worker process, and set its tracked numbers.

        An exception is recorded as the fold's failure.
        """
        raise NotImplementedError

    def measure_run(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Return the run of the folds that went well, at least one, in the protocol's order.

        Its tags and parameters are ``about``; tags that the result adds are stored, too.
        """
        raise NotImplementedError
