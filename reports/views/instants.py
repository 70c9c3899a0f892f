"""Accuracy after some of a touch, and of early decisions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.reports.views.base import View
from bench.values.measures import Cost, Measure, percent_measure

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from bench.reading.reactions import Reactions
    from bench.values.candidate import Candidate
    from bench.values.result import Result

# Attributes of a run in its tables.
CONTEXT = ("system", "data", "synthetic", "subset", "target", "protocol_label")
ON_PAGE = (  # columns of the table on the page, after the times
    percent_measure("replay_accuracy", "whole"),
    percent_measure("adaptive_accuracy", "adaptive", spare=1),
    Measure("adaptive_ms", "after ms", form=".0f", spare=1),
    Measure("replay_ms", "computing ms p50 / p95", ("replay_ms_p50", "replay_ms_p95")),
)
CAPTION = (
    "accuracy in percent, mean over subjects, after given milliseconds of touch, and with adaptive "
    "stopping after a mean time of touch; computing time per decision."
)
COMPUTING = ("replay_ms_p50", "replay_ms_p95", "replay_ms_p99")
FIGURE = "Left: accuracy against milliseconds of touch. Right: fixed windows and adaptive stopping."


class Instants(View):
    """Accuracy against milliseconds of touch."""

    shared_parameters: ClassVar[Mapping[str, tuple[str, str]]] = {
        "stream.start": ("from the {} of the capture", "onset"),
        "stream.hop_ms": ("a decision every {} ms", "None"),
        "stream.after": ("after {} ms", "each"),
    }
    heading: ClassVar[str] = "Accuracy in percent, mean over subjects, against touch seen"
    section_heading: ClassVar[str] = "Early decisions"
    section_summary: ClassVar[str] = "accuracy against milliseconds of touch"
    marks_best: ClassVar[bool] = True
    score: ClassVar[str] = "replay_accuracy"
    columns: ClassVar[tuple[Measure, ...]] = (
        Measure("start", source="stream.start", spare=10),
        percent_measure("accuracy", "whole", "replay_accuracy", ends="replay_accuracy"),
        Measure("mean_ms", "mean ms", form=".0f", spare=16),
        percent_measure("adaptive_accuracy", "early stop %"),
        Measure("adaptive_ms", "at mean ms", form=".0f"),
        Measure("decide_ms", "computing ms", COMPUTING, spare=14),
        Measure("decisions_per_second", "decisions per s", form=".0f", spare=15),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        Cost(
            "decision",
            source="capture_ms",
            unit="ms",
            noun="decision time",
            phrase="until the decision",
            axis="ms of touch before the label",
            help="longest touch before the decision, such as 1s",
            measured_on=("captures",),
            spare=2,
            shows=(),
        ),
    )

    def table_columns(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Columns of the times that results have, and of early stopping where it was learned."""
        start, *others = self.columns
        if not self._has_learned_stopping(results):
            others = [m for m in others if not m.key.startswith("adaptive")]
        return [start, *self.accuracy_columns(results), *others]

    def accuracy_columns(self, results: Sequence[Result]) -> list[Measure]:
        """Accuracy after each time that was asked for, or after round ones."""
        names = (name for r in results for name in r.metrics if name.startswith("accuracy_at_"))
        times = {name.split("_")[2] for name in names}
        spare = {"500": 0, "1000": 0, "250": 5, "2000": 6}
        return [
            percent_measure(f"at_{ms}", f"{ms} ms", f"accuracy_at_{ms}_ms", spare=spare.get(ms, 7))
            for ms in sorted(times, key=float)
        ]

    def table_title(self, results: Sequence[Result]) -> str:
        """Heading of the table, which says whether stopping was learned."""
        learned = "; stopping learned on training subjects" * self._has_learned_stopping(results)
        return self.heading + learned

    def _has_learned_stopping(self, results: Sequence[Result]) -> bool:
        return any("adaptive_accuracy" in r for r in results)

    def next_command(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choose_command

        return choose_command(results, by="decision")

    def draw_run(self, result: Result, folder: Path) -> None:
        """Draw accuracy against touch seen."""
        from bench.reports.figures import write_svg

        write_svg(self.draw_for_page([result]), folder / "streaming.svg")

    def page_columns(self, results: Sequence[Result]) -> Sequence[Measure]:
        """Accuracy after each time, and of stopping at the learned threshold."""
        return [*self.accuracy_columns(results), *ON_PAGE]

    def page_captions(self) -> tuple[str, str]:
        """Captions of the figure and of the table on the page."""
        return FIGURE, CAPTION

    def draw_for_page(self, results: Sequence[Result]) -> Figure:
        """Accuracy against touch seen."""
        from bench.reports.curves import draw_touch_seen

        return draw_touch_seen(results)

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Accuracy by instant of all systems, and of each threshold if stopping was learned."""
        import pandas as pd

        tables = {}
        for file, name in (("streaming", "instants"), ("stopping", "stopping")):
            parts = []
            for r in (r for r in results if name in r.tables):
                context = {key: r[key] for key in CONTEXT} | {"start": r["stream.start"]}
                table = r.tables[name]
                parts.append(table.assign(**context)[[*context, *table]])
            if parts:
                tables[file] = pd.concat(parts, ignore_index=True)
        return tables

    def has_candidate(self, result: Result) -> bool:
        """True for a replay from the onset."""
        return result.attributes["stream.start"] == "onset"

    def candidates(
        self, result: Result, reactions: Reactions, latest_ms: float | None
    ) -> Iterator[Candidate]:
        """The system after each time that is soon enough."""
        from bench.reading.reactions import early_candidates

        return early_candidates(result, reactions, latest_ms)
