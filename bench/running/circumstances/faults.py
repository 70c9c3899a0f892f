"""Faults of the sensor, its readings or its place: at five severities each, on the test captures alone."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from bench.ground.words import ALL, CLEAN, FAULTS, LATER, SEVERITIES, Values, items
from bench.running.circumstances.base import LABELS, Case, Circumstance, option

if TYPE_CHECKING:
    import pandas as pd

    from bench.ground.source import Code
    from bench.running.fitted import Fitted
    from bench.running.results import FoldResult


@dataclass(frozen=True)
class Faults(Circumstance):
    """A fault damages the test captures; the system was fitted on the training captures as they are."""

    key: ClassVar[str] = "under"
    view: ClassVar[str] = "bench.reports.views.faults:Faults"
    tracked: ClassVar[tuple[str, ...]] = ("faults",)
    word: ClassVar[str] = "fault"

    under: tuple[str, ...] = option(
        (), "faults that damage the test captures, or all", (*FAULTS.split(), *LATER.split(), CLEAN)
    )

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """The faults that were asked for, in the order in which they are known."""
        from bench.corpora.faults import asked_faults, usual_faults  # loads SciPy

        key = "faults" if "faults" in values else "under"
        chosen = items(key, values[key])
        return [cls(() if chosen == [CLEAN] else asked_faults(key, chosen, usual_faults()))]

    def params(self) -> dict[str, object]:
        """Names of the faults."""
        return {"faults": ", ".join(self.under) or CLEAN}

    def arguments(self) -> dict[str, str]:
        """The faults as typed."""
        from bench.corpora.faults import usual_faults

        return {"under": ALL if self.under == usual_faults() else ",".join(self.under) or CLEAN}

    def identity(self) -> object:
        """Names, units and amounts of the faults."""
        from bench.corpora.faults import identity_of

        return identity_of(self.under)

    def code(self) -> list[Code]:
        """The code of the faults, too."""
        from bench.corpora.faults import all_faults

        return [*super().code(), *(all_faults()[name].damage for name in self.under)]

    @property
    def spent(self) -> tuple[str, ...]:
        """Wall time of all cases, and time of the processor."""
        return "fault_seconds", "fault_cpu_seconds"

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
        return replace(
            done, metrics=done.metrics | spent | {"faults_trained": len({*self.under} & trained)}
        )

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Accuracy and loss under each fault, and where half of the margin over chance is lost."""
        from bench.values.stability import fault_metrics, fault_tables

        made = fault_tables(tables[LABELS], self.key)
        return fault_metrics(made) | {"faults_tested": len(self.under)}, made
