"""Touches found in recordings, false alarms and latency, as they are shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.ground.typed import arguments_of_label
from bench.reports.views.base import View
from bench.values.candidate import Candidate
from bench.values.measures import Cost, Measure
from touchbench_streams import DETECTOR, FALSE_ALARMS, NO_TOUCH
from touchbench_streams.columns import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

    from bench.reading.reactions import Reactions
    from bench.reports.sections import Exhibit
    from bench.values.result import Result
    from bench.values.table import Table


class Continuous(View):
    """Recordings of the test subjects."""

    heading: ClassVar[str] = (
        "Percent of touches found, correct when first reported and at the end, means over "
        "subjects; false alarms per hour of background; in brackets 95 % intervals over subjects"
    )
    score: ClassVar[str] = "end_correct"
    shared_parameters: ClassVar[Mapping[str, tuple[str, str]]] = {
        "watch.background": ("background: {}", ""),
        "watch.unknown": ("unknown gesture: {}", ""),
    }
    columns: ClassVar[tuple[Measure, ...]] = COLUMNS
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
        """Scores under faults; notes on doubtful stretches and on missing background."""
        from touchbench_streams.page import fault_tables

        yield from fault_tables(results, self.shared_parameters)
        counts = [
            f"{r['doubtful_reports']:.0f} by {r.system}, detector={r['watch.detector']}"
            for r in results
            if r.get("doubtful_reports")
        ]
        if counts:
            yield (
                "reports in doubtful stretches (?) are neither touches found nor alarms: "
                + "; ".join(counts)
            )
        if any(r.has_scores and not r.get("background_minutes") for r in results):
            yield "alarms/h is unknown: the recordings have no background"

    def next_command(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choose_command

        if known := [r for r in results if not r.get("watch.unknown")]:
            return choose_command(known, max_false_alarms=f"{FALSE_ALARMS:g}", max_latency="1s")
        return super().next_command(known)

    def draw_run(self, result: Result, folder: Path) -> None:
        """Draw the timeline, and missed touches against false alarms."""
        from touchbench_streams.page import draw_watch_run

        draw_watch_run(result, folder, self.shared_parameters)

    def make_exhibits(self, results: Sequence[Result], folder: Path) -> list[Exhibit]:
        """A figure of each group of comparable runs, sentences on systems, and fault tables."""
        from touchbench_streams.page import make_watch_exhibits

        return make_watch_exhibits(results, folder, self.shared_parameters)

    def csv_tables(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Scores under faults."""
        from touchbench_streams.page import fault_scores

        return {"recordings_under_faults": fault_scores(results)}

    def describe_choice(self, row: Mapping[str, Any]) -> str:
        """False alarms and latency of a chosen system."""
        from bench.values.sentences import render_sentences

        alarms, latency = (cost.format_amount(row[cost.key]) for cost in self.costs)
        alarms = alarms.replace(" per", " false alarms per")
        (sentence, *_) = render_sentences(
            "touchbench_streams", "touches", "chosen", alarms=alarms, latency=latency
        )
        return sentence

    def gesture_names(self, result: Result) -> tuple[str, ...]:
        """All gestures of the recordings of a run, and the background."""
        background = str(result["watch.background"]) or NO_TOUCH
        return tuple(sorted({*result.tables["touches"]["gesture"].astype(str), background}))

    def has_candidate(self, result: Result) -> bool:
        """True unless a gesture was left out of training."""
        return not result.attributes.get("watch.unknown")

    def candidates(
        self, result: Result, reactions: Reactions, latest_ms: float | None
    ) -> Iterator[Candidate]:
        """The watching system, with false alarms and hours of background by subject."""
        subjects = result.tables["per_subject"].set_index("subject")
        hours = subjects["background_s"] / 3600
        alarms = (subjects["false_alarms_per_hour"] * hours).fillna(0)
        if reactions.is_default:
            scores = 100 * subjects["end_correct"].dropna()
        else:
            reactions.reaction_by_gesture(self.gesture_names(result))  # refuses other names
            touches = result.tables["touches"]
            scores = reactions.score_by_subject(
                touches.rename(columns={"gesture": "true", "label": "predicted"})
            )
        detector = str(result["watch.detector"])
        accepted = f"{float(result['watch.false_alarms']):g}"
        default_alarms = f"{FALSE_ALARMS:g}"
        unit = "touches in recordings"
        if accepted != default_alarms:
            unit += f", false_alarms={accepted}"
        if detector != DETECTOR:
            unit += f", detector={detector}"
        options = {"background": str(result["watch.background"])}
        options |= arguments_of_label("detector", detector) | {"false_alarms": accepted}
        defaults = {"background": "", "detector": DETECTOR, "false_alarms": default_alarms}
        fit_keys = {key: value for key, value in options.items() if defaults.get(key) != value}
        yield Candidate(unit, scores, counts=(alarms, hours), whole=True, fit_keys=fit_keys)
