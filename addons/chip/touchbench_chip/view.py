"""Accuracy and costs in C."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.reports.views.base import View
from bench.values.measures import TEXT, Cost, Measure, in_thousands, percent, text
from bench.values.table import Table
from touchbench_chip.circumstance import C

if TYPE_CHECKING:
    import pandas as pd

    from bench.values.candidate import Candidate, Wish
    from bench.values.result import Result

WATCHING = (  # columns of the costs of watching an endless stream
    text("system", read=lambda r: r.system),
    Measure("bits", read="chip.bits"),
    Measure("detector", read=lambda row: row.get("chip.detector"), form=TEXT, spare=3),
    Measure("flash", "flash kB", "chip_watch_flash_bytes", ",.1f", scale=in_thousands),
    Measure("ram", "RAM kB", "chip_watch_ram_bytes", ",.1f", scale=in_thousands),
    Measure("stack", "stack B", "chip_watch_stack_bytes", ",.0f"),
    Measure("idle", "instructions a frame", "chip_watch_idle_instructions", ",.0f"),
    Measure("frame", "in a touch", "chip_watch_frame_instructions", ",.0f"),
    Measure("most", "at most", "chip_watch_most_instructions", ",.0f"),
    Measure("recorded", "on a recording", "chip_watch_recorded_instructions", ",.0f", spare=1),
    Measure(
        "recorded_most", "at most there", "chip_watch_recorded_most_instructions", ",.0f", spare=2
    ),
)


class InC(View):
    """Systems in C, beside themselves in Python."""

    heading: ClassVar[str] = (
        "Accuracy in percent of whole captures, mean over subjects, in C and in Python; a Cortex-M4F, linked"
    )
    ranked: ClassVar[bool] = True
    score: ClassVar[str] = "c_accuracy"
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("bits", read="chip.bits"),
        percent("accuracy", "in C", "c_accuracy", ends="c_accuracy"),
        percent("python_accuracy", "in Python", "accuracy"),
        Measure("other_labels", "other labels", form=",.0f", spare=4),
        Measure("chip_flash_bytes", "flash kB", form=",.1f", scale=in_thousands),
        Measure("chip_ram_bytes", "library RAM kB", form=",.1f", scale=in_thousands),
        Measure("chip_program_ram_bytes", "program RAM kB", form=",.1f", scale=in_thousands),
        Measure("chip_stack_bytes", "stack B", form=",.0f"),
        Measure("chip_frame_instructions", "instructions a frame", form=",.0f", spare=3),
        Measure("chip_most_instructions", "at most", form=",.0f"),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        Cost(
            "cycles",
            read="chip_most_instructions",
            scale=in_thousands,
            unit="k",
            noun="instruction count",
            words="instructions",
            axis="thousand instructions of the costliest frame in C",
            unknown="only form=c counts them",
            help="most instructions for the costliest frame, such as 600k",
            on=("captures",),
            spare=5,
            command="run form=c",
            at_clock="decision",
            shows=(),
        ),
    )

    def printed(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """Costs of watching an endless stream, of the systems that can."""
        if watching := [r for r in results if "chip_watch_flash_bytes" in r]:
            yield Table(WATCHING, watching, "Costs of touch_watch, which watches an endless stream")

    def then(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choosing

        return choosing(results, by="cycles")

    def section(self, results: Sequence[Result], folder: Path) -> None:
        """None: systems in C are marks of the chart."""

    def sheets(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Accuracy and costs of all systems."""
        columns = [text("system", read=lambda r: r.system), *self.shown]
        return {"chip": Table(columns, results).frame()} if results else {}

    def candidates(self, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system in C."""
        from bench.reading.reactions import by_capture
        from bench.values.candidate import Candidate

        bits, own = (
            result.about["chip.bits"],
            {"flash": "chip_flash_bytes", "ram": "chip_ram_bytes", "predict": ""},
        )
        scores = wish.reactions.scores(by_capture(result.tables[C], wish.reactions))
        yield Candidate(
            f"in C, {bits} bits", scores, own, mark="C", linked=True, whole=bits == "32"
        )

    def lends(self, result: Result) -> dict[str, float]:
        """Bytes as linked in 32 bits, whose labels are those of Python: the counted ones leave code out."""
        if str(result.about["chip.bits"]) != "32":
            return {}
        return {f"{name}_bytes": result.metrics[f"chip_{name}_bytes"] for name in ("flash", "ram")}
