"""Captures: a system labels each test capture once, as it is and in any number of circumstances."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

from bench.errors import InputError
from bench.kinds.base import Kind, Shown, Spelling
from bench.measures import Measure, columns, run_columns
from bench.options import Command, Option
from bench.registry import classes
from bench.result import Result
from bench.table import Table
from bench.words import SMALL, Values

if TYPE_CHECKING:
    from bench.candidate import Candidate, Wish
    from bench.circumstances.base import Circumstance
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.source import Code
    from bench.work.results import FoldResult


@dataclass(frozen=True)
class Captures(Kind):
    """Fit on the training captures, decide on the test captures, measure accuracy and costs.

    Attributes:
        circumstances: circumstances in which the test captures are labelled again, in the order of the registry.
    """

    tag: ClassVar[str] = "cell"

    circumstances: tuple[Circumstance, ...] = ()

    @property
    def fold_tag(self) -> str:
        """Tag of its folds."""
        return "fold"

    @property
    def columns(self) -> frozenset[str]:
        """Further columns of its tables of labels; a corpus cannot have them."""
        if not self.circumstances:
            return frozenset()
        from bench.work.curves import COLUMNS

        return COLUMNS.union(*(c.columns for c in self.circumstances))

    @classmethod
    def fields(cls) -> dict[str, tuple[Option, str]]:
        """The options of all circumstances."""
        return {name: one for c in classes("circumstances").values() for name, one in c.fields().items()}

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """Every combination of the typed values.

        Raises:
            InputError: a value cannot be used, or belongs to a circumstance that was not asked for.
        """
        every = classes("circumstances").values()
        asked = [c for c in every if c.asked(values)]
        for c in every:
            names = {n for name, (_, alias) in c.fields().items() for n in (name, alias)}
            if c not in asked and (alone := names & {*values}):
                raise InputError(f"{min(alone)}= needs {c.key}=; add it or leave {min(alone)}= out")
        return [cls(each) for each in itertools.product(*(c.of(values) for c in asked))]

    def options(self) -> dict[str, object]:
        """Tracked as parameters: the options of its circumstances."""
        return {name: value for c in self.circumstances for name, value in c.options().items()}

    def identity(self) -> object:
        """Identity of its circumstances."""
        return [(c.key, c.identity()) for c in self.circumstances]

    def arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        return {name: value for c in self.circumstances for name, value in c.changed().items()}

    def command(self, cell: Cell) -> str:
        """``run``, ``tune`` or ``choose``, as the cell is searched or not."""
        return "run" if not cell.tuning else "tune"

    def depends(self) -> list[Code]:
        """The code of its circumstances, too."""
        return [type(self), *(code for c in self.circumstances for code in c.depends())]

    def refuse(self, plan: Plan) -> None:
        """Refuse what one of the circumstances cannot be.

        Raises:
            InputError: it cannot.
        """
        for c in self.circumstances:
            if any(fold.known for fold in plan.folds):
                raise InputError(
                    f"protocol={plan.cell.protocol}: {c.key}= does not adapt systems to a person; leave "
                    "protocol.shots= and protocol.unlabelled= out"
                )
            c.refuse(plan)

    def warnings(self, plan: Plan) -> list[str]:
        """Those of its circumstances."""
        return [line for c in self.circumstances for line in c.warnings(plan)]

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Predictions of the test captures and their costs; labels in each circumstance."""
        from bench.work.evaluation import evaluated

        system, result = evaluated(cell, corpus, fold, threads)
        for c in self.circumstances[:1]:
            c.in_turn(self.circumstances, cell, corpus, fold, system, result, threads)
        return result

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Scores and costs of one fold."""
        from bench import scores
        from bench.work.results import costs

        more = (c.fold_metrics(result, rate_hz) for c in self.circumstances if c.key not in result.failed)
        return (
            {k: v for numbers in more for k, v in numbers.items()} | scores.accuracies(result.table) | costs([result])
        )

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Scores and costs of the whole run; confusions, subjects and classes; what each circumstance changes."""
        from bench.work.results import measured, tables_of

        rate_hz = plan.corpus.rate_hz
        numbers, tables, unit = measured(folds, rate_hz)
        stored, more = tables_of(folds), {}
        whole = [c for c in self.circumstances if not any(c.key in fold.failed for fold in folds)]
        for c in whole[:1]:
            every = {"predictions": tables["predictions"], **stored}
            more, made = c.all_measured(whole, every, folds, rate_hz, about["target"])
            tables |= made
        return Result({**about, "unit": unit}, more | numbers, tables | stored)

    commands: ClassVar[dict[str, Spelling]] = {
        "run": Spelling(
            Command(
                "start here",
                "evaluate systems under a protocol and store the runs",
                "Evaluates every combination of the given values; commas separate values. A dotted key sets a "
                "parameter of that part. Each combination is one MLflow run with a child run per fold. under=, after=, "
                "form= and train_subjects= let each fitted system label the test captures again: under faults, after "
                "some of the touch, in C, or fitted on fewer subjects. An interrupted command continues where it "
                "stopped.",
                "bench run protocol=loso model=cnn85\n"
                f"bench run data=haart {SMALL}\n"
                "bench run data=haart protocol=challenge,loso model=bayes,svm,rf,xgb features=jung28,jung54\n"
                "bench run data=cost model=svm model.C=8,32,128 model.gamma=0.125\n"
                "bench run data=haart model=lda features=touch under=noise,dead_taxels after=250ms,1s form=c\n"
                "bench run data=synth data.subjects=12 data.repetitions=2",
            )
        )
    }
    heading: ClassVar[str] = "Accuracy in percent: mean and SD over subjects"
    score: ClassVar[str] = "subject_accuracy_mean"
    ranked: ClassVar[bool] = True
    searches: ClassVar[bool] = True

    @classmethod
    def held(cls, results: Sequence[Result]) -> dict[type[Circumstance], list[Result]]:
        """The results that have each circumstance, in the order of the registry."""
        every = {c: [r for r in results if c.holds(r)] for c in classes("circumstances").values()}
        return {c: each for c, each in every.items() if each}

    @classmethod
    def tracked(cls) -> tuple[str, ...]:
        """Names of the options of all circumstances as parameters of a run."""
        return tuple(name for c in classes("circumstances").values() for name in c.tracked or (c.key,))

    @classmethod
    def made_by(cls) -> dict[str, tuple[type[Kind], type[Shown], Spelling]]:
        """``bench run``, and the commands of circumstances."""
        views: list[type[Shown]] = [cls, *classes("circumstances").values()]
        return {name: (cls, view, spelling) for view in views for name, spelling in view.commands.items()}

    @classmethod
    def views(cls, results: Sequence[Result]) -> list[tuple[type[Shown], list[Result]]]:
        """The kind, and each circumstance that a result has."""
        return [(cls, [*results]), *((c, each) for c, each in cls.held(results).items() if c.views)]

    @classmethod
    def unseen(cls, results: Sequence[Result]) -> list[tuple[type[Shown], list[Result]]]:
        """Circumstances that no command prints."""
        return [(c, each) for c, each in cls.held(results).items() if not c.views]

    @classmethod
    def printed(cls, results: Sequence[Result]) -> Iterator[str | Table]:
        """A warning of systems that predict one label."""
        from bench.outcomes.scored import one_label

        if line := one_label(results):
            yield line

    @classmethod
    def shows(cls, results: Sequence[Result]) -> Sequence[Measure]:
        """The columns of runs that a terminal shows."""
        return columns(run_columns(), "terminal")

    @classmethod
    def then(cls, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.outcomes.runs import choosing

        return choosing(results)

    @classmethod
    def figure(cls, result: Result, folder: Path) -> None:
        """Draw confusions, and what each circumstance draws."""
        from bench.reports.details import draw

        draw(result, folder)
        for c in cls.held([result]):
            c.figure(result, folder)

    @classmethod
    def gestures(cls, result: Result) -> tuple[str, ...]:
        """All gestures of the captures of a run."""
        from bench.scores import classes_of

        tables = (result.tables.get(name) for name in ("predictions", *result.tables))
        every = (classes_of(table) for table in tables if table is not None)
        return tuple(next(filter(None, every), ()))

    @classmethod
    def offers(cls, result: Result, wish: Wish) -> bool:
        """Whether a run has a candidate: as it is, or in a circumstance."""
        if wish.windows:
            return result.metrics.get("windows", 0) > 0
        return True

    @classmethod
    def candidates(cls, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system in Python, on whole captures or on windows, and in each circumstance of the run."""
        from bench.outcomes.scored import plain_candidates

        if wish.plain:
            yield from cls._without(plain_candidates(result, wish), result, None)
        if not wish.windows:
            for c in (c for c in cls.held([result]) if c.offers(result, wish)):
                yield from cls._without(c.candidates(result, wish), result, c)

    @classmethod
    def _without(
        cls, ways: Iterable[Candidate], result: Result, mine: type[Circumstance] | None
    ) -> Iterator[Candidate]:
        """Candidates without the costs of other circumstances of the run, unless these lend them."""
        others = [c for c in cls.held([result]) if c is not mine]
        costs = [
            cost for c in others for cost in c.costs if cost.command and (cost.read or cost.key) not in c.lends(result)
        ]
        for way in ways:
            yield replace(way, stored={cost.key: "" for cost in costs} | dict(way.stored))

    @classmethod
    def lends(cls, result: Result) -> dict[str, float]:
        """Numbers of its circumstances that hold for the system in other runs, too."""
        return {name: value for c in cls.held([result]) for name, value in c.lends(result).items()}
