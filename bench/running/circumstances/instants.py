"""The touch so far: the label of a capture after some of its time, and the time at which waiting gains no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from bench.errors import InputError
from bench.ground.words import Values, items
from bench.running.circumstances.base import Circumstance, option, typed_as

if TYPE_CHECKING:
    import pandas as pd

    from bench.plan.plan import Plan
    from bench.running.fitted import Fitted
    from bench.running.results import FoldResult

EACH = "each"
SHOWN_MS = (250, 500, 1000, 2000)  # times of the numbers of a series
REPLAY = "replay"  # table with the probabilities at every instant


@dataclass(frozen=True)
class Instants(Circumstance):
    """Captures are replayed through a system that was fitted on whole ones; it may learn when to stop."""

    key: ClassVar[str] = "after"
    view: ClassVar[str] = "bench.reports.views.instants:Instants"
    tracked: ClassVar[tuple[str, ...]] = (
        "stream.start",
        "stream.hop_ms",
        "stream.after",
        "stream.stopping",
    )
    word: ClassVar[str] = "time"
    columns: ClassVar[frozenset[str]] = frozenset({"instant", "confidence", "settled"})

    after: tuple[float, ...] = option(
        (), "touch seen before a label, such as 250ms,1s, or each for a series", type="ms"
    )
    hop_ms: float | None = option(
        None, "ms between decisions; default: each uses 1.41 times as much touch", type="number"
    )
    start: str = option(
        "onset", "start of the replay; middle skips half a capture", ("onset", "middle")
    )
    stopping: bool = option(
        False, "yes: learn on training subjects when to stop, with fits of its own", type="yes"
    )

    def __post_init__(self) -> None:
        """Put the times in order."""
        object.__setattr__(self, "after", tuple(sorted({*self.after})))

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """Every combination of the typed values."""
        times = items("after", values["after"])
        if EACH not in times:
            if "hop_ms" in values:
                raise InputError(
                    f"hop_ms={values['hop_ms']}: after= names the times; leave one of them out"
                )
            return super().of(values)
        if len(times) > 1:
            raise InputError(
                f"after={','.join(map(str, times))}: each stands alone; give each, or times"
            )
        return super().of({k: v for k, v in values.items() if k != "after"})

    def params(self) -> dict[str, object]:
        """Times, hop, start, and whether stopping is learned."""
        times = ", ".join(map(typed_as, self.after)) or EACH
        return dict(zip(self.tracked, (self.start, self.hop_ms, times, self.stopping), strict=True))

    def arguments(self) -> dict[str, str]:
        """The options as typed."""
        times = ",".join(f"{typed_as(ms)}ms" for ms in self.after) or EACH
        return {"after": times} | {k: v for k, v in super().arguments().items() if k != "after"}

    def refuse(self, plan: Plan) -> None:
        """Refuse a replay that cannot be, and training parts from which no threshold can be learned."""
        from bench.running.replay import unlearnable

        frame_ms = 1000 / plan.corpus.rate_hz
        least = f"one frame takes {frame_ms:.4g} ms; give at least that"
        if self.after and min(self.after) < frame_ms:
            raise InputError(f"after={min(self.after):g}ms: {least}")
        if self.hop_ms is not None and not frame_ms <= self.hop_ms < float("inf"):
            raise InputError(f"hop_ms={self.hop_ms:g}: {least}, or leave it out")
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

    def fold(self, at: Fitted) -> FoldResult:
        """Labels at every instant; calibration and threshold see training captures alone."""
        from bench.running.replay import replay_fold

        return replay_fold(self, at)

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Accuracy of whole captures, and of stopping at the learned threshold."""
        from bench.values.stopping import fold_numbers

        return fold_numbers(result.tables, rate_hz)

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Accuracy after each time and of adaptive stopping; both curves."""
        from bench.running.results import costs
        from bench.values.stopping import replay_numbers

        return replay_numbers(
            tables, self.after or SHOWN_MS, costs([*folds])["replay_ms_p95"], rate_hz
        )

    def labels(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """The label that stands after each time that was asked for, or after round ones."""
        from bench.values.stopping import standing_labels

        return standing_labels(tables[REPLAY], self.after or SHOWN_MS, self.key, rate_hz)
