"""Systems in C: an exported system labels the test captures, and its cost on a microcontroller is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from bench.errors import InputError
from bench.grammar.options import workers_of_packages
from bench.ground.typed import Values, arguments_of_label, split_values
from bench.running.circumstances.base import Circumstance, option

if TYPE_CHECKING:
    import pandas as pd

    from bench.ground.source import Code
    from bench.plan.cells import Part
    from bench.plan.plan import Plan
    from bench.running.fitted import FittedFold
    from bench.running.results import FoldResult

C = "c"  # the form, and the table with its probabilities


def find_watch_learners() -> list[Any]:
    """What learns the post-processing for endless streams, where it is installed."""
    return [*workers_of_packages("fit").values()]


def make_watch_learner(detector: str) -> Any:
    """What learns to watch with a detector; empty for the usual one of ``bench fit``."""
    return find_watch_learners()[0](arguments_of_label("detector", detector) if detector else {})


@dataclass(frozen=True)
class InC(Circumstance):
    """The C that a fitted system is exported as labels the test captures."""

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
        "", "finds the touches of a stream, as of bench fit; for the costs of watching"
    )

    @classmethod
    def from_typed(cls, values: Values) -> list[Self]:
        """A circumstance for each number of bits and detector."""
        for form in split_values("form", values["form"]):
            if form != C:
                raise InputError(f"form={form}: give {C}")
        of_detector = {
            key: value for key, value in values.items() if key.partition(".")[0] == "detector"
        }
        made = super().from_typed(
            {key: value for key, value in values.items() if key not in of_detector}
        )
        named = (
            [part.as_argument() for part in find_watch_learners()[0].parts(of_detector)]
            if of_detector
            else [""]
        )
        return [replace(one, detector=name) for one in made for name in named]

    def params(self) -> dict[str, object]:
        """Bits and compilers."""
        from touchbench_chip.measure import toolchain_versions

        params = {"chip.bits": int(self.bits), "chip.toolchain": "; ".join(toolchain_versions())}
        return params | (
            {"chip.detector": self.part.as_argument()} if find_watch_learners() else {}
        )

    def typed_arguments(self) -> dict[str, str]:
        """The options as typed."""
        return (
            {"form": C}
            | super().typed_arguments()
            | (arguments_of_label("detector", self.detector) if self.detector else {})
        )

    def identity(self) -> object:
        """Bits, the C that is the same for all systems, the compilers, and the detector with its code."""
        from touchbench_chip.measure import toolchain_versions
        from touchbench_chip.write import hash_fixed_code

        watching = (
            [self.part.identity(), find_watch_learners()[0].c_digest()]
            if find_watch_learners()
            else []
        )
        return [self.bits, hash_fixed_code(), toolchain_versions(), *watching]

    @property
    def part(self) -> Part:
        """The detector, with all parameters."""
        return make_watch_learner(self.detector).part

    def code(self) -> list[Code]:
        """What those who write the C import late: of networks, and of systems that watch."""
        watching = [*find_watch_learners(), *self.part.code()] if find_watch_learners() else []
        return [*super().code(), "touchbench_chip.network", *watching]

    def refuse_plan(self, plan: Plan) -> None:
        """Refuse a system that has no C, and a machine without the programs."""
        from touchbench_chip.fold import refuse

        refuse(plan, self.detector)

    def warnings_of_plan(self, plan: Plan) -> list[str]:
        """Warn where no watcher can be learned."""
        from touchbench_chip.fold import watching_warnings

        return watching_warnings(plan)

    def evaluate_fold(self, at: FittedFold) -> FoldResult:
        """Labels of the test captures by the C; bytes and instructions."""
        from touchbench_chip.fold import label_in_c

        return label_in_c(at, int(self.bits), self.detector)

    def fold_metrics(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> dict[str, float]:
        """Accuracy in C, and labels that are others than in Python."""
        from touchbench_chip.fold import compare_with_python

        return compare_with_python(tables[C])

    def measure_run(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Accuracy in C over all folds, and captures that it labels otherwise than Python."""
        from touchbench_chip.fold import compare_with_python, summarise_c

        return summarise_c(tables[C], rate_hz) | compare_with_python(tables[C]), {}

    def label_rows(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """The labels of the C."""
        from bench.values.scores import label_captures

        rows = label_captures(tables[C])[["fold", "capture", "subject", "true", "predicted"]]
        return rows.assign(
            circumstance=self.key, case=C, level=int(self.bits), amount=f"{self.bits} bits"
        )
