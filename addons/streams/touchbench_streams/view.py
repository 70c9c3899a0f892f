"""Touches found in recordings, false alarms and latency, as they are shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.ground.words import labelled
from bench.reports.views.base import View
from bench.values.candidate import Candidate
from bench.values.measures import TEXT, Cost, Measure, percent
from touchbench_streams import DETECTOR, FALSE_ALARMS, NO_TOUCH, RATES

if TYPE_CHECKING:
    import pandas as pd

    from bench.reports.contexts import Section
    from bench.values.candidate import Wish
    from bench.values.result import Result
    from bench.values.table import Table

REFUSED = Measure(
    "refused", read=lambda row: 100 * row["refused"] if row.get("refused") else None, spare=3
)


class Continuous(View):
    """Recordings of the test subjects."""

    heading: ClassVar[str] = (
        "Percent of touches found, correct when first reported and at the end, means over subjects; false alarms per "
        "hour of background; in brackets 95 % intervals over subjects"
    )
    score: ClassVar[str] = "end_correct"
    unit: ClassVar[str] = "touches in recordings"
    apart: ClassVar[bool] = True
    other: ClassVar[str] = "with another background"
    meaning: ClassVar[str] = "The score is of touches in recordings, with the label at the end."
    alike: ClassVar[Mapping[str, tuple[str, str]]] = {
        "watch.background": ("background: {}", ""),
        "watch.unknown": ("unknown gesture: {}", ""),
    }
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("detector", read=lambda row: Path(row["watch.detector"]).name, form=TEXT, spare=1),
        Measure("auroc", "AUROC", form=".2f", spare=1),
        percent("rejected_unknown", "rejected unknown", spare=1),
        percent("rejected_known", "rejected known", spare=1),
        Measure("touches", form=".0f", spare=8),
        percent("touches_found", "found"),
        Measure("fragments", "reports/touch", form=".2f"),
        percent("first_correct", "first"),
        percent("end_correct", "end", ends="end_correct"),
        Measure("false_alarms_per_hour", "alarms/h", ends="false_alarms_per_hour"),
        Measure("doubtful_reports", "alarms in ?", form=".0f", spare=2),
        Measure("latency_s_p50", "latency s", form=".2f"),
        Measure("latency_s_p90", "90 % s", form=".2f", spare=9),
        REFUSED,
        percent("merged", spare=10),
        percent("late", spare=11),
        *(
            percent(f"missed_at_{rate}", f"missed at {rate}/h", ends=f"missed_at_{rate}", spare=12)
            for rate in RATES
        ),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        Cost(
            "false_alarms",
            unit="per hour",
            noun="false-alarm rate",
            words="of false alarms",
            axis="false alarms per hour of background",
            unknown="the recordings have no background",
            help="false alarms per hour of background; compares runs of bench watch",
            on=("watch",),
            among=lambda people: people.rate(),
            section="stream",
            shows=(),
        ),
        Cost(
            "latency",
            read="latency_s_p50",
            scale=lambda seconds: 1000 * seconds,
            unit="ms",
            noun="latency",
            words="of latency",
            axis="ms until half of the touches are reported",
            unknown="no touch was found",
            help="median latency, such as 1s; compares runs of bench watch",
            on=("watch",),
            section="stream",
            shows=(),
        ),
    )

    def printed(self, results: Sequence[Result]) -> Iterator[str | Table]:
        """Scores under faults; lines of reports in doubtful stretches, and where no false alarms can be counted."""
        from touchbench_streams.page import printed_tables

        yield from printed_tables(results, self.alike)
        counts = [
            f"{r['doubtful_reports']:.0f} by {r.system}, detector={r['watch.detector']}"
            for r in results
            if r.get("doubtful_reports")
        ]
        if counts:
            yield f"reports in doubtful stretches (?) are neither touches found nor alarms: {'; '.join(counts)}"
        if any(r.scored and not r.get("background_minutes") for r in results):
            yield "alarms/h is unknown: the recordings have no background"

    def then(self, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.reading.frame import choosing

        if results := [r for r in results if not r.get("watch.unknown")]:
            return choosing(results, max_false_alarms=f"{FALSE_ALARMS:g}", max_latency="1s")
        return super().then(results)

    def figure(self, result: Result, folder: Path) -> None:
        """Draw the timeline and missed touches against false alarms."""
        from touchbench_streams.page import draw

        draw(result, folder, self.alike)

    def section(self, results: Sequence[Result], folder: Path) -> Section | None:
        """A figure for each group of comparable runs, a sentence on each system, and what faults cost."""
        from touchbench_streams.page import watch_section

        return watch_section(results, folder, self.alike)

    def sheets(self, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Scores under faults."""
        from touchbench_streams.page import sheet

        return {"recordings_under_faults": sheet(results)}

    def chosen(self, row: Mapping[str, Any]) -> str:
        """False alarms and latency of a chosen system."""
        from bench.values.sentences import sentences

        alarms, latency = (cost.amount(row[cost.key]) for cost in self.costs)
        alarms = alarms.replace(" per", " false alarms per")
        return sentences("touchbench_streams", "touches", "chosen", alarms=alarms, latency=latency)[
            0
        ]

    def gestures(self, result: Result) -> tuple[str, ...]:
        """All gestures of the recordings of a run, and the background."""
        touches = result.tables["touches"]
        return tuple(
            sorted({*touches["gesture"].astype(str), str(result["watch.background"]) or NO_TOUCH})
        )

    def offers(self, result: Result, wish: Wish) -> bool:
        """True unless a gesture was left out of training."""
        return not result.about.get("watch.unknown")

    def candidates(self, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system as it watched, with false alarms and hours of background by subject."""
        shares = result.tables["per_subject"].set_index("subject")
        scores, hours = 100 * shares["end_correct"].dropna(), shares["background_s"] / 3600
        if not wish.reactions.plain:
            wish.reactions.of(self.gestures(result))  # refuses other names
            scores = wish.reactions.scores(
                result.tables["touches"].rename(columns={"gesture": "true", "label": "predicted"})
            )
        unit, aim, detector = (
            self.unit,
            float(result["watch.false_alarms"]),
            str(result["watch.detector"]),
        )
        unit += "" if aim == FALSE_ALARMS else f", false_alarms={aim:g}"
        unit += "" if detector == DETECTOR else f", detector={detector}"
        alarms = (shares["false_alarms_per_hour"] * hours).fillna(0)
        shipped = {"background": str(result["watch.background"])} | labelled("detector", detector)
        shipped["false_alarms"] = f"{aim:g}"
        usual = {
            "background": "",
            "detector": DETECTOR,
            "false_alarms": f"{FALSE_ALARMS:g}",
        }  # of bench fit
        shipped = {key: value for key, value in shipped.items() if usual.get(key) != value}
        yield Candidate(unit, scores, counts=(alarms, hours), whole=True, shipped=shipped)
