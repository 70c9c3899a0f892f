"""Systems in continuous recordings: false alarms, missed touches and latency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.composer import composed, is_recorded, pieces, recorded
from bench.corpora.recordings import Recordings
from bench.errors import InputError
from bench.outcomes.events import intervals, matched, per_subject, summary
from bench.outcomes.results import Findings, FoldResult, costs, table_of
from bench.work import watcher
from bench.work.experiment import Experiment
from bench.work.fold import SOME, TIMED_CAPTURES, batch_effects, computing, fitted, footprint, milliseconds

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan

SEED = 0  # of the composed recordings
QUIET = "quiet"  # background from the ends of captures
USUAL = "notouch"  # class of background, where a corpus has it
OFFSETS = np.arange(-4, 4.5, 0.5)  # from the learned bias, for the curve
SHOWN_S = 120.0  # of a recording in each fold, for the timeline


@dataclass(frozen=True)
class Watch(Experiment[dict[str, pd.DataFrame]]):
    """Events in recordings of the test subjects; detector and post-processing are learned on training subjects.

    The recordings are those of the corpus, or composed of its captures (`bench.corpora.composer`). The stored table of
    a fold has rows of several kinds (``kind``): a ``recording`` (``end`` is its number of frames), a ``touch``
    (``start``, ``end``, ``gesture``), a ``report`` (columns of `bench.outcomes.events.REPORT`), a point of the
    ``curve`` (``confidence`` is the offset of the bias, ``start`` the touches found, ``end`` the false alarms) and the
    ``probability`` of touch after ``reported`` frames of the first two minutes.

    Attributes:
        false_alarms: false alarms per hour of background that are accepted on training subjects.
        background: class of background, ``quiet`` for the ends of captures, or empty for ``notouch`` where it exists.
    """

    kind: ClassVar[str] = "watch"
    fold_kind: ClassVar[str] = "watch_fold"
    heading: ClassVar[str] = (
        "Percent of touches found, correct when first reported and at the end; false alarms per hour of background"
    )
    columns: ClassVar[frozenset[str]] = frozenset({"kind", "end", "reported", "first", "label", "confidence"})

    false_alarms: float = 5.0
    background: str = ""

    def arguments(self) -> dict[str, str]:
        """The options that differ from their defaults."""
        alarms = {} if self.false_alarms == Watch.false_alarms else {"false_alarms": f"{self.false_alarms:g}"}
        return alarms | ({"background": self.background} if self.background else {})

    def depends(self) -> list:
        """The modules whose code its numbers depend on."""
        from bench.corpora import composer
        from bench.outcomes import events

        return [type(self), watcher, composer, events]

    def _background(self, corpus: Corpus) -> str:
        """The background of a corpus of captures."""
        return self.background or (USUAL if USUAL in corpus.gestures else QUIET)

    def recordings(self, corpus: Corpus) -> Recordings:
        """Recordings of the subjects of some captures: their own, or composed ones.

        Raises:
            InputError: there is no background to compose them with.
        """
        if is_recorded(corpus):
            return recorded(corpus)
        return composed(*pieces(corpus, self._background(corpus)), SEED)

    def refuse(self, plan: Plan) -> None:
        """Refuse folds that mix subjects or train on one, and a background that does not exist.

        Raises:
            InputError: there is one.
        """
        corpus, name = plan.corpus, plan.cell.protocol
        if plan.mixes_subjects:
            raise InputError(
                f"protocol={name}: bench watch needs other subjects in the test part; choose loso or challenge"
            )
        if is_recorded(corpus) and self.background:
            raise InputError(
                f"background={self.background}: {plan.cell.data} holds recordings with their own background"
            )
        if plan.cell.target != "gesture":
            raise InputError(f"target={plan.cell.target}: bench watch names gestures; leave it out")
        for fold in plan.folds:
            if len(set(corpus.subjects[fold.train])) < 2:
                raise InputError(
                    f"protocol={name}: fold {fold.name} trains on one subject; bench watch learns its post-processing "
                    "by leaving training subjects out and needs two"
                )
        self.recordings(corpus)

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit, learn the post-processing on recordings of training subjects, watch those of the test subjects."""
        estimator, train = cell.estimator(), corpus[fold.train]
        with computing(threads):
            metrics = fitted(estimator, train)
            learned, settings = watcher.learned(estimator, self.recordings(train), self.false_alarms)
            test = self.recordings(corpus[fold.test])
            reports = learned.reports(test.corpus)
            effects = batch_effects(estimator, corpus, fold.test, most=SOME)
            curve, shown = _curve(learned, test)
        subjects = test.subjects.astype(str)
        frames = pd.DataFrame({"recording": np.arange(len(test)), "end": test.corpus.lengths})
        table = pd.concat(
            [
                part.assign(kind=kind, subject=subjects[part["recording"]])
                for kind, part in (
                    ("recording", frames),
                    ("touch", test.events),
                    ("report", reports),
                    ("curve", curve),
                    ("probability", shown),
                )
            ],
            ignore_index=True,
        )
        numbers = {name: float for name in ("start", "end", "reported", "confidence")}
        with computing(1):
            spent = _decision_ms(learned, test)
        metrics |= footprint(estimator, corpus)
        metrics["flash_bytes"] += 4 * learned.detector.numbers  # in C it is stored beside the system
        chosen: dict[str, object] = {"bias": learned.bias, "tail": learned.tail, "strong": learned.strong}
        chosen["refused"] = learned.detector.limit_
        return FoldResult(
            fold.name,
            table.assign(fold=fold.name).astype(numbers),
            metrics,
            spent,
            spent,
            chosen=chosen,
            trials=settings,
            batch_effects=effects,
        )

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Scores and costs of one fold."""
        touches, reports, background_s = scored(result.table, rate_hz)
        return costs([result]) | _known(summary(touches, reports, sum(background_s.values())))

    def findings(
        self, plan: Plan, tags: dict[str, str], results: list[FoldResult]
    ) -> Findings[dict[str, pd.DataFrame]]:
        """Scores of all touches, with intervals over subjects; tables of touches, reports, subjects and the curve."""
        rate_hz, table = plan.corpus.rate_hz, table_of(results)
        touches, reports, background_s = scored(table, rate_hz)
        numbers = summary(touches, reports, sum(background_s.values())) | intervals(touches, reports, background_s)
        hours = sum(background_s.values()) / 3600
        curve = table[table["kind"] == "curve"].groupby("confidence")[["start", "end"]].sum().reset_index()
        curve = pd.DataFrame(
            {
                "offset": curve["confidence"],
                "missed": 1 - curve["start"] / max(len(touches), 1),
                "false_alarms_per_hour": curve["end"] / hours if hours else np.nan,
            }
        )
        tables = {
            "predictions.parquet": table,
            "touches.csv": touches,
            "reports.csv": reports,
            "per_subject.csv": per_subject(touches, reports, background_s),
            "curve.csv": curve,
        }
        metrics = _known(numbers | {"background_minutes": 60 * hours}) | costs(results)
        return Findings(metrics, tables, analysis=tables)

    def row(self, metrics: dict[str, float]) -> dict[str, str]:
        """Touches found and named, false alarms, latency."""

        def number(name: str, digits: int = 2, scale: float = 1) -> str:
            return f"{scale * metrics[name]:.{digits}f}" if name in metrics else "-"

        def percent(name: str) -> str:
            return number(name, 1, 100)

        def between(name: str, digits: int, scale: float = 1) -> str:
            low, high = (number(f"{name}_{side}", digits, scale) for side in ("low", "high"))
            return "" if "-" in (low, high) else f" [{low}, {high}]"

        return {
            "touches": number("touches", 0),
            "found": percent("touches_found"),
            "first": percent("first_correct"),
            "end": percent("end_correct") + between("end_correct", 1, 100),
            "alarms/h": number("false_alarms_per_hour", 1) + between("false_alarms_per_hour", 1),
            "latency s": number("latency_s_p50"),
            "90 % s": number("latency_s_p90"),
            "per touch": number("fragments"),
        }


def scored(table: pd.DataFrame, rate_hz: float) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, float]]:
    """Touches and reports of all folds, matched, and seconds of background of each subject.

    Args:
        table: tables of the folds of a run.
        rate_hz: frames per second.
    """
    background: dict[str, float] = {}
    touches, reports = [], []
    kinds = {"recording": np.int64, "start": np.int64, "end": np.int64}
    for _, part in table.groupby("fold", sort=False):
        of = {kind: part[part["kind"] == kind] for kind in ("recording", "touch", "report")}
        truth = of["touch"][["recording", "start", "end", "gesture", "subject", "fold"]].astype(kinds)
        said = of["report"][["recording", "reported", "end", "first", "label", "confidence", "subject", "fold"]]
        said = said.astype({"recording": np.int64, "reported": np.int64, "end": np.int64})
        matches = matched(truth, said, rate_hz)
        touches.append(matches[0])
        reports.append(matches[1])
        touched = (truth["end"] - truth["start"]).groupby(truth["subject"]).sum()
        for subject, frames in of["recording"].groupby("subject")["end"].sum().items():
            background[str(subject)] = background.get(str(subject), 0.0) + (frames - touched.get(subject, 0)) / rate_hz
    return pd.concat(touches, ignore_index=True), pd.concat(reports, ignore_index=True), background


def _known(numbers: dict[str, float]) -> dict[str, float]:
    """The numbers that are defined."""
    return {name: float(value) for name, value in numbers.items() if value == value}


def _curve(learned: watcher.Watcher, test: Recordings) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Touches found and false alarms by offset of the bias, and the probability of touch in the first two minutes."""
    clock, rate_hz = learned.clock, test.corpus.rate_hz
    odds = learned.log_odds(test.corpus)
    biases = (OFFSETS + learned.bias).astype(np.float32)
    settings = watcher.bias_table(test, odds, clock, biases, (learned.strong,))
    found = (settings["found"] * len(test.events)).round()
    curve = pd.DataFrame({"recording": 0, "confidence": OFFSETS, "start": found, "end": settings["alarms"]})
    probability = watcher.touched(odds[0] + np.float32(learned.bias), clock, rate_hz)
    times = clock.detect + clock.hop * np.arange(len(probability))
    shown = pd.DataFrame({"recording": 0, "reported": times, "confidence": probability})
    return curve, shown[shown["reported"] <= SHOWN_S * rate_hz]


def _decision_ms(learned: watcher.Watcher, test: Recordings) -> list[float]:
    """Milliseconds of some decisions on one thread: the detector's window, and the recogniser's."""
    clock, recording = learned.clock, test.corpus[[0]].detached()
    inner = watcher.behind(learned.system)[1]
    ends = np.linspace(max(clock.name, clock.detect), recording.lengths[0], TIMED_CAPTURES + 3).astype(int)
    spent = []
    for end in ends:
        window = contract.blinded(learned.system, watcher.cut(recording, np.array([end]), clock.detect))
        detect = milliseconds(watcher.TouchFeatures().transform, window)[0]
        name = watcher.cut(recording, np.array([end]), clock.name)
        spent.append(detect + milliseconds(contract.probabilities, inner, name)[0])
    return spent[3:]
