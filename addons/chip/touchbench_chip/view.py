"""Tables of accuracy and costs in C."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.reports.views.base import View
from bench.values.measures import (
    TEXT,
    Cost,
    Measure,
    Row,
    percent_measure,
    text_measure,
    to_thousands,
    value_or_none,
)
from bench.values.table import Table
from touchbench_chip.circumstance import C

if TYPE_CHECKING:
    import pandas as pd

    from bench.reading.reactions import Reactions
    from bench.reports.sections import Exhibit
    from bench.values.candidate import Candidate
    from bench.values.result import Result

WATCHING = (  # columns of the costs of watching an endless stream
    text_measure("system", source=lambda r: r.system),
    Measure("bits", source="chip.bits"),
    Measure("detector", source=lambda row: row.get("chip.detector"), form=TEXT, spare=3),
    Measure("flash", "flash kB", "chip_watch_flash_bytes", ",.1f", scale=to_thousands),
    Measure("ram", "RAM kB", "chip_watch_ram_bytes", ",.1f", scale=to_thousands),
    Measure("stack", "stack B", "chip_watch_stack_bytes", ",.0f"),
    Measure("idle", "instructions a frame", "chip_watch_idle_instructions", ",.0f"),
    Measure("frame", "in a touch", "chip_watch_frame_instructions", ",.0f"),
    Measure("most", "at most", "chip_watch_most_instructions", ",.0f"),
    Measure("recorded", "on a recording", "chip_watch_recorded_instructions", ",.0f", spare=1),
    Measure(
        "recorded_most", "at most there", "chip_watch_recorded_most_instructions", ",.0f", spare=2
    ),
)


def instructions_per_s(row: Row) -> float | None:
    """Thousand instructions of C per second; None without C."""
    per_frame = value_or_none(row.get("chip_frame_instructions"))
    if per_frame is None or not row.get("taxels"):
        return None
    return per_frame * row["values_per_s"] / row["taxels"] / 1000


class ChipView(View):
    """Systems in C beside the same systems in Python."""

    heading: ClassVar[str] = (
        "Accuracy in percent of whole captures, mean over subjects, in C and in Python; "
        "linked for a Cortex-M4F"
    )
    marks_best: ClassVar[bool] = True
    score: ClassVar[str] = "c_accuracy"
    columns: ClassVar[tuple[Measure, ...]] = (
        Measure("bits", source="chip.bits"),
        percent_measure("accuracy", "in C", "c_accuracy", ends="c_accuracy"),
        percent_measure("python_accuracy", "in Python", "accuracy"),
        Measure("other_labels", "other labels", form=",.0f", spare=4),
        Measure("chip_flash_bytes", "flash kB", form=",.1f", scale=to_thousands),
        Measure("chip_ram_bytes", "library RAM kB", form=",.1f", scale=to_thousands),
        Measure("chip_program_ram_bytes", "program RAM kB", form=",.1f", scale=to_thousands),
        Measure("chip_stack_bytes", "stack B", form=",.0f"),
        Measure("chip_frame_instructions", "instructions a frame", form=",.0f", spare=3),
        Measure("chip_most_instructions", "at most", form=",.0f"),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        Cost(
            "cycles",
            source="chip_most_instructions",
            scale=to_thousands,
            unit="k",
            noun="instruction count",
            phrase="instructions",
            axis="thousand instructions of the costliest frame in C",
            why_unknown="only form=c counts them",
            help="most instructions for the costliest frame, such as 600k",
            spare=5,
            command="run form=c",
            at_clock="decision",
            shows=(),
        ),
        Cost(
            "instructions",
            source=instructions_per_s,
            unit="k",
            section="skin",
            noun="instructions per second",
            phrase="instructions per second",
            why_unknown="only form=c counts them",
            help="most instructions per second in C, such as 5M",
            command="run form=c",
            shows=(),
        ),
    )

    def further_output(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """Costs of the systems that can watch an endless stream."""
        if watching := [r for r in results if "chip_watch_flash_bytes" in r]:
            yield Table(WATCHING, watching, "Costs of touch_watch, which watches an endless stream")

    def next_command(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choose_command

        return choose_command(results, by="cycles")

    def make_exhibits(self, results: Sequence[Result], folder: Path) -> list[Exhibit]:
        """No exhibits: systems in C are marks of the chart."""
        return []

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Accuracy and costs in C of all systems."""
        columns = [text_measure("system", source=lambda r: r.system), *self.columns]
        return {"chip": Table(columns, results).to_frame()} if results else {}

    def candidates(
        self, result: Result, reactions: Reactions, latest_ms: float | None
    ) -> Iterator[Candidate]:
        """The system in C."""
        from bench.reading.reactions import react_to_captures
        from bench.values.candidate import Candidate

        bits = result.attributes["chip.bits"]
        costs = {"flash": "chip_flash_bytes", "ram": "chip_ram_bytes", "predict": ""}
        scores = reactions.score_by_subject(react_to_captures(result.tables[C], reactions))
        yield Candidate(f"in C, {bits} bits", scores, costs, mark="C", whole=bits == "32")

    def shared_costs(self, result: Result) -> dict[str, float]:
        """Linked bytes of 32-bit C, whose labels are those of Python; counted bytes lack code."""
        if str(result.attributes["chip.bits"]) != "32":
            return {}
        return {f"{name}_bytes": result.metrics[f"chip_{name}_bytes"] for name in ("flash", "ram")}
