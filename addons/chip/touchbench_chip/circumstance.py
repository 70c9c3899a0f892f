"""Systems in C: labels of the test captures, and costs on a microcontroller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from bench.errors import InputError
from bench.ground.typed import Values, arguments_of_label, split_values
from bench.running.circumstances.base import Circumstance, option
from touchbench_chip.watching import find_watch_learner, make_watch_learner

if TYPE_CHECKING:
    import pandas as pd

    from bench.ground.source import Code
    from bench.plan.cells import Part
    from bench.plan.plan import Plan
    from bench.running.fitted import FittedFold
    from bench.running.results import FoldResult

C = "c"  # the value of form=, and the table with its probabilities


@dataclass(frozen=True)
class InC(Circumstance):
    """Export each fitted system as C, and let the C label the test captures."""

    key: ClassVar[str] = "form"
    view: ClassVar[str] = "touchbench_chip.view:ChipView"
    tracked: ClassVar[tuple[str, ...]] = ("chip.bits", "chip.toolchain")
    case_noun: ClassVar[str] = "form"
    columns: ClassVar[frozenset[str]] = frozenset({"python"})

    form: str = option(
        "", "c: also export each fitted system and measure its labels and costs in C", (C,)
    )
    bits: str = option("32", "bits per stored weight; 8 uses 16 for support vectors", ("32", "8"))
    detector: str = option(
        "", "finds touches in a stream, as for bench fit; used for the costs of watching"
    )

    @classmethod
    def from_typed(cls, values: Values) -> list[Self]:
        """Return a circumstance for each number of bits and detector."""
        for form in split_values("form", values["form"]):
            if form != C:
                raise InputError(f"form={form}: give {C}")
        detector_values, other_values = {}, {}
        for key, value in values.items():
            is_of_detector = key.partition(".")[0] == "detector"
            (detector_values if is_of_detector else other_values)[key] = value
        detectors = [""]
        if detector_values:
            parts = find_watch_learner().parse_detectors(detector_values)
            detectors = [part.as_argument() for part in parts]
        circumstances = super().from_typed(other_values)
        return [replace(c, detector=detector) for c in circumstances for detector in detectors]

    def params(self) -> dict[str, object]:
        """Bits, compilers and, if systems can watch, the detector."""
        from touchbench_chip.measure import toolchain_versions

        params = {"chip.bits": int(self.bits), "chip.toolchain": "; ".join(toolchain_versions())}
        if find_watch_learner() is not None:
            params["chip.detector"] = self.part.as_argument()
        return params

    def typed_arguments(self) -> dict[str, str]:
        """The options as typed."""
        arguments = {"form": C} | super().typed_arguments()
        if self.detector:
            arguments |= arguments_of_label("detector", self.detector)
        return arguments

    def identity(self) -> object:
        """Bits, the C that all systems share, the compilers, and the detector with its code."""
        from touchbench_chip.measure import toolchain_versions
        from touchbench_chip.write import hash_fixed_code

        identity = [self.bits, hash_fixed_code(), toolchain_versions()]
        if (learner := find_watch_learner()) is not None:
            identity += [self.part.identity(), learner.hash_c_code()]
        return identity

    @property
    def part(self) -> Part:
        """The detector, with all parameters."""
        return make_watch_learner(self.detector).part

    def code(self) -> list[Code]:
        """Add what the writers of C import late: networks, and systems that watch."""
        code = [*super().code(), "touchbench_chip.network"]
        if (learner := find_watch_learner()) is not None:
            code += [learner, *self.part.code()]
        return code

    def check_plan(self, plan: Plan) -> None:
        """Refuse a system that has no C, and a machine without the compilers."""
        from touchbench_chip.fold import check_plan

        check_plan(plan, self.detector)

    def warnings_of_plan(self, plan: Plan) -> list[str]:
        """Warn if no watcher can be learned."""
        from touchbench_chip.fold import why_watching_is_unmeasured

        reason = why_watching_is_unmeasured(plan)
        if not reason:
            return []
        return [f"warning: costs of watching an endless stream are not measured: {reason}"]

    def evaluate_fold(self, at: FittedFold) -> FoldResult:
        """Label the test captures in C; measure bytes and instructions."""
        from touchbench_chip.fold import label_in_c

        return label_in_c(at, int(self.bits), self.detector)

    def fold_metrics(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> dict[str, float]:
        """Accuracy in C, and the number of labels that differ from Python."""
        from touchbench_chip.fold import compare_with_python

        return compare_with_python(tables[C])

    def measure_run(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Accuracy in C over all folds, and the number of labels that differ from Python."""
        from touchbench_chip.fold import compare_with_python, summarise_c

        return summarise_c(tables[C], rate_hz) | compare_with_python(tables[C]), {}

    def own_label_rows(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """The labels given by the C."""
        from bench.values.scores import label_captures

        rows = label_captures(tables[C])[["fold", "capture", "subject", "true", "predicted"]]
        return rows.assign(
            circumstance=self.key, case=C, level=int(self.bits), amount=f"{self.bits} bits"
        )
