"""Faults of the sensor, its readings or its place: at five severities each, on the test captures alone."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from bench.circumstances.base import LABELS, Case, Circumstance, option
from bench.kinds.base import Spelling
from bench.measures import Cell as Shown
from bench.measures import Cost, Measure, Row, text
from bench.options import Command
from bench.registry import classes
from bench.usual import ALL, CLEAN, SEVERITIES
from bench.words import FAULTS, LATER, Values, items

if TYPE_CHECKING:
    import pandas as pd

    from bench.candidate import Losses
    from bench.plan.plan import Plan
    from bench.reports.part import Section
    from bench.result import Result
    from bench.source import Code
    from bench.table import Table
    from bench.work.fitted import Fitted
    from bench.work.results import FoldResult


def losses(row: Row) -> dict[str, float]:
    """Mean loss of accuracy under each fault, of a result."""
    names = str(row.get("faults", "")).split(", ")
    return {name: row[f"loss.{name}"] for name in names if f"loss.{name}" in row}


def _clean(row: Result) -> Shown:
    from bench.work.curves import clean_accuracy

    return 100 * clean_accuracy(row)


def _mean_loss(row: Row) -> Shown:
    return 100 * sum(losses(row).values()) / len(losses(row)) if losses(row) else None


def _worst_fault(row: Row) -> Shown:
    worst = max(losses(row), key=losses(row).__getitem__, default="")
    return f"{worst.replace('_', ' ')} {100 * losses(row)[worst]:.1f}" if worst else None


def _of(part: str, whole: str) -> Any:
    """A number of a number."""
    return lambda row: f"{row[part]:.0f} of {row[whole]:.0f}" if part in row else None


_failing = _of("failing_slices.under", "tested_slices.under")  # of captures as they are, and of damaged ones


def _measured_by(losses: Losses) -> dict[str, str]:
    return {"faults": ",".join(losses.names)}


_LOSS = Cost(
    "loss",
    unit="points",
    unknown="losses are of whole captures, in runs of bench stress with all these faults",
    losses=True,
    command="stress",
    asks=_measured_by,
    linear=True,
    zero=True,
    column=False,
    last=0,
)


@dataclass(frozen=True)
class Faults(Circumstance):
    """A fault damages the test captures; the system was fitted on the training captures as they are."""

    key: ClassVar[str] = "under"
    tracked: ClassVar[tuple[str, ...]] = ("faults",)
    word: ClassVar[str] = "fault"
    chooses: ClassVar[bool] = False  # a damaged sensor is nothing to choose, its loss is a cost

    under: tuple[str, ...] = option(
        (), "faults that damage the test captures, or all", (*FAULTS.split(), *LATER.split(), CLEAN), alias="faults"
    )

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """The faults that were asked for, in the order in which they are known.

        Raises:
            InputError: there is no such fault.
        """
        from bench.corpora.faults import asked_faults, usual_faults  # loads SciPy

        key = "faults" if "faults" in values else "under"
        chosen = items(key, values[key])
        return [cls(() if chosen == [CLEAN] else asked_faults(key, chosen, usual_faults()))]

    def options(self) -> dict[str, object]:
        """Names of the faults."""
        return {"faults": ", ".join(self.under) or CLEAN}

    def changed(self) -> dict[str, str]:
        """The faults as typed."""
        from bench.corpora.faults import usual_faults

        return {"under": ALL if self.under == usual_faults() else ",".join(self.under) or CLEAN}

    def identity(self) -> object:
        """Names, units and amounts of the faults."""
        from bench.corpora.faults import identity_of

        return identity_of(self.under)

    def depends(self) -> list[Code]:
        """The code of the faults, too."""
        from bench.corpora.faults import all_faults

        return [Faults, *(all_faults()[name].damage for name in self.under)]

    def warnings(self, plan: Plan) -> list[str]:
        """A line where recordings are cut into captures: which command takes them whole."""
        from bench.corpora.recordings import is_recorded

        whole = [name for name, kind in classes("kinds").items() if kind.recordings and self.key in kind.fields()]
        if not self.under or not is_recorded(plan.corpus):
            return []
        return [f"bench {name} {self.key}= passes recordings through faults whole, with a detector" for name in whole]

    def cases(self, at: Fitted) -> Iterator[Case]:
        """The test captures under each fault at each severity."""
        from bench.corpora.faults import all_faults, as_shares, damaged

        shares = as_shares(at.corpus, at.fold.test)
        for fault in map(all_faults().__getitem__, self.under):
            for severity in range(1, SEVERITIES + 1):
                worse = damaged(at.corpus, at.fold.test, shares, fault, severity)
                yield Case(fault.name, severity, fault.describe(severity), worse)

    def fold(self, at: Fitted) -> FoldResult:
        """Labels under every fault, and how many of the faults the system was trained on."""
        from bench import contract

        begun = time.process_time()
        done = super().fold(at)
        trained = {*contract.trained_faults(at.system)}  # of a search by what it has chosen
        spent = {"fault_cpu_seconds": time.process_time() - begun}
        return replace(done, metrics=done.metrics | spent | {"faults_trained": len({*self.under} & trained)})

    def seconds(self, wall: float) -> dict[str, float]:
        """Seconds under faults."""
        return {"fault_seconds": wall}

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Accuracy and loss under each fault, and where half of the margin over chance is lost."""
        from bench.work.stability import fault_metrics, fault_tables

        made = fault_tables(tables[LABELS], self.key)
        return fault_metrics(made) | {"faults_tested": len(self.under)}, made

    commands: ClassVar[dict[str, Spelling]] = {
        "stress": Spelling(
            Command(
                "compare",
                "find faults, subjects and conditions under which systems fail",
                "Trains every fold once and tests it on clean captures and under every fault at five severities. Lists "
                "subjects, classes, conditions and faults whose accuracy is significantly below that of the system. "
                "With several seeds, it also counts captures whose label changes. It is bench run with under= and "
                "train_subjects=. An interrupted command continues where it stopped.",
                "bench stress data=haart protocol=loso model=svm,rf features=jung54\n"
                "bench stress data=haart protocol=loso model=rf seed=0,1,2 faults=noise,shift train_subjects=2,4,8",
            ),
            keys=("under", "train_subjects"),
            given={"faults": ALL},
            out=("stress", "folder for tables and figures"),
        )
    }
    heading: ClassVar[str] = (
        "Accuracy in percent of clean captures, mean over subjects, and mean loss in points over all faults"
    )
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("accuracy", "clean", _clean),
        Measure("mean_loss", "mean loss", _mean_loss),
        Measure("trained", "faults trained on", _of("faults_trained", "faults_tested"), spare=2),
        text("worst_fault", "worst fault", _worst_fault),
        Measure("failing", "failing groups", _failing),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        replace(
            _LOSS,
            key="fault_loss",
            noun="mean loss under faults",
            words="lost under faults",
            axis="points lost under faults (mean of all faults and severities)",
            help="largest mean loss under faults, in points of bench stress",
            among=lambda people: people.loss().mean(axis=1),
            line=("faults", "loss"),
        ),
        replace(
            _LOSS,
            key="worst_fault",
            noun="loss under the worst fault",
            words="lost under the worst fault",
            axis="points lost under the worst fault",
            help="largest loss under the worst fault and severity, in points",
            among=lambda people: people.loss().max(axis=1),
            line=("faults", "worst"),
        ),
    )

    @classmethod
    def write(cls, results: Sequence[Result], folder: Path) -> list[str]:
        """Write tables, figures and ``stability.md`` for the results of each context."""
        from bench.reports.stability_tables import write_all

        return write_all(results, folder)

    @classmethod
    def section(cls, results: Sequence[Result], folder: Path) -> Section | None:
        """The loss under each fault, and where each system fails first."""
        from bench.reports.fault_curves import fault_section

        return fault_section(results, folder, _failing)

    @classmethod
    def brief(cls, results: Sequence[Result]) -> tuple[str, str] | None:
        """The most robust system."""
        from bench.reports.fault_curves import robust

        return robust(results)

    @classmethod
    def sheets(cls, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Accuracy under each fault."""
        from bench.work.curves import joined

        return {"faults": joined(results, "faults")} if results else {}

    @classmethod
    def lost(cls, results: Sequence[Result], asked: Losses, reactions: Any) -> pd.DataFrame | None:
        """Points lost under each fault at each severity [cases, subjects], in some runs of one system."""
        from bench.outcomes.losses import points_lost

        return points_lost(results, asked, reactions, cls.key)

    @classmethod
    def printed(cls, results: Sequence[Result]) -> Iterator[str | Table]:
        """A hint."""
        yield "To train a system on damaged copies too, add model.faults=all."
