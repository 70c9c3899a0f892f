"""C in place of Python: the labels of an exported system, and what it takes on a Cortex-M4F."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from bench.circumstances.base import Circumstance, option
from bench.errors import InputError
from bench.kinds.base import Spelling
from bench.measures import Cost, Measure, over_people, percent, text
from bench.options import Command, used
from bench.table import Table
from bench.words import Values, items, labelled

if TYPE_CHECKING:
    import pandas as pd

    from bench.candidate import Candidate, Wish
    from bench.plan.cells import Part
    from bench.plan.plan import Plan
    from bench.result import Result
    from bench.source import Code
    from bench.work.fitted import Fitted
    from bench.work.results import FoldResult

C = "c"  # the form, and the table with its probabilities
WATCHING = (  # columns of the costs of watching an endless stream
    text("system", read=lambda r: r.system),
    Measure("bits", read="chip.bits"),
    Measure("detector", read=lambda row: row.get("chip.detector"), left=True, spare=3),
    Measure("flash", "flash kB", "chip_watch_flash_bytes", ",.1f", per=1000),
    Measure("ram", "RAM kB", "chip_watch_ram_bytes", ",.1f", per=1000),
    Measure("stack", "stack B", "chip_watch_stack_bytes", ",.0f"),
    Measure("idle", "instructions a frame", "chip_watch_idle_instructions", ",.0f"),
    Measure("frame", "in a touch", "chip_watch_frame_instructions", ",.0f"),
    Measure("most", "at most", "chip_watch_most_instructions", ",.0f"),
    Measure("recorded", "on a recording", "chip_watch_recorded_instructions", ",.0f", spare=1),
    Measure("recorded_most", "at most there", "chip_watch_recorded_most_instructions", ",.0f", spare=2),
)


def watchers() -> list[Any]:
    """What learns the post-processing for endless streams, where it is installed."""
    return [*used("fit").values()]


@dataclass(frozen=True)
class InC(Circumstance):
    """The C that a fitted system is exported as labels the test captures."""

    key: ClassVar[str] = "form"
    tracked: ClassVar[tuple[str, ...]] = ("chip.bits", "chip.toolchain")
    word: ClassVar[str] = "form"
    columns: ClassVar[frozenset[str]] = frozenset({"python"})

    form: str = option("", "c: also export each fitted system and measure its labels and costs in C", (C,))
    bits: str = option("32", "bits per stored weight; 8 uses 16 for support vectors", ("32", "8"))
    detector: str = option("", "finds the touches of a stream, as of bench fit; for the costs of watching")

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """A circumstance for each number of bits.

        Raises:
            InputError: there is no such form, number or detector.
        """
        for form in items("form", values["form"]):
            if form != C:
                raise InputError(f"form={form}: give {C}")
        of_detector = {key: value for key, value in values.items() if key.partition(".")[0] == "detector"}
        made = super().of({key: value for key, value in values.items() if key not in of_detector})
        named = [part.typed() for part in watchers()[0].parts(of_detector)] if of_detector else [""]
        return [replace(one, detector=name) for one in made for name in named]

    def options(self) -> dict[str, object]:
        """Bits and compilers."""
        from bench.in_c.measure import toolchain

        params = {"chip.bits": int(self.bits), "chip.toolchain": "; ".join(toolchain())}
        return params | ({"chip.detector": self.part.typed()} if watchers() else {})

    def changed(self) -> dict[str, str]:
        """The options as typed."""
        return {"form": C} | super().changed() | (labelled("detector", self.detector) if self.detector else {})

    def identity(self) -> object:
        """Bits, the C that is the same for all systems, the compilers, and the detector with its code."""
        from bench.in_c.measure import toolchain
        from bench.in_c.write import digest

        return [self.bits, digest(), toolchain(), self.part.identity() if watchers() else ""]

    @property
    def part(self) -> Part[Any]:
        """The detector, with all parameters."""
        from bench.in_c.fold import watching

        return watching(self.detector).part

    def depends(self) -> list[Code]:
        """What those who write the C import late: of networks, and of systems that watch."""
        from bench.in_c import network

        return [type(self), network, *watchers()]

    def refuse(self, plan: Plan) -> None:
        """Refuse a system that has no C, and a machine without the programs.

        Raises:
            InputError: either.
        """
        from bench.in_c.fold import refuse

        refuse(plan, self.detector)

    def warnings(self, plan: Plan) -> list[str]:
        """Warn where no watcher can be learned."""
        from bench.in_c.fold import warnings

        return warnings(plan)

    def fold(self, at: Fitted) -> FoldResult:
        """Labels of the test captures by the C; bytes and instructions."""
        from bench.in_c.fold import fold

        return fold(at, int(self.bits), self.detector)

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Accuracy in C, and labels that are others than in Python."""
        from bench.in_c.fold import compared

        return compared(result.tables[C])

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Accuracy in C over all folds, and captures that it labels otherwise than Python."""
        from bench.in_c.fold import compared, scored

        return scored(tables[C], rate_hz) | compared(tables[C]), {}

    def labels(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """The labels of the C."""
        from bench.scores import captures

        rows = captures(tables[C])[["fold", "capture", "subject", "true", "predicted"]]
        return rows.assign(circumstance=self.key, case=C, level=int(self.bits), amount=f"{self.bits} bits")

    commands: ClassVar[dict[str, Spelling]] = {
        "chip": Spelling(
            Command(
                "compare",
                "measure accuracy and cost of systems as C on a microcontroller",
                "Each fold trains, exports as bench export does, and classifies the test captures in C and in Python. "
                "The C is linked for a Cortex-M4F with 256 KiB of flash and 32 KiB of RAM. QEMU counts instructions: "
                "the mean per frame, and the costliest frame with its label. library RAM is the state of touch.c. "
                "program RAM is the whole program with 4096 bytes for heap and stack. A second table has the costs of "
                "touch_watch, if the system can watch a stream. For recordings, the emulator also watches the first "
                "minute of one. It is bench run with form=c. Needs cc, make, "
                "arm-none-eabi-gcc and qemu-system-arm (Debian: gcc make gcc-arm-none-eabi libnewlib-arm-none-eabi "
                "qemu-system-arm).",
                "bench chip data=haart protocol=loso model=reflex bits=32,8\n"
                "bench choose data=haart protocol=loso max_flash=64kB max_ram=32kB max_cycles=1M",
            ),
            keys=("bits", "detector"),
            given={"form": C},
        )
    }
    heading: ClassVar[str] = (
        "Accuracy in percent of whole captures, mean over subjects, in C and in Python; a Cortex-M4F, linked"
    )
    ranked: ClassVar[bool] = True
    score: ClassVar[str] = "c_subject_accuracy_mean"
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("bits", read="chip.bits"),
        over_people("accuracy", "in C", "c_"),
        percent("python_accuracy", "in Python", "subject_accuracy_mean"),
        Measure("other_labels", "other labels", form=",.0f", spare=4),
        Measure("chip_flash_bytes", "flash kB", form=",.1f", per=1000),
        Measure("chip_ram_bytes", "library RAM kB", form=",.1f", per=1000),
        Measure("chip_program_ram_bytes", "program RAM kB", form=",.1f", per=1000),
        Measure("chip_stack_bytes", "stack B", form=",.0f"),
        Measure("chip_frame_instructions", "instructions a frame", form=",.0f", spare=3),
        Measure("chip_most_instructions", "at most", form=",.0f"),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        Cost(
            "cycles",
            read="chip_most_instructions",
            per=1000,
            unit="k",
            noun="instruction count",
            words="instructions",
            axis="thousand instructions of the costliest frame in C",
            unknown="only bench chip counts them",
            help="most instructions for the costliest frame, such as 600k",
            watched=False,
            command="chip",
            column=False,
            last=5,
        ),
    )

    @classmethod
    def printed(cls, results: Sequence[Result]) -> Iterator[str | Table]:
        """Costs of watching an endless stream, of the systems that can."""
        if watching := [r for r in results if "chip_watch_flash_bytes" in r]:
            yield Table(WATCHING, watching, "Costs of touch_watch, which watches an endless stream")

    @classmethod
    def then(cls, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.outcomes.runs import choosing

        return choosing(results, by="cycles")

    @classmethod
    def section(cls, results: Sequence[Result], folder: Path) -> None:
        """None: systems in C are marks of the chart."""

    @classmethod
    def sheets(cls, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Accuracy and costs of all systems."""
        columns = [text("system", read=lambda r: r.system), *cls.shown]
        return {"chip": Table(columns, results).frame()} if results else {}

    @classmethod
    def candidates(cls, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system in C."""
        from bench.candidate import Candidate
        from bench.outcomes.reactions import by_capture

        bits, own = result.about["chip.bits"], {"flash": "chip_flash_bytes", "ram": "chip_ram_bytes", "predict": ""}
        scores = wish.reactions.scores(by_capture(result.tables[C], wish.reactions))
        yield Candidate(f"in C, {bits} bits", scores, own, mark="C", linked=True, whole=bits == "32")

    @classmethod
    def lends(cls, result: Result) -> dict[str, float]:
        """Bytes as linked in 32 bits, whose labels are those of Python: the counted ones leave code out."""
        if str(result.about["chip.bits"]) != "32":
            return {}
        return {f"{name}_bytes": result.metrics[f"chip_{name}_bytes"] for name in ("flash", "ram")}
