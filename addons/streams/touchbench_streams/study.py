"""Continuous recordings: touches found in a stream, false alarms and latency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from bench.corpora.fault_names import ALL_FAULTS, FAULT_NAMES, MORE_FAULT_NAMES, SHORTENING_FAULTS
from bench.ground.typed import Values, arguments_of_label, split_values
from bench.running.circumstances.base import RunKind, option
from bench.values.result import Result
from touchbench_streams import DETECTOR, FALSE_ALARMS

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.ground.source import Code
    from bench.plan.cells import Cell, Part
    from bench.plan.plan import Fold, Plan
    from bench.running.results import FoldResult


@dataclass(frozen=True)
class Continuous(RunKind):
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
        (
            *(name for name in FAULT_NAMES if name not in SHORTENING_FAULTS),
            *MORE_FAULT_NAMES,
        ),
    )

    @classmethod
    def from_typed(cls, values: Values) -> list[Self]:
        """Every combination of the typed values, with the detectors and faults that they name."""
        from touchbench_streams.detectors import parse_detectors

        parts = {key: value for key, value in values.items() if key.partition(".")[0] == "detector"}
        made = super().from_typed(
            {key: value for key, value in values.items() if key not in (*parts, "under")}
        )
        under = cls._parse_faults(values["under"]) if "under" in values else ()
        return [
            replace(one, detector=part.as_argument(), under=under)
            for one in made
            for part in parse_detectors(parts)
        ]

    @staticmethod
    def _parse_faults(typed: object) -> tuple[str, ...]:
        from touchbench_streams.stress import parse_faults

        return parse_faults(split_values("under", typed))

    @property
    def part(self) -> Part:
        """Its detector, with all parameters."""
        from touchbench_streams.detectors import parse_detectors

        return parse_detectors(arguments_of_label("detector", self.detector))[0]

    def identity(self) -> object:
        """Kind and options, with the code of the detector, further background as it is now, and the faults."""
        from bench.corpora.faults import fault_identity
        from bench.corpora.library import open_imported
        from touchbench_streams.stored import holds_recordings

        digest = (
            [open_imported(self.background).digest] if holds_recordings(self.background) else []
        )
        return (
            repr(replace(self, detector="")),
            self.part.identity(),
            *digest,
            *fault_identity(self.under),
        )

    def code(self) -> list[Code]:
        """The code of the detector and the faults, too."""
        from bench.corpora.faults import FAULTS

        return [
            *super().code(),
            *self.part.code(),
            *(FAULTS[name].damage for name in self.under),
        ]

    def params(self) -> dict[str, object]:
        """Tracked as parameters."""
        return super().params() | {"watch.under": ", ".join(self.under)}

    def typed_arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        given = super().typed_arguments()
        if "under" in given and self.under == self._parse_faults(ALL_FAULTS):
            given["under"] = ALL_FAULTS
        return given | (
            arguments_of_label("detector", self.detector) if "detector" in given else {}
        )

    def open_captures(self, cell: Cell) -> Corpus | None:
        """Recordings with their background; captures, of which recordings are composed, where the data has none."""
        from touchbench_streams.stored import holds_recordings, load_recordings

        if cell.data != "synth" and not holds_recordings(cell.data):
            return None
        return load_recordings(cell.data, cell.data_parameters, cell.where)

    def refuse_plan(self, plan: Plan) -> None:
        """Refuse folds that mix subjects or train on one, and a background that does not exist."""
        from touchbench_streams.fold import refuse

        refuse(plan, self.background, self.unknown)

    def warnings_of_plan(self, plan: Plan) -> list[str]:
        """A line where the training background of recordings is too short for the accepted rate."""
        from touchbench_streams.fold import short_background_warnings

        return short_background_warnings(
            plan.corpus, [fold.train for fold in plan.folds], self.false_alarms, self.background
        )

    def evaluate_fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit, learn the post-processing on training subjects, watch recordings of test subjects.

        The tracked numbers are scores, costs, and scores under each fault.
        """
        from bench.running.results import combine_costs
        from touchbench_streams.events import score_tables
        from touchbench_streams.fold import fold_of
        from touchbench_streams.stress import FAULTED, fault_table, tracked_scores

        result = fold_of(self, cell, corpus, fold, threads)
        metrics = combine_costs([result]) | score_tables(result.table, corpus.rate_hz)
        if self.under:
            table = fault_table(result.table, result.tables[FAULTED], corpus.rate_hz)
            metrics |= tracked_scores(table)
        return replace(result, tracked_metrics=metrics)

    def measure_run(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Scores of touches, and in each case under faults; tables of touches, reports, subjects, the curve, cases."""
        from bench.running.results import concat_fold_tables
        from touchbench_streams.fold import run_numbers
        from touchbench_streams.stress import FAULTED, FAULTS, fault_table, tracked_scores

        rate_hz = plan.corpus.rate_hz
        numbers, tables = run_numbers(folds, rate_hz, self.unknown)
        if self.under:
            cases = concat_fold_tables(folds)[FAULTED]
            table = fault_table(tables["predictions"], cases, rate_hz, people=True)
            numbers, tables = (
                numbers | tracked_scores(table),
                tables | {FAULTED: cases, FAULTS: table},
            )
        return Result(about, numbers, tables)
