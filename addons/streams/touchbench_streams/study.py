"""Continuous recordings: touches found in a stream, false alarms and latency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from bench.ground.words import ALL, FAULTS, LATER, LOSSY, Values, items, labelled
from bench.running.circumstances.base import Study, option
from bench.values.result import Result
from touchbench_streams import DETECTOR, FALSE_ALARMS

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.ground.source import Code
    from bench.plan.cells import Cell, Part
    from bench.plan.plan import Fold, Plan
    from bench.running.results import FoldResult


@dataclass(frozen=True)
class Continuous(Study):
    """Events in recordings of the test subjects; detector and post-processing are learned on training subjects.

    The corpus holds recordings, or they are composed of its captures (`touchbench_streams.composer`).
    """

    key: ClassVar[str] = "watch"
    view: ClassVar[str] = "touchbench_streams.view:Continuous"

    detector: str = option(
        DETECTOR,
        "finds the touches: {touchbench_streams.detectors}, or my.py:Mine; detector.NAME= sets a parameter",
    )
    false_alarms: float = option(
        FALSE_ALARMS, "false alarms per hour of background accepted in training", type="number"
    )
    background: str = option(
        "",
        "class without touch, or quiet: ends of captures; default notouch or quiet. Of recordings: further ones "
        "without touch, to learn from",
    )
    unknown: str = option(
        "", "gesture to leave out of training; its touches should be labelled unknown"
    )
    under: tuple[str, ...] = option(
        (),
        "faults that the test recordings also go through, at five severities each, or all",
        (*(name for name in FAULTS.split() if name not in LOSSY.split()), *LATER.split()),
    )

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """Every combination of the typed values, with the detectors and faults that they name."""
        from touchbench_streams.detectors import detectors

        parts = {key: value for key, value in values.items() if key.partition(".")[0] == "detector"}
        made = super().of(
            {key: value for key, value in values.items() if key not in (*parts, "under")}
        )
        under = cls._faults(values["under"]) if "under" in values else ()
        return [
            replace(one, detector=part.typed(), under=under)
            for one in made
            for part in detectors(parts)
        ]

    @staticmethod
    def _faults(typed: object) -> tuple[str, ...]:
        from touchbench_streams.stress import faults_of

        return faults_of(items("under", typed))

    @property
    def part(self) -> Part:
        """Its detector, with all parameters."""
        from touchbench_streams.detectors import detectors

        return detectors(labelled("detector", self.detector))[0]

    def identity(self) -> object:
        """Kind and options, with the code of the detector, further background as it is now, and the faults."""
        from bench.corpora.faults import identity_of
        from bench.corpora.library import stored_value
        from touchbench_streams.stored import holds_recordings

        digest = [stored_value(self.background).digest] if holds_recordings(self.background) else []
        return (
            repr(replace(self, detector="")),
            self.part.identity(),
            *digest,
            *identity_of(self.under),
        )

    def code(self) -> list[Code]:
        """The code of the detector and the faults, too."""
        from bench.corpora.faults import all_faults

        return [
            *super().code(),
            *self.part.code(),
            *(all_faults()[name].damage for name in self.under),
        ]

    def params(self) -> dict[str, object]:
        """Tracked as parameters."""
        return super().params() | {"watch.under": ", ".join(self.under)}

    def arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        given = super().arguments()
        if "under" in given and self.under == self._faults(ALL):
            given["under"] = ALL
        return given | (labelled("detector", self.detector) if "detector" in given else {})

    def captures(self, cell: Cell) -> Corpus | None:
        """Recordings with their background; captures, of which recordings are composed, where the data has none."""
        from touchbench_streams.stored import holds_recordings, whole

        if cell.data != "synth" and not holds_recordings(cell.data):
            return None
        return whole(cell.data, cell.data_parameters, cell.where)

    def refuse(self, plan: Plan) -> None:
        """Refuse folds that mix subjects or train on one, and a background that does not exist."""
        from touchbench_streams.fold import refuse

        refuse(plan, self.background, self.unknown)

    def warnings(self, plan: Plan) -> list[str]:
        """A line where the training background of recordings is too short for the accepted rate."""
        from touchbench_streams.fold import too_short

        return too_short(
            plan.corpus, [fold.train for fold in plan.folds], self.false_alarms, self.background
        )

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit, learn the post-processing on recordings of training subjects, watch those of the test subjects."""
        from touchbench_streams.fold import fold_of

        return fold_of(self, cell, corpus, fold, threads)

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Scores and costs of one fold, and its scores under each fault."""
        from bench.running.results import costs
        from touchbench_streams.events import numbers_of
        from touchbench_streams.stress import FAULTED, fault_table, tracked_scores

        numbers = costs([result]) | numbers_of(result.table, rate_hz)
        if self.under:
            numbers |= tracked_scores(fault_table(result.table, result.tables[FAULTED], rate_hz))
        return numbers

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Scores of touches, and in each case under faults; tables of touches, reports, subjects, the curve, cases."""
        from bench.running.results import tables_of
        from touchbench_streams.fold import run_numbers
        from touchbench_streams.stress import FAULTED, FAULTS, fault_table, tracked_scores

        rate_hz = plan.corpus.rate_hz
        numbers, tables = run_numbers(folds, rate_hz, self.unknown)
        if self.under:
            cases = tables_of(folds)[FAULTED]
            table = fault_table(tables["predictions"], cases, rate_hz, people=True)
            numbers, tables = (
                numbers | tracked_scores(table),
                tables | {FAULTED: cases, FAULTS: table},
            )
        return Result(about, numbers, tables)
