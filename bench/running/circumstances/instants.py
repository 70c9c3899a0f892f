"""The touch so far: labels after some of a capture, and the time when waiting gains no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from bench.errors import InputError
from bench.ground.typed import Values, split_values
from bench.running.circumstances.base import Circumstance, format_option, option

if TYPE_CHECKING:
    import pandas as pd

    from bench.plan.plan import Plan
    from bench.running.fitted import FittedFold
    from bench.running.results import FoldResult

EACH = "each"
SHOWN_MS = (250, 500, 1000, 2000)  # times of the numbers of a series


@dataclass(frozen=True)
class Instants(Circumstance):
    """Replays captures through a system fitted on whole ones; it may learn when to stop."""

    key: ClassVar[str] = "after"
    view: ClassVar[str] = "bench.reports.views.instants:Instants"
    tracked: ClassVar[tuple[str, ...]] = tuple(
        f"stream.{name}" for name in ("start", "hop_ms", "after", "stopping")
    )
    case_noun: ClassVar[str] = "time"
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
    def from_typed(cls, values: Values) -> list[Self]:
        """Return every combination of the typed values."""
        times = split_values("after", values["after"])
        if EACH in times:
            if len(times) > 1:
                typed = ",".join(map(str, times))
                raise InputError(f"after={typed}: each stands alone; give each, or times")
            values = {key: value for key, value in values.items() if key != "after"}
        elif "hop_ms" in values:
            raise InputError(
                f"hop_ms={values['hop_ms']}: after= names the times; leave one of them out"
            )
        return super().from_typed(values)

    def params(self) -> dict[str, object]:
        """Return its options as they are tracked."""
        times = ", ".join(map(format_option, self.after)) or EACH
        return dict(zip(self.tracked, (self.start, self.hop_ms, times, self.stopping), strict=True))

    def typed_arguments(self) -> dict[str, str]:
        """Return the options as typed."""
        times = ",".join(f"{format_option(ms)}ms" for ms in self.after) or EACH
        others = super().typed_arguments()
        others.pop("after", None)
        return {"after": times} | others

    def check_plan(self, plan: Plan) -> None:
        """Refuse impossible times, and training parts from which no threshold can be learned."""
        from bench.running.replay import why_unlearnable

        frame_ms = 1000 / plan.corpus.rate_hz
        advice = f"one frame takes {frame_ms:.4g} ms; give at least that"
        if self.after and min(self.after) < frame_ms:
            raise InputError(f"after={min(self.after):g}ms: {advice}")
        if self.hop_ms is not None and not frame_ms <= self.hop_ms < float("inf"):
            raise InputError(f"hop_ms={self.hop_ms:g}: {advice}, or leave it out")
        for fold in plan.folds if self.stopping else ():
            if why := why_unlearnable(plan.cell.untrained_system, plan.corpus[fold.train]):
                raise InputError(
                    f"protocol={plan.cell.protocol}: fold {fold.name} learns when to stop by "
                    f"leaving training subjects out, and {why}; choose another protocol or more "
                    "captures"
                )

    def warnings_of_plan(self, plan: Plan) -> list[str]:
        """Warn of times that no capture reaches, and of captures of equal length."""
        lines, prefix = [], f"warning: {plan.cell.data}: "
        longest_ms = 1000 * max(plan.corpus.lengths) / plan.corpus.rate_hz
        if late := [format_option(ms) + "ms" for ms in self.after if ms > longest_ms]:
            lines.append(
                f"{prefix}after={','.join(late)}: no capture lasts so long; the longest takes "
                f"{longest_ms:.0f} ms"
            )
        if len(set(plan.corpus.lengths)) == 1:
            lines.append(
                f"{prefix}all captures have the same length, so features that grow with time are "
                "trained on one duration only; early labels of these features may be wrong"
            )
        return lines

    def evaluate_fold(self, at: FittedFold) -> FoldResult:
        """Predict the test captures at every instant."""
        from bench.running.replay import replay_fold

        return replay_fold(self, at)

    def fold_metrics(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> dict[str, float]:
        """Return the accuracy of whole captures, and of stopping at the learned threshold."""
        from bench.values.stopping import replay_fold_metrics

        return replay_fold_metrics(tables, rate_hz)

    def measure_run(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Return accuracies after each time and of early stopping, and both curves."""
        from bench.running.results import combine_costs
        from bench.values.stopping import replay_run_metrics

        decision_ms = combine_costs(folds)["replay_ms_p95"]
        return replay_run_metrics(tables, self.after or SHOWN_MS, decision_ms, rate_hz)

    def own_label_rows(self, tables: Mapping[str, pd.DataFrame], rate_hz: float) -> pd.DataFrame:
        """Return the labels after each typed time, or after `SHOWN_MS`."""
        from bench.values.stopping import labels_after

        return labels_after(tables["replay"], self.after or SHOWN_MS, self.key, rate_hz)
