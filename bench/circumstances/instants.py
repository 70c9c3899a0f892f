"""The touch so far: the label of a capture after some of its time, and the time at which waiting gains no more."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

from bench.circumstances.base import Circumstance, option
from bench.errors import InputError
from bench.kinds.base import Spelling, typed_as
from bench.measures import Cost, Measure, percent
from bench.options import Command
from bench.words import Values, items

if TYPE_CHECKING:
    import pandas as pd

    from bench.candidate import Candidate, Wish
    from bench.plan.plan import Plan
    from bench.reports.part import Section
    from bench.result import Result
    from bench.source import Code
    from bench.work.fitted import Fitted
    from bench.work.replay import Replay
    from bench.work.results import FoldResult

EACH = "each"
SHOWN_MS = (250, 500, 1000, 2000)  # what is told of the curve
REPLAY = "replay"  # table with the probabilities at every instant


@dataclass(frozen=True)
class Instants(Circumstance):
    """Captures are replayed through a system that was fitted on whole ones; it may learn when to stop."""

    key: ClassVar[str] = "after"
    tracked: ClassVar[tuple[str, ...]] = ("stream.start", "stream.hop_ms", "stream.after", "stream.stopping")
    word: ClassVar[str] = "time"
    columns: ClassVar[frozenset[str]] = frozenset({"instant", "confidence", "settled"})
    alike: ClassVar[Mapping[str, tuple[str, str]]] = {
        "stream.start": ("from the {} of the capture", "onset"),
        "stream.hop_ms": ("a decision every {} ms", "None"),
        "stream.after": ("after {} ms", EACH),
    }

    after: tuple[float, ...] = option(
        (), "touch seen before a label, such as 250ms,1s, or each for a series", type="ms"
    )
    hop_ms: float | None = option(
        None, "ms between decisions; default: each uses 1.41 times as much touch", type="number"
    )
    start: str = option("onset", "start of the replay; middle skips half a capture", ("onset", "middle"))
    stopping: bool = option(False, "yes: learn on training subjects when to stop, with fits of its own", type="yes")

    def __post_init__(self) -> None:
        """Put the times in order."""
        object.__setattr__(self, "after", tuple(sorted({*self.after})))

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """Every combination of the typed values.

        Raises:
            InputError: a value cannot be used.
        """
        times = items("after", values["after"])
        if EACH not in times:
            if "hop_ms" in values:
                raise InputError(f"hop_ms={values['hop_ms']}: after= names the times; leave one of them out")
            return super().of(values)
        if len(times) > 1:
            raise InputError(f"after={','.join(map(str, times))}: each stands alone; give each, or times")
        return super().of({k: v for k, v in values.items() if k != "after"})

    @property
    def replay(self) -> Replay:
        """Settings of the replay."""
        from bench.work.replay import Replay

        return Replay(self.hop_ms, self.start, self.after)

    def options(self) -> dict[str, object]:
        """Times, hop, start, and whether stopping is learned."""
        times = ", ".join(map(typed_as, self.after)) or EACH
        return {
            "stream.start": self.start,
            "stream.hop_ms": self.hop_ms,
            "stream.after": times,
            "stream.stopping": self.stopping,
        }

    def changed(self) -> dict[str, str]:
        """The options as typed."""
        times = ",".join(f"{typed_as(ms)}ms" for ms in self.after) or EACH
        return {"after": times} | {k: v for k, v in super().changed().items() if k != "after"}

    def refuse(self, plan: Plan) -> None:
        """Refuse a replay that cannot be, and training parts from which no threshold can be learned.

        Raises:
            InputError: a training part of one subject, or of subjects one of whom has all but one class.
        """
        from bench.work.replay import unlearnable

        self.replay.check(plan.corpus.rate_hz)
        for fold in plan.folds if self.stopping else ():
            if why := unlearnable(plan.cell.untrained, plan.corpus[fold.train]):
                raise InputError(
                    f"protocol={plan.cell.protocol}: fold {fold.name} learns when to stop by leaving training subjects "
                    f"out, and {why}; choose another protocol or more captures"
                )

    def warnings(self, plan: Plan) -> list[str]:
        """Warn of times at which no capture goes on, and of captures of equal length."""
        lines, longest = [], 1000 * max(plan.corpus.lengths) / plan.corpus.rate_hz
        if late := [typed_as(ms) + "ms" for ms in self.after if ms > longest]:
            lines.append(
                f"warning: {plan.cell.data}: after={','.join(late)}: no capture lasts so long; the longest takes "
                f"{longest:.0f} ms"
            )
        if len(set(plan.corpus.lengths)) == 1:
            lines.append(
                f"warning: {plan.cell.data}: all captures have the same length, so features that grow with time are "
                "trained on one duration only; early labels of these features may be wrong"
            )
        return lines

    def depends(self) -> list[Code]:
        """The code of the replay."""
        return [type(self)]

    def fold(self, at: Fitted) -> FoldResult:
        """Labels at every instant; calibration and threshold see training captures alone."""
        from bench.work.replay import replay_fold

        return replay_fold(self.replay, at, self.stopping)

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Accuracy of whole captures, and of stopping at the learned threshold."""
        from bench.work.stopping import fold_numbers

        return fold_numbers(result.tables, rate_hz)

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Accuracy after each time and of adaptive stopping; both curves."""
        from bench.work.results import costs
        from bench.work.stopping import replay_numbers

        return replay_numbers(tables, self.after or SHOWN_MS, costs([*folds])["replay_ms_p95"], rate_hz)

    def labels(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """The label that stands after each time that was asked for, or after round ones."""
        from bench.work.stopping import standing_labels

        return standing_labels(tables[REPLAY], self.after or SHOWN_MS, self.key, rate_hz)

    commands: ClassVar[dict[str, Spelling]] = {
        "stream": Spelling(
            Command(
                "compare",
                "replay captures in time: accuracy against milliseconds of touch",
                "Replays captures and measures accuracy against milliseconds of touch, and computing time per "
                "decision. Adaptive stopping decides as soon as the expected gain from waiting is small, as learned on "
                "training subjects. It is bench run with after=each stopping=yes.",
                "bench stream data=haart protocol=loso model=svm,rf features=jung54\n"
                "bench stream data=haart model=svm start=onset,middle hop_ms=125",
            ),
            keys=("hop_ms", "start"),
            given={"after": EACH, "stopping": "yes"},
            out=("report", "folder for streaming.csv, stopping.csv and figures"),
        )
    }
    heading: ClassVar[str] = "Accuracy in percent, mean over subjects, against touch seen"
    ranked: ClassVar[bool] = True
    score: ClassVar[str] = "replay_accuracy"
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("start", read="stream.start", spare=10),
        percent("accuracy", "whole", "replay_accuracy", ends="replay_accuracy"),
        Measure("mean_ms", "mean ms", form=".0f", spare=16),
        percent("adaptive_accuracy", "early stop %"),
        Measure("adaptive_ms", "at mean ms", form=".0f"),
        Measure("decide_ms", "decision ms", tuple(f"replay_ms_p{p}" for p in (50, 95, 99)), spare=14),
        Measure("decisions_per_second", "decisions per s", form=".0f", spare=15),
        Measure("system_hop_ms", "system hop ms", form=".0f", spare=17),
    )
    costs: ClassVar[tuple[Cost, ...]] = (
        Cost(
            "decision",
            read="capture_ms",
            unit="ms",
            noun="decision time",
            words="until the decision",
            axis="ms of touch before the label",
            help="longest touch before the decision, such as 1s",
            watched=False,
            column=False,
            last=2,
        ),
    )

    @classmethod
    def shows(cls, results: Sequence[Result]) -> Sequence[Measure]:
        """Columns of the times that results have, and of early stopping where it was learned."""
        start, *others = (m for m in cls.shown if cls._learned(results) or not m.key.startswith("adaptive"))
        return [start, *cls.seen(results), *others]

    @classmethod
    def seen(cls, results: Sequence[Result]) -> list[Measure]:
        """Accuracy after each time that was asked for, or after round ones."""
        times = {k.split("_")[2] for r in results for k in r.metrics if k.startswith("accuracy_at_")}
        spare = {"500": 0, "1000": 0, "250": 5, "2000": 6}
        return [
            percent(f"at_{ms}", f"{ms} ms", f"accuracy_at_{ms}_ms", spare=spare.get(ms, 7))
            for ms in sorted(times, key=float)
        ]

    @classmethod
    def title(cls, results: Sequence[Result]) -> str:
        """Heading of the table, which says whether stopping was learned."""
        return cls.heading + "; stopping learned on training subjects" * cls._learned(results)

    @classmethod
    def _learned(cls, results: Sequence[Result]) -> bool:
        return any("adaptive_accuracy" in r for r in results)

    @classmethod
    def write(cls, results: Sequence[Result], folder: Path) -> list[str]:
        """Write the curves and their figure."""
        from bench.reports.streaming import write_streaming

        paths = write_streaming(results, folder, cls.alike)
        return [f"figure and tables: {', '.join(map(str, paths))}"] if paths else []

    @classmethod
    def then(cls, results: Sequence[Result]) -> str:
        """The next command to type."""
        from bench.outcomes.runs import choosing

        return choosing(results, by="decision")

    @classmethod
    def figure(cls, result: Result, folder: Path) -> None:
        """Draw accuracy against touch seen."""
        from bench.reports.figures import write_svg
        from bench.reports.streaming import draw

        write_svg(draw([result], cls.alike), folder / "streaming.svg")

    @classmethod
    def section(cls, results: Sequence[Result], folder: Path) -> Section | None:
        """Accuracy against touch seen, and the result of stopping at the learned threshold."""
        from bench.reports.streaming import stream_section

        return stream_section(results, folder, cls.alike, cls.seen)

    @classmethod
    def brief(cls, results: Sequence[Result]) -> tuple[str, str] | None:
        """The best system with early decisions."""
        from bench.reports.streaming import early

        return early(results, cls.alike)

    @classmethod
    def sheets(cls, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """Both curves of all systems."""
        from bench.reports.streaming import sheets

        return sheets(results) if results else {}

    @classmethod
    def offers(cls, result: Result, wish: Wish) -> bool:
        """True for a replay from the onset, where a time of decision was asked for."""
        return wish.most is not None and result.about["stream.start"] == "onset"

    @classmethod
    def candidates(cls, result: Result, wish: Wish) -> Iterator[Candidate]:
        """The system after each time that is soon enough."""
        from bench.outcomes.scored import early_candidates

        return early_candidates(result, wish)
