"""Continuous recordings: touches found in a stream, false alarms and latency."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from bench.endless import DETECTOR, RATES, others
from bench.kinds.base import Kind, Spelling, option
from bench.measures import Cost, Measure, percent
from bench.options import Command
from bench.result import Result
from bench.usual import ALL, FALSE_ALARMS
from bench.words import FAULTS, LATER, LOSSY, SMALL, Values, items, labelled

if TYPE_CHECKING:
    import pandas as pd

    from bench.candidate import Candidate, Wish
    from bench.corpora.corpus import Corpus
    from bench.endless.detectors.base import Detects
    from bench.plan.cells import Cell, Part
    from bench.plan.plan import Fold, Plan
    from bench.reports.part import Section
    from bench.source import Code
    from bench.table import Table
    from bench.work.results import FoldResult


REFUSED = Measure("refused", read=lambda row: 100 * row["refused"] if row.get("refused") else None, spare=3)


@dataclass(frozen=True)
class Continuous(Kind):
    """Events in recordings of the test subjects; detector and post-processing are learned on training subjects.

    The corpus holds recordings, or they are composed of its captures (`bench.endless.composer`).
    """

    tag: ClassVar[str] = "watch"

    detector: str = option(DETECTOR, "finds the touches: {detectors}, or my.py:Mine; detector.NAME= sets a parameter")
    false_alarms: float = option(
        FALSE_ALARMS, "false alarms per hour of background accepted in training", type="number"
    )
    background: str = option(
        "",
        "class without touch, or quiet: ends of captures; default notouch or quiet. Of recordings: further ones "
        "without touch, to learn from",
    )
    unknown: str = option("", "gesture to leave out of training; its touches should be labelled unknown")
    under: tuple[str, ...] = option(
        (),
        "faults that the test recordings also go through, at five severities each, or all",
        (*(name for name in FAULTS.split() if name not in LOSSY.split()), *LATER.split()),
    )

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """Every combination of the typed values, with the detectors and faults that they name.

        Raises:
            InputError: a value cannot be used.
        """
        from bench.endless.detectors.named import detectors

        parts = {key: value for key, value in values.items() if key.partition(".")[0] == "detector"}
        made = super().of({key: value for key, value in values.items() if key not in (*parts, "under")})
        under = cls._faults(values["under"]) if "under" in values else ()
        return [replace(one, detector=part.typed(), under=under) for one in made for part in detectors(parts)]

    @staticmethod
    def _faults(typed: object) -> tuple[str, ...]:
        from bench.endless.stress import faults_of

        return faults_of("under", items("under", typed))

    @property
    def part(self) -> Part[Detects]:
        """Its detector, with all parameters."""
        from bench.endless.detectors.named import detectors

        return detectors(labelled("detector", self.detector))[0]

    def identity(self) -> object:
        """Kind and options, with the code of the detector, further background as it is now, and the faults."""
        from bench.corpora.faults import identity_of
        from bench.endless.background import digest_of

        more = [*digest_of(self.background), *identity_of(self.under)]
        return repr(replace(self, detector="")), self.part.identity(), *more

    def depends(self) -> list[Code]:
        """The code of the faults, too."""
        from bench.corpora.faults import all_faults

        return [type(self), *(all_faults()[name].damage for name in self.under)]

    def options(self) -> dict[str, object]:
        """Tracked as parameters."""
        return super().options() | {"watch.under": ", ".join(self.under)}

    def arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        given = super().arguments()
        if "under" in given and self.under == self._faults(ALL):
            given["under"] = ALL
        return given | (labelled("detector", self.detector) if "detector" in given else {})

    @classmethod
    def ready(cls, cells: list[Cell]) -> list[Cell]:
        """The cells, marked where their data holds recordings."""
        from bench.corpora.library import holds_recordings

        recorded = {name: name == "synth" or holds_recordings(name) for name in dict.fromkeys(c.data for c in cells)}
        return [cell.of_recordings() if recorded[cell.data] else cell for cell in cells]

    def refuse(self, plan: Plan) -> None:
        """Refuse folds that mix subjects or train on one, and a background that does not exist.

        Raises:
            InputError: there is one.
        """
        from bench.endless.watch import refuse

        refuse(plan, self.background, self.unknown)

    def warnings(self, plan: Plan) -> list[str]:
        """A line where the training background of recordings is too short for the accepted rate."""
        from bench.endless.watch import too_short

        return too_short(plan, self.false_alarms, self.background)

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit, learn the post-processing on recordings of training subjects, watch those of the test subjects."""
        from bench.endless.watch import fold_of

        detector = self.part.make()
        options = (self.false_alarms, self.background, self.unknown, self.under)
        return fold_of(cell, corpus, fold, threads, detector, *options)

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Scores and costs of one fold, and its scores under each fault."""
        from bench.endless.stress import FAULTED, fault_table, tracked_scores
        from bench.endless.watch import fold_numbers

        numbers = fold_numbers(result, rate_hz)
        if self.under:
            numbers |= tracked_scores(fault_table(result.table, result.tables[FAULTED], rate_hz))
        return numbers

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Scores of touches, means over subjects with intervals; tables of touches, reports, subjects and the curve.

        Under faults also the scores in each case, and the table `bench.endless.stress.FAULTS`.
        """
        from bench.endless.stress import run_under
        from bench.endless.watch import run_numbers

        rate_hz = plan.corpus.rate_hz
        numbers, tables = run_numbers(folds, rate_hz, self.unknown)
        if self.under:
            more, made = run_under(folds, rate_hz)
            numbers, tables = numbers | more, tables | made
        return Result(about, numbers, tables)

    commands: ClassVar[dict[str, Spelling]] = {
        "watch": Spelling(
            Command(
                "compare",
                "find touches in continuous recordings: false alarms, misses, latency",
                "Each fold trains on captures, and learns when to report a touch from recordings of training subjects. "
                "It then watches the recordings of the test subjects. data=synth and imported recordings are used as "
                "they are. From other corpora, one recording per subject is composed: excerpts of 2 to 6 s of each "
                "capture, with 3 to 10 s of background between them. Prints touches found, correct gestures when first "
                "reported and at the end, false alarms per hour of background, latency and reports per touch. "
                "Refused frames are counted if there are any. under= repeats this with faults of the test sensors.",
                f"bench watch data=haart protocol=loso {SMALL}\nbench watch data=haart model=reflex false_alarms=2\n"
                "bench watch data=haart model=lda features=touch detector=frames,threshold under=noise,vibration,drift",
            ),
        )
    }
    heading: ClassVar[str] = (
        "Percent of touches found, correct when first reported and at the end, means over subjects; false alarms per "
        "hour of background; in brackets 95 % intervals over subjects"
    )
    score: ClassVar[str] = "end_correct"
    unit: ClassVar[str] = "touches in recordings"
    recordings: ClassVar[bool] = True
    other: ClassVar[str] = "with another background"
    meaning: ClassVar[str] = "The score is of touches in recordings, with the label at the end."
    alike: ClassVar[Mapping[str, tuple[str, str]]] = {
        "watch.background": ("background: {}", ""),
        "watch.unknown": ("unknown gesture: {}", ""),
    }
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("detector", read=lambda row: others(row.get("watch.detector")), left=True, spare=1),
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
        *(percent(f"missed_at_{rate}", f"missed at {rate}/h", ends=f"missed_at_{rate}", spare=12) for rate in RATES),
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
            runs="recordings",
            among=lambda people: people.rate(),
            line=("stream", "false_alarms"),
            column=False,
            last=0,
        ),
        Cost(
            "latency",
            read="latency_s_p50",
            times=1000,
            unit="ms",
            noun="latency",
            words="of latency",
            axis="ms until half of the touches are reported",
            unknown="no touch was found",
            help="median latency, such as 1s; compares runs of bench watch",
            runs="recordings",
            line=("stream", "latency"),
            column=False,
            last=0,
        ),
    )

    @classmethod
    def printed(cls, results: Sequence[Result]) -> Iterator[str | Table]:
        """Scores under faults; lines of reports in doubtful stretches, and where no false alarms can be counted."""
        from bench.endless.fault_page import printed_tables

        yield from printed_tables(results, cls.alike)
        counts = [
            f"{r['doubtful_reports']:.0f} by {r.system}, detector={r.get('watch.detector', DETECTOR)}"
            for r in results
            if r.get("doubtful_reports")
        ]
        if counts:
            yield f"reports in doubtful stretches (?) are neither touches found nor alarms: {'; '.join(counts)}"
        if any(r.scored and not r.get("background_minutes") for r in results):
            yield "alarms/h is unknown: the recordings have no background"

    @classmethod
    def then(cls, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.outcomes.runs import choosing

        if results := [r for r in results if not r.get("watch.unknown")]:
            return choosing(results, max_false_alarms=f"{FALSE_ALARMS:g}", max_latency="1s")
        return super().then(results)

    @classmethod
    def figure(cls, result: Result, folder: Path) -> None:
        """Draw the timeline and missed touches against false alarms."""
        from bench.endless.page import draw

        draw(result, folder, cls.alike)

    @classmethod
    def section(cls, results: Sequence[Result], folder: Path) -> Section | None:
        """A figure for each group of comparable runs, a sentence on each system, and what faults cost."""
        from bench.endless.page import watch_section

        return watch_section(results, folder, cls.alike)

    @classmethod
    def sheets(cls, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Scores under faults."""
        from bench.endless.fault_page import sheet

        return {"recordings_under_faults": sheet(results)}

    @classmethod
    def chosen(cls, row: Mapping[str, Any]) -> str:
        """False alarms and latency of a chosen system."""
        from bench.sentences import sentences

        alarms, latency = (cost.amount(row[cost.key]) for cost in cls.costs)
        alarms = alarms.replace(" per", " false alarms per")
        return sentences("bench.endless", "touches", "chosen", alarms=alarms, latency=latency)[0]

    @classmethod
    def gestures(cls, result: Result) -> tuple[str, ...]:
        """All gestures of the recordings of a run, and the background."""
        from bench.endless.candidates import watched_gestures

        return watched_gestures(result)

    @classmethod
    def offers(cls, result: Result, wish: Wish) -> bool:
        """True unless a gesture was left out of training."""
        return not result.about.get("watch.unknown")

    @classmethod
    def candidates(cls, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system as it watched."""
        from bench.endless.candidates import watched_candidates

        return watched_candidates(result, wish, cls.unit)
