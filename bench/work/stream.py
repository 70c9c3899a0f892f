"""Systems in a stream: fitted on whole captures, replayed on the touch so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, ClassVar

from bench.errors import InputError
from bench.measures import Measure, percent
from bench.outcomes.results import FoldResult, costs, table_of
from bench.outcomes.stopping import SHOWN_MS, by_instant, by_threshold, learned_point, shown, stopped
from bench.result import Result
from bench.work.experiment import Experiment
from bench.work.fold import SOME, batch_effects, computing, fitted, footprint, latency
from bench.work.replay import (
    STATE,
    Replay,
    decision_latency,
    learned,
    prefix,
    replayed,
    system_hop,
    unlearnable,
    weighed,
)

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan


@dataclass(frozen=True)
class Stream(Experiment):
    """Accuracy against touch seen, and adaptive stopping learned on training subjects.

    Attributes:
        hop_ms: milliseconds from one decision to the next, None for the series of `Replay`.
        start: ``onset`` or ``middle``.
    """

    kind: ClassVar[str] = "stream"
    fold_kind: ClassVar[str] = "stream_fold"
    heading: ClassVar[str] = "Accuracy in percent against touch seen; stopping learned on training subjects"
    ranked: ClassVar[bool] = True
    columns: ClassVar[frozenset[str]] = frozenset({"instant", "confidence", "settled"})
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("start", read="stream.start", spare=10),
        *(
            percent(f"at_{ms}", f"{ms} ms", f"accuracy_at_{ms}_ms", spare={2000: 6, 250: 5}.get(ms, 0))
            for ms in SHOWN_MS
        ),
        percent("accuracy", "whole", ends="accuracy"),
        Measure("mean_ms", "mean ms", form=".0f", spare=16),
        percent("adaptive_accuracy", "early stop %"),
        Measure("adaptive_ms", "at mean ms", form=".0f"),
        Measure("decide_ms", "decision ms", tuple(f"decide_ms_p{p}" for p in (50, 95, 99)), spare=14),
        Measure("decisions_per_second", "decisions per s", form=".0f", spare=15),
        Measure("system_hop_ms", "system hop ms", form=".0f", spare=17),
    )

    hop_ms: float | None = None
    start: str = "onset"

    @property
    def replay(self) -> Replay:
        """Settings of the replay."""
        return Replay(self.hop_ms, self.start)

    def arguments(self) -> dict[str, str]:
        """Hop and start where they are not the default."""
        hop = {} if self.hop_ms is None else {"hop_ms": f"{self.hop_ms:g}"}
        return hop | ({} if self.start == "onset" else {"start": self.start})

    def refuse(self, plan: Plan) -> None:
        """Refuse a replay that cannot be, and training parts from which no threshold can be learned.

        Raises:
            InputError: a training part of one subject, or of subjects one of whom has all but one class.
        """
        self.replay.check(plan.corpus.rate_hz)
        for fold in plan.folds:
            if why := unlearnable(plan.cell.untrained, plan.corpus[fold.train]):
                raise InputError(
                    f"protocol={plan.cell.protocol}: fold {fold.name} learns when to stop by leaving training subjects "
                    f"out, and {why}; choose another protocol or more captures"
                )

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit on whole training captures, replay the test captures; calibration and threshold see only the former.

        ``trials`` of the result is what each threshold gives on training subjects, ``chosen`` what was learned from
        them.
        """
        begun = self.replay.begun(corpus)
        instants = self.replay.instants(int(begun.lengths.max()), corpus.rate_hz)
        estimator = cell.estimator()
        with computing(threads):
            stopping, series = learned(cell.estimator, corpus, fold.train, self.replay)
            metrics = fitted(estimator, corpus[fold.train])
            table = replayed(estimator, begun, fold.name, fold.test, instants)
            early = prefix(begun, int(instants[len(instants) // 2]))
            effects = batch_effects(estimator, corpus, fold.test) + batch_effects(
                estimator, early, fold.test, most=SOME
            )
            table = weighed(table, stopping.calibration, stopping.waiting, corpus.rate_hz)
        with computing(1):
            predict_ms, *_ = latency(estimator, corpus[fold.test], int(corpus.lengths.max()))
            decide_ms = decision_latency(estimator, begun[fold.test], instants)
        metrics |= footprint(estimator, corpus)
        if hop := system_hop(estimator, corpus[fold.train]):
            metrics["system_hop_ms"] = 1000 / corpus.rate_hz * hop
        chosen: dict[str, object] = {"threshold": stopping.threshold}
        chosen |= {f"temperature_{k}": v for k, v in asdict(stopping.calibration).items()}
        chosen |= {f"waiting_{name}": weight for name, weight in zip(STATE, stopping.waiting.weights, strict=True)}
        return FoldResult(
            fold.name, table, metrics, predict_ms, decide_ms, chosen=chosen, trials=series, batch_effects=effects
        )

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Accuracy of whole captures, and of stopping at the learned threshold; costs."""
        point = learned_point(result.table, thresholds([result]), rate_hz)
        labelled = stopped(result.table, float("inf"))
        return costs([result]) | {
            "accuracy": float((labelled["true"] == labelled["predicted"]).mean()),
            "adaptive_accuracy": point["accuracy"],
            "adaptive_ms": point["mean_ms"],
        }

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Accuracy of whole captures and of adaptive stopping, and the cost of a decision; both curves."""
        predictions, rate_hz = table_of(folds), plan.corpus.rate_hz
        instants, stopping = by_instant(predictions, rate_hz), by_threshold(predictions, rate_hz)
        end = instants.iloc[-1]
        point = learned_point(predictions, thresholds(folds), rate_hz)
        metrics = costs(folds)
        metrics |= {"decisions_per_second": 1000 / metrics["decide_ms_p95"]}
        metrics |= {"accuracy": end["accuracy"], "accuracy_low": end["low"], "accuracy_high": end["high"]}
        metrics |= {"mean_ms": end["mean_ms"], "adaptive_ms": point["mean_ms"]}
        metrics |= {f"adaptive_{k}": point[k] for k in ("accuracy", "low", "high")}
        metrics |= {f"accuracy_at_{ms}_ms": value for ms, value in shown(predictions, rate_hz).items()}
        tables = {"predictions": predictions, "instants": instants, "stopping": stopping}
        return Result(about, {k: float(v) for k, v in metrics.items() if v == v}, tables)


def thresholds(results: list[FoldResult]) -> dict[str, float]:
    """Thresholds of settledness, learned from the training part of each fold."""
    return {r.name: float(str(r.chosen["threshold"])) for r in results}
