"""Touches found in recordings, false alarms and latency, as they are shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.ground.typed import arguments_of_label
from bench.reports.views.base import View
from bench.values.candidate import Candidate
from bench.values.measures import TEXT, Cost, Measure, percent_measure
from touchbench_streams import DETECTOR, FALSE_ALARMS, NO_TOUCH, RATES

if TYPE_CHECKING:
    import pandas as pd

    from bench.reading.reactions import Reactions
    from bench.reports.sections import Exhibit
    from bench.values.result import Result
    from bench.values.table import Table

REFUSED = Measure(
    "refused", source=lambda row: 100 * row["refused"] if row.get("refused") else None, spare=3
)


class Continuous(View):
    """Recordings of the test subjects."""

    heading: ClassVar[str] = (
        "Percent of touches found, correct when first reported and at the end, means over subjects; false alarms per "
        "hour of background; in brackets 95 % intervals over subjects"
    )
    score: ClassVar[str] = "end_correct"
    shared_parameters: ClassVar[Mapping[str, tuple[str, str]]] = {
        "watch.background": ("background: {}", ""),
        "watch.unknown": ("unknown gesture: {}", ""),
    }
    columns: ClassVar[tuple[Measure, ...]] = (
        Measure(
            "detector", source=lambda row: Path(row["watch.detector"]).name, form=TEXT, spare=1
        ),
        Measure("auroc", "AUROC", form=".2f", spare=1),
        percent_measure("rejected_unknown", "rejected unknown", spare=1),
        percent_measure("rejected_known", "rejected known", spare=1),
        Measure("touches", form=".0f", spare=8),
        percent_measure("touches_found", "found"),
        Measure("fragments", "reports/touch", form=".2f"),
        percent_measure("first_correct", "first"),
        percent_measure("end_correct", "end", ends="end_correct"),
        Measure("false_alarms_per_hour", "alarms/h", ends="false_alarms_per_hour"),
        Measure("doubtful_reports", "alarms in ?", form=".0f", spare=2),
        Measure("latency_s_p50", "latency s", form=".2f"),
        Measure("latency_s_p90", "90 % s", form=".2f", spare=9),
        REFUSED,
        percent_measure("merged", spare=10),
        percent_measure("late", spare=11),
        *(
            percent_measure(
                f"missed_at_{rate}", f"missed at {rate}/h", ends=f"missed_at_{rate}", spare=12
            )
            for rate in RATES
        ),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        Cost(
            "false_alarms",
            unit="per hour",
            noun="false-alarm rate",
            phrase="of false alarms",
            axis="false alarms per hour of background",
            why_unknown="the recordings have no background",
            help="false alarms per hour of background; compares runs of bench watch",
            measured_on=("watch",),
            of_people=lambda people: people.events_per_hour(),
            section="stream",
            shows=(),
        ),
        Cost(
            "latency",
            source="latency_s_p50",
            scale=lambda seconds: 1000 * seconds,
            unit="ms",
            noun="latency",
            phrase="of latency",
            axis="ms until half of the touches are reported",
            why_unknown="no touch was found",
            help="median latency, such as 1s; compares runs of bench watch",
            measured_on=("watch",),
            section="stream",
            shows=(),
        ),
    )

    def further_output(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """Scores under faults; lines of reports in doubtful stretches, and where no false alarms can be counted."""
        from touchbench_streams.page import printed_tables

        yield from printed_tables(results, self.shared_parameters)
        counts = [
            f"{r['doubtful_reports']:.0f} by {r.system}, detector={r['watch.detector']}"
            for r in results
            if r.get("doubtful_reports")
        ]
        if counts:
            yield f"reports in doubtful stretches (?) are neither touches found nor alarms: {'; '.join(counts)}"
        if any(r.has_scores and not r.get("background_minutes") for r in results):
            yield "alarms/h is unknown: the recordings have no background"

    def next_command(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choose_command

        if results := [r for r in results if not r.get("watch.unknown")]:
            return choose_command(results, max_false_alarms=f"{FALSE_ALARMS:g}", max_latency="1s")
        return super().next_command(results)

    def draw_run(self, result: Result, folder: Path) -> None:
        """Draw the timeline and missed touches against false alarms."""
        from touchbench_streams.page import draw_watch_run

        draw_watch_run(result, folder, self.shared_parameters)

    def make_exhibits(self, results: Sequence[Result], folder: Path) -> list[Exhibit]:
        """A figure for each group of comparable runs, a sentence on each system, and the cost of faults."""
        from touchbench_streams.page import watch_section

        return watch_section(results, folder, self.shared_parameters)

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Scores under faults."""
        from touchbench_streams.page import fault_scores

        return {"recordings_under_faults": fault_scores(results)}

    def describe_choice(self, row: Mapping[str, Any]) -> str:
        """False alarms and latency of a chosen system."""
        from bench.values.sentences import render_sentences

        alarms, latency = (cost.format_amount(row[cost.key]) for cost in self.costs)
        alarms = alarms.replace(" per", " false alarms per")
        return render_sentences(
            "touchbench_streams", "touches", "chosen", alarms=alarms, latency=latency
        )[0]

    def gesture_names(self, result: Result) -> tuple[str, ...]:
        """All gestures of the recordings of a run, and the background."""
        touches = result.tables["touches"]
        return tuple(
            sorted({*touches["gesture"].astype(str), str(result["watch.background"]) or NO_TOUCH})
        )

    def has_candidate(self, result: Result) -> bool:
        """True unless a gesture was left out of training."""
        return not result.attributes.get("watch.unknown")

    def candidates(
        self, result: Result, reactions: Reactions, latest_ms: float | None
    ) -> Iterator[Candidate]:
        """The system as it watched, with false alarms and hours of background by subject."""
        shares = result.tables["per_subject"].set_index("subject")
        scores, hours = 100 * shares["end_correct"].dropna(), shares["background_s"] / 3600
        if not reactions.is_default:
            reactions.reaction_by_gesture(self.gesture_names(result))  # refuses other names
            scores = reactions.score_by_subject(
                result.tables["touches"].rename(columns={"gesture": "true", "label": "predicted"})
            )
        unit, aim, detector = (
            "touches in recordings",
            float(result["watch.false_alarms"]),
            str(result["watch.detector"]),
        )
        unit += "" if aim == FALSE_ALARMS else f", false_alarms={aim:g}"
        unit += "" if detector == DETECTOR else f", detector={detector}"
        alarms = (shares["false_alarms_per_hour"] * hours).fillna(0)
        shipped = {"background": str(result["watch.background"])} | arguments_of_label(
            "detector", detector
        )
        shipped["false_alarms"] = f"{aim:g}"
        usual = {
            "background": "",
            "detector": DETECTOR,
            "false_alarms": f"{FALSE_ALARMS:g}",
        }  # of bench fit
        shipped = {key: value for key, value in shipped.items() if usual.get(key) != value}
        yield Candidate(unit, scores, counts=(alarms, hours), whole=True, fit_keys=shipped)
