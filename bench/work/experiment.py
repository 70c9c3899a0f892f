"""The interface of a kind of run, as the loop knows it; `bench.kinds` has the kinds.

`bench.work.loop` does the rest once for all kinds: key, resuming, failed folds, Ctrl-C, progress, tracking.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from bench import contract
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.result import Result
    from bench.source import Code
    from bench.work.results import FoldResult


@dataclass(frozen=True)
class Case:
    """What a circumstance changes, once.

    Attributes:
        case: its name, such as that of a fault; empty for the key of the circumstance.
        level: size of the change, to sort and draw by.
        amount: size of the change, in words.
        corpus: the captures as they are changed; None for the captures as they are.
        system: a system that labels in place of the fitted one.
        train_subjects: number of subjects that it was fitted on, where it is another one.
    """

    case: str = ""
    level: float = 0
    amount: str = ""
    corpus: Corpus | None = None
    system: contract.System | None = None
    train_subjects: int | None = None


@dataclass(frozen=True)
class Experiment:
    """A kind of run; its fields are its options, which are part of a run's identity.

    Attributes:
        tag: tag of its parent runs.
        columns: further columns of its tables of predictions; a corpus cannot have them.
    """

    tag: ClassVar[str]

    @property
    def fold_tag(self) -> str:
        """Tag of its folds."""
        return f"{self.tag}_fold"

    @property
    def columns(self) -> frozenset[str]:
        """Further columns of its tables of labels; a corpus cannot have them."""
        return frozenset()

    def options(self) -> dict[str, object]:
        """Tracked as parameters."""
        raise NotImplementedError

    def identity(self) -> object:
        """Identity of the experiment, by default kind and fields."""
        return repr(self)

    def arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        raise NotImplementedError

    def command(self, cell: Cell) -> str:
        """The command that makes a run of a cell."""
        raise NotImplementedError

    def depends(self) -> list[Code]:
        """Modules, classes or functions whose code its numbers depend on, besides the parts of the cell."""
        return [type(self)]

    def refuse(self, plan: Plan) -> None:
        """Refuse impossible cells before anything is run.

        Raises:
            InputError: it cannot be.
        """

    def warnings(self, plan: Plan) -> list[str]:
        """Warnings before the run; equal ones of several runs are printed once."""
        return []

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

    @classmethod
    def figure(cls, result: Result, folder: Path) -> None:
        """Draw what MLflow's page shows of a run into a folder; ``bench ui`` does it, once."""
