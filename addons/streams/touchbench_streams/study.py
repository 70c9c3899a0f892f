"""The run kind of ``bench watch``: touches found in recordings, false alarms and latency."""

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
    """Touches found in recordings of the test subjects.

    Detector and post-processing are learned on training subjects. Recordings are those of the
    corpus, or they are composed of its captures (`touchbench_streams.composer`).
    """

    key: ClassVar[str] = "watch"
    view: ClassVar[str] = "touchbench_streams.view:Continuous"

    detector: str = option(
        DETECTOR,
        "finds the touches: {touchbench_streams.detectors}, or my.py:Mine; "
        "detector.NAME= sets a parameter",
    )
    false_alarms: float = option(
        FALSE_ALARMS, "false alarms per hour of background accepted in training", type="number"
    )
    background: str = option(
        "",
        "class without touch, or quiet: ends of captures; default notouch or quiet. "
        "For recordings: the name of further recordings without touch, to learn from",
    )
    unknown: str = option(
        "", "gesture to leave out of training; its touches should be labelled unknown"
    )
    under: tuple[str, ...] = option(
        (),
        "faults that the test recordings also go through, at five severities each, or all",
        (*(name for name in FAULT_NAMES if name not in SHORTENING_FAULTS), *MORE_FAULT_NAMES),
    )

    @classmethod
    def from_typed(cls, values: Values) -> list[Self]:
        """Every combination of the typed values, with their detectors and faults."""
        from touchbench_streams.detectors import parse_detectors, values_of_detector

        detector_values = values_of_detector(values)
        special_keys = {*detector_values, "under"}
        kinds = super().from_typed({k: v for k, v in values.items() if k not in special_keys})
        detectors = [part.as_argument() for part in parse_detectors(detector_values)]
        under = cls._parse_faults(values["under"]) if "under" in values else ()
        return [replace(k, detector=detector, under=under) for k in kinds for detector in detectors]

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
        """Kind and options, the detector with its code, the background's digest, and the faults."""
        from bench.corpora.faults import fault_identity
        from bench.corpora.library import open_imported
        from touchbench_streams.stored import holds_recordings

        identity = [repr(replace(self, detector="")), self.part.identity()]
        if holds_recordings(self.background):
            identity.append(open_imported(self.background).digest)
        return (*identity, *fault_identity(self.under))

    def code(self) -> list[Code]:
        """Add the code of the detector and of the faults."""
        from bench.corpora.faults import FAULTS

        faults = [FAULTS[name].damage for name in self.under]
        return [*super().code(), *self.part.code(), *faults]

    def params(self) -> dict[str, object]:
        """Its options as parameters of a run."""
        return super().params() | {"watch.under": ", ".join(self.under)}

    def typed_arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        arguments = super().typed_arguments()
        if "under" in arguments and self.under == self._parse_faults(ALL_FAULTS):
            arguments["under"] = ALL_FAULTS
        if "detector" in arguments:
            arguments |= arguments_of_label("detector", self.detector)
        return arguments

    def open_captures(self, cell: Cell) -> Corpus | None:
        """Open recordings with their background; None if the data are captures to compose with."""
        from touchbench_streams.stored import holds_recordings, load_recordings

        if cell.data != "synth" and not holds_recordings(cell.data):
            return None
        return load_recordings(cell.data, cell.data_parameters, cell.where, cell.design)

    def check_plan(self, plan: Plan) -> None:
        """Refuse folds that mix subjects or train on one, and a missing background."""
        from touchbench_streams.fold import check_plan

        check_plan(plan, self.background, self.unknown)

    def warnings_of_plan(self, plan: Plan) -> list[str]:
        """Warn if the training background of recordings is too short for the accepted rate."""
        from touchbench_streams.fold import short_background_warnings

        return short_background_warnings(
            plan.corpus, [fold.train for fold in plan.folds], self.false_alarms, self.background
        )

    def evaluate_fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit, learn the post-processing on training subjects, watch the test subjects' recordings.

        The tracked numbers are scores, costs, and scores under each fault.
        """
        from bench.running.results import combine_costs
        from touchbench_streams.events import score_tables
        from touchbench_streams.fold import watch_fold
        from touchbench_streams.stress import FAULT_REPORTS, fault_table, tracked_scores

        result = watch_fold(
            cell,
            corpus,
            fold,
            threads,
            detector=self.part.make_object(),
            false_alarms=self.false_alarms,
            background=self.background,
            unknown=self.unknown,
            under=self.under,
        )
        metrics = combine_costs([result]) | score_tables(result.table, corpus.rate_hz)
        if self.under:
            table = fault_table(result.table, result.tables[FAULT_REPORTS], corpus.rate_hz)
            metrics |= tracked_scores(table)
        return replace(result, tracked_metrics=metrics)

    def measure_run(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Scores of touches, also under each fault.

        The tables are those of `touchbench_streams.fold.run_numbers` and, with faults, their
        reports and scores.
        """
        from bench.running.results import concat_fold_tables
        from touchbench_streams import stress
        from touchbench_streams.fold import run_numbers

        rate_hz = plan.corpus.rate_hz
        numbers, tables = run_numbers(folds, rate_hz, self.unknown)
        if self.under:
            reports = concat_fold_tables(folds)[stress.FAULT_REPORTS]
            table = stress.fault_table(tables["predictions"], reports, rate_hz, by_subject=True)
            numbers |= stress.tracked_scores(table)
            tables |= {stress.FAULT_REPORTS: reports, stress.FAULT_SCORES: table}
        return Result(about, numbers, tables)
