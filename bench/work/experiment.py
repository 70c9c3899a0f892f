"""The interface of a kind of run: evaluation, stress and stream are three of them, and a new one is one file.

`bench.work.loop` does the rest once for all kinds: key, resuming, failed folds, Ctrl-C, progress, tracking.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bench.measures import Measure
from bench.outcomes.results import FoldResult
from bench.result import Result

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.source import Code


@dataclass(frozen=True)
class Experiment:
    """A kind of run; its fields are its options, which are part of a run's identity.

    Attributes:
        kind: tag of its parent runs.
        fold_kind: tag of its folds.
        heading: heading of the table of its results.
        shown: columns of that table.
        ranked: True if the most accurate result of several is marked in it.
        searches: True if what a search has chosen in each fold is printed.
        columns: further columns of its table of predictions; a corpus cannot have them.
        adapts: True if it passes calibration captures to systems; other kinds refuse protocols that have them.
    """

    kind: ClassVar[str]
    fold_kind: ClassVar[str]
    heading: ClassVar[str]
    shown: ClassVar[tuple[Measure, ...]] = ()
    ranked: ClassVar[bool] = False
    searches: ClassVar[bool] = False
    columns: ClassVar[frozenset[str]] = frozenset()
    adapts: ClassVar[bool] = False

    @classmethod
    def measures(cls) -> list[Measure]:
        """Columns of the table of its results, after system, data, subset and protocol."""
        return [*cls.shown]

    def options(self) -> dict[str, object]:
        """Tracked as parameters, by default the fields under ``<kind>.``."""
        return {f"{self.kind}.{f.name}": getattr(self, f.name) for f in dataclasses.fields(self)}

    def identity(self) -> object:
        """Identity of the experiment, by default kind and fields."""
        return repr(self)

    def arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        return {}

    def command(self, cell: Cell) -> str:
        """The command that makes a run of a cell."""
        return self.kind

    def depends(self) -> list[Code]:
        """Modules, classes or functions whose code its numbers depend on, besides the parts of the cell."""
        return [type(self)]

    def refuse(self, plan: Plan) -> None:
        """Refuse impossible cells before anything is run.

        Raises:
            InputError: it cannot be.
        """

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Do one fold, in a worker process; an exception is recorded as the fold's failure.

        Args:
            cell: cell of the run.
            corpus: the captures that the fold is of.
            fold: names its training and test captures by position.
            threads: threads for computing.
        """
        raise NotImplementedError

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Tracked numbers of one fold."""
        return result.metrics

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Measure the run from the folds that went well, at least one, in the order of the protocol.

        Args:
            plan: plan of the run.
            about: tags and parameters of the run; tags that the result adds are stored, too.
            folds: results of the folds.
        """
        raise NotImplementedError
