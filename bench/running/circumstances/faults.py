"""Faults of the sensor, its readings or its place, at five severities, on test captures alone."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from bench.corpora.fault_names import (
    ALL_FAULTS,
    FAULT_NAMES,
    MORE_FAULT_NAMES,
    NO_FAULT,
    SEVERITIES,
)
from bench.ground.typed import Values, split_values
from bench.running.circumstances.base import LABELS_TABLE, Case, Circumstance, option

if TYPE_CHECKING:
    import pandas as pd

    from bench.ground.source import Code
    from bench.running.fitted import FittedFold
    from bench.running.results import FoldResult


@dataclass(frozen=True)
class Faults(Circumstance):
    """Damages the test captures; the system was fitted on undamaged training captures."""

    key: ClassVar[str] = "under"
    view: ClassVar[str] = "bench.reports.views.faults:Faults"
    tracked: ClassVar[tuple[str, ...]] = ("faults",)
    case_noun: ClassVar[str] = "fault"

    under: tuple[str, ...] = option(
        (),
        "faults that damage the test captures, or all",
        (*FAULT_NAMES, *MORE_FAULT_NAMES, NO_FAULT),
    )

    @classmethod
    def from_typed(cls, values: Values) -> list[Self]:
        """Return one circumstance with the typed faults, in the order of all faults."""
        from bench.corpora.faults import parse_fault_names, usual_faults  # loads SciPy

        key = "faults" if "faults" in values else "under"
        names = split_values(key, values[key])
        if names == [NO_FAULT]:
            return [cls()]
        return [cls(parse_fault_names(key, names, usual_faults()))]

    def params(self) -> dict[str, object]:
        """Return the names of the faults."""
        return {"faults": ", ".join(self.under) or NO_FAULT}

    def typed_arguments(self) -> dict[str, str]:
        """Return the faults as typed."""
        from bench.corpora.faults import usual_faults

        if self.under == usual_faults():
            return {"under": ALL_FAULTS}
        return {"under": ",".join(self.under) or NO_FAULT}

    def identity(self) -> object:
        """Return names, units and amounts of the faults."""
        from bench.corpora.faults import fault_identity

        return fault_identity(self.under)

    def code(self) -> list[Code]:
        """Return its code, and that of the faults."""
        from bench.corpora.faults import FAULTS

        return [*super().code(), *(FAULTS[name].damage for name in self.under)]

    @property
    def timing_metrics(self) -> tuple[str, ...]:
        """Names of the wall time of all cases, and of processor time."""
        return "fault_seconds", "fault_cpu_seconds"

    def cases(self, at: FittedFold) -> Iterator[Case]:
        """Yield the test captures under each fault at each severity."""
        from bench.corpora.faults import FAULTS, as_shares, damage_captures

        shares = as_shares(at.corpus, at.fold.test)
        for fault in map(FAULTS.__getitem__, self.under):
            for severity in range(1, SEVERITIES + 1):
                worse = damage_captures(at.corpus, at.fold.test, shares, fault, severity)
                yield Case(fault.name, severity, fault.describe(severity), worse)

    def evaluate_fold(self, at: FittedFold) -> FoldResult:
        """Predict under every fault, and count the faults that the system was trained on."""
        from bench import contract

        started = time.process_time()
        result = super().evaluate_fold(at)
        trained = {*contract.trained_faults(at.system)}  # of a search: of its choice
        metrics = result.metrics | {
            "fault_cpu_seconds": time.process_time() - started,
            "faults_trained": len({*self.under} & trained),
        }
        return replace(result, metrics=metrics)

    def measure_run(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Return accuracy and loss under each fault, and the severity at half the margin."""
        from bench.values.stability import fault_metrics, fault_tables

        made_tables = fault_tables(tables[LABELS_TABLE], self.key)
        metrics = fault_metrics(made_tables) | {"faults_tested": len(self.under)}
        return metrics, made_tables
