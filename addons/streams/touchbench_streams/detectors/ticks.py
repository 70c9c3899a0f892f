"""Detectors that decide tick by tick: what they define, how they learn, and how they watch with a recogniser."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.few import INTERVAL
from bench.models.recipe import behind, taken
from bench.models.search.inner_folds import inner_folds
from bench.models.sizes import parameter_count
from touchbench_streams.detectors.base import UNKNOWN, Event, InC, Rules, Signals
from touchbench_streams.detectors.names import LONGEST_S, learned_names, longest_part, probabilities
from touchbench_streams.detectors.spans import GROWTH, Span, Touches, means, spans_of
from touchbench_streams.events import DOUBTFUL, FALSE_ALARM, report_table, touches_of
from touchbench_streams.recent import Recent, saturated
from touchbench_streams.recordings import Recordings

PRICE = 0.001  # share of touches that a false alarm per hour above the target costs; chosen on sittings A to C
REPEATS = 0.2  # share of touches that a report per touch above `SPARE` costs; chosen there, too
FOLDS = "12"  # at most, of training recordings for the choice of the threshold
SPARE = 1.15  # reports per touch that cost nothing


def of_file(path: str) -> str:
    """The C beside a Python file."""
    return Path(path).with_suffix(".c").read_text(encoding="utf-8")


class Detector:
    """A detector of touch before training, and fitted; a tick is a frame of a slow skin, or the mean of several.

    It is a dataclass whose fields are its parameters (``detector.tick=``), and is named in
    `touchbench_streams.detectors.PARTS`, or as ``detector=my.py:Mine``.

    Attributes:
        tick: seconds of a tick; at least one frame.
        levels: thresholds to choose among, from the most eager to the strictest.
        memory: ticks that the evidence of one tick looks back.
        soonest: ticks of a touch before its report, at least.
        latest: the same, at most.
        numbers: count of learned numbers.
        chosen: what training has chosen, by name.
    """

    tick: float = 0.125
    levels: ClassVar[np.ndarray]
    memory: ClassVar[int] = 1
    soonest: ClassVar[int] = 1
    latest: ClassVar[int] = 1
    numbers: ClassVar[int] = 0
    chosen: ClassVar[dict[str, object]] = {}

    def __post_init__(self) -> None:
        """Refuse times and distances that are not above 0."""
        for name, value in vars(self).items():
            if isinstance(value, float) and not 0 < value < np.inf:
                raise InputError(f"detector.{name}={value:g}: give a number above 0")

    def signals(self) -> Signals:
        """Signals of a new stream."""
        raise NotImplementedError

    def fit(self, signals: list[np.ndarray], recordings: Recordings) -> Self:
        """Learn from the signals of recordings whose frames are ticks."""
        raise NotImplementedError

    def hardened(self, others: list[Self], recordings: Recordings, level: float, false_alarms: float) -> Self:
        """The same, fitted, and prepared for a sensor that changes after training; unchanged unless overridden.

        Args:
            others: detectors that were fitted without each recording.
            recordings: training recordings, after the steps that are done frame by frame.
            level: learned threshold.
            false_alarms: accepted false alarms per hour of background.
        """
        return self

    def evidence(self, signals: np.ndarray) -> np.ndarray:
        """What the signals of each tick and those before it say [ticks, ...]."""
        raise NotImplementedError

    def refused(self, evidence: np.ndarray) -> np.ndarray:
        """Whether the sensor is unlike all that it learned from, bool [ticks]; never unless overridden."""
        return np.zeros(len(evidence), bool)

    def rules(self, level: float) -> Rules:
        """Rules of a new stream."""
        raise NotImplementedError

    def signals_of(self, ticks: np.ndarray) -> np.ndarray:
        """Signals of a recording whose frames are ticks [ticks, signals]."""
        signals = self.signals()
        return np.stack([signals.step(frame) for frame in ticks])

    def reported(self, evidence: np.ndarray, levels: np.ndarray) -> list[np.ndarray]:
        """In which ticks of a recording the rules of each level report a touch."""
        return [np.flatnonzero(signs_of(self.rules(float(level)), evidence)[:, 2]) for level in levels]

    def in_c(self) -> InC | None:
        """What the C of a fitted detector needs; None where it has none. Classes do not inherit it.

        It defines ``static sign_t sensed(touch_watch_t *w, const float *tick)``: the sign of a tick, from the readings
        of its frames, a mean. It may work in ``w->now.taxels`` and ``w->now.features``.
        """
        return None

    def held_out(self, signals: list[np.ndarray], ticks: Recordings, folds: str) -> tuple[list[Self], list[np.ndarray]]:
        """The detector that is fitted without each recording, and its evidence of it."""
        detectors, evidence = [self] * len(signals), [np.zeros(0)] * len(signals)
        for train, judged in inner_folds(left_out(ticks), folds):
            fitted = copy(self).fit([signals[i] for i in train], ticks[train])
            for i in judged:
                detectors[i], evidence[i] = fitted, fitted.evidence(signals[i])
        return detectors, evidence

    def learn(
        self,
        make_system: Callable[[], contract.System],
        system: contract.System,
        recordings: Recordings,
        false_alarms: float,
    ) -> tuple[TickWatcher, pd.DataFrame]:
        """Learn from recordings of training subjects, each left out for the choice of the threshold.

        Args:
            make_system: factory of the system, not fitted.
            system: fitted to captures of the same subjects.
            recordings: parted where doubtful stretches were.
            false_alarms: accepted false alarms per hour of background.

        Returns:
            What watches, and a table of the thresholds that were tried (`sweep`).
        """
        seen = replace(recordings, corpus=taken(recordings.corpus, behind(system)[0])[0])
        count = frames_of_tick(self.tick, seen.corpus.rate_hz)
        ticks = ticked(seen, count)
        signals = [self.signals_of(ticks.corpus[i]) for i in range(len(ticks))]
        others, evidence = self.held_out(signals, ticks, FOLDS)
        settings = sweep(others, recordings, evidence, count, self.levels)
        level = float(settings["level"][worth(settings, false_alarms).idxmax()])
        names = learned_names(make_system, recordings)
        fitted = copy(self).fit(signals, ticks).hardened(others, seen, level, false_alarms)
        return TickWatcher(system, names, fitted, level, count, points=points_of(settings, level)), settings


def frames_of_tick(tick: float, rate_hz: float) -> int:
    """Frames of a tick of so many seconds."""
    return max(1, round(tick * rate_hz))


def ticked(recordings: Recordings, count: int) -> Recordings:
    """Recordings whose frames are means of so many frames; a rest at the end is left out."""
    corpus = recordings.corpus
    streams = [means(corpus[i], count) for i in range(len(corpus))]
    ticks = Corpus.from_captures(streams, corpus.captures, corpus.rate_hz / count, full_scale=corpus.full_scale)
    start, end = recordings.events["start"] // count, -(-recordings.events["end"] // count)
    lengths = ticks.lengths[recordings.events["recording"]]
    start = np.minimum(start, lengths - 1)
    events = recordings.events.assign(start=start, end=np.minimum(np.maximum(end, start + 1), lengths))
    return Recordings(ticks, events)


def signs_of(rules: Rules, evidence: np.ndarray) -> np.ndarray:
    """The signs of new rules over one recording, float64 [ticks, 3]."""
    return np.array([rules.step(each) for each in evidence], dtype=np.float64).reshape(-1, 3)


def sweep(
    detectors: Sequence[Detector],
    recordings: Recordings,
    evidence: list[np.ndarray],
    count: int,
    levels: np.ndarray,
) -> pd.DataFrame:
    """Count touches found and alarms for each level of a threshold, over recordings with a fitted detector each.

    Returns:
        Columns ``level``, ``alarms``, ``hours`` (of background), ``found`` (share), ``hits`` and ``reports``
        (counts; of reports, those outside of doubtful stretches).
    """
    rate_hz = recordings.corpus.rate_hz
    hours = int(recordings.background_frames().sum()) / rate_hz / 3600
    reported = [one.reported(series, levels) for one, series in zip(detectors, evidence, strict=True)]
    rows = []
    for k, level in enumerate(levels):
        parts = [pd.DataFrame({"recording": i, "reported": (each[k] + 1) * count}) for i, each in enumerate(reported)]
        reports = pd.concat(parts, ignore_index=True).astype(np.int64)
        touch = touches_of(recordings.events, reports, rate_hz, doubtful=recordings.doubtful)
        hits = len(np.unique(touch[touch >= 0]))
        found = hits / max(len(recordings.events), 1)
        rows.append((level, int((touch == FALSE_ALARM).sum()), hours, found, hits, int((touch != DOUBTFUL).sum())))
    return pd.DataFrame(rows, columns=["level", "alarms", "hours", "found", "hits", "reports"])


def worth(settings: pd.DataFrame, false_alarms: float) -> pd.Series:
    """The share of touches that each level finds, less what alarms above the target and repeated reports cost."""
    hours = settings["hours"].replace(0, np.nan)  # without background, rates are unknown
    excess = (settings["alarms"] / hours - false_alarms).fillna(0).clip(lower=0)
    per_touch = (settings["reports"] - settings["alarms"]) / settings["hits"].clip(lower=1)
    return settings["found"] - PRICE * excess - REPEATS * (per_touch - SPARE).clip(lower=0)


def points_of(settings: pd.DataFrame, learned: float) -> tuple[tuple[float, float, float, float], ...]:
    """Operating points of a sweep: the learned level, and those that find more than all with as few alarms."""
    rows = settings.sort_values(["alarms", "found", "level"], ascending=[True, False, False], kind="stable")
    better = rows[rows["found"] > rows["found"].cummax().shift(fill_value=-1.0)]  # of equal ones the strictest
    kept = settings[settings["level"].isin(better["level"]) | np.isclose(settings["level"], learned)]
    kept = kept.sort_values("level", ascending=False)
    return tuple(tuple(map(float, row)) for row in kept[["level", "alarms", "hours", "found"]].to_numpy())


def left_out(recordings: Recordings) -> np.ndarray:
    """What is left out together for the choice of the threshold: subjects, or single recordings of few subjects.

    A classifier of one subject fewer than few is another one, whose evidence has another scale. Parts of one recording
    stay together (`touchbench_streams.recordings.recorded`).
    """
    subjects = recordings.subjects.astype(str)
    if len(set(subjects)) >= INTERVAL:
        return subjects
    numbers = recordings.corpus.captures.get("recording", pd.Series(np.arange(len(recordings))))
    return pd.factorize(numbers)[0].astype(str)


@dataclass(eq=False)
class TickWatcher:
    """A fitted system and a detector that learned from recordings.

    What it makes of a frame depends on this frame and those before it, and its memory does not grow. A touch is named
    when it is reported, from its frames so far, and again as it grows.

    Attributes:
        system: fitted to captures.
        names: the system that names touches, fitted to beginnings and whole touches.
        detector: fitted to training recordings.
        level: threshold, learned for a number of false alarms per hour.
        count: frames of a tick.
        reject: confidence below which a label is ``unknown``; 0 for never.
        points: level, false alarms, hours of background and share of touches found of operating points on training
            recordings, from the strictest to the most eager.
    """

    system: contract.System
    names: contract.System
    detector: Detector
    level: float
    count: int
    reject: float = 0.0
    points: tuple[tuple[float, float, float, float], ...] = ()

    @property
    def numbers(self) -> int:
        """Learned numbers: of the detector, and of the system that names in place of the one fitted to captures."""
        return self.detector.numbers + parameter_count(self.names) - parameter_count(self.system)

    @property
    def chosen(self) -> dict[str, object]:
        """What training has chosen, by name."""
        learned = {"level": self.level, "reject": self.reject} | self.detector.chosen
        return {"detector": type(self.detector).__name__.lower()} | learned

    @property
    def soonest(self) -> int:
        """Frames from the start of a touch to its report, at least."""
        return self.detector.soonest * self.count

    def stream(self, grid: tuple[int, int], rate_hz: float, full_scale: float) -> TickStream:
        """The same on frames that come one by one."""
        return TickStream(self, grid, rate_hz, full_scale)

    def in_c(self, classes: list[str], rate_hz: float) -> InC | None:
        """What its C needs: that of the detector, and of the names."""
        derived = "in_c" not in vars(type(self.detector))  # what derives from a detector with C may compute otherwise
        inner = None if derived else self.detector.in_c()
        if inner is None:
            return None
        longest, named = longest_part(rate_hz, self.count), behind(self.names)[1]
        times = {"TICK": self.count, "PART_TICKS": longest, "NAMED": len(named.classes_)}
        constants = ("Frames of a tick, ticks of a part of a touch, gestures.", times)
        again = {"GROWTH": GROWTH, "REJECT": self.reject}
        naming = ("When a touch is named again, and from which confidence on.", again)
        state = (
            *(("float tick[{TAXELS}];  /* sum of its frames */",) if self.count > 1 else ()),
            "int within, length, first, named, sure, after;  /* frames of the tick; ticks of the part and its names */",
            "int is_reported, label;  /* of the touch that lasts */",
            "uint32_t reported, end;  /* frames; modulo 2^32 */",
            "float due, weight, sum[{NAMED}], last[{NAMED}];  /* next name; of the names so far; of that at the end */",
        )
        return replace(
            inner,
            code=f"{of_file(__file__)}\n{inner.code}",
            state=state + inner.state,
            constants=(constants, naming, *inner.constants),
            frames=(max(longest, self.detector.latest + 1) + 1) * self.count,
            part=max(longest, self.detector.latest + 1) * self.count,
            level=float(self.level),
            arrays=inner.arrays | {"class_of": np.searchsorted(classes, named.classes_.astype(str)).astype(np.int8)},
            deciders={"name": named},
        )

    def changed(
        self, system: contract.System, change: Callable[..., contract.System], captures: Corpus, y: np.ndarray | None
    ) -> TickWatcher:
        """The same with another system, and names changed by these captures; they have not learned background."""
        if y is not None:
            known = np.isin(y, self.names.classes_)
            captures, y = captures[known], y[known]
        return replace(self, system=system, names=change(self.names, captures, y))

    def prepared(self, recordings: Corpus) -> Corpus:
        """Recordings without their labels, after the steps that are done frame by frame."""
        return taken(contract.blinded(self.system, recordings), behind(self.system)[0])[0]

    def evidence(self, recordings: Corpus) -> list[np.ndarray]:
        """The evidence of each recording, tick by tick."""
        seen = self.prepared(recordings)
        series = (self.detector.signals_of(means(seen[i], self.count)) for i in range(len(seen)))
        return [self.detector.evidence(each) for each in series]

    def refused(self, recordings: Corpus, evidence: list[np.ndarray]) -> np.ndarray:
        """Frames of each recording that are saturated, or whose last tick is unlike all training; int64."""
        counts = []
        for stream, each in zip(recordings, evidence, strict=True):
            tick = np.arange(1, len(stream) + 1) // self.count - 1  # the last whole one
            silent = (tick >= 0) & self.detector.refused(each)[tick]
            counts.append((silent | saturated(stream, recordings.full_scale)).sum())
        return np.array(counts, dtype=np.int64)

    def sweep(self, recordings: Recordings, evidence: list[np.ndarray]) -> pd.DataFrame:
        """Touches found, false alarms and reports of all levels, by their place relative to the learned one."""
        levels = self.detector.levels
        settings = sweep([self.detector] * len(evidence), recordings, evidence, self.count, levels)
        learned = int(np.abs(levels - self.level).argmin())
        return settings[["hits", "alarms", "reports"]].assign(offset=np.arange(len(settings)) - float(learned))

    def probability(self, evidence: np.ndarray) -> pd.DataFrame:
        """How sure the rules are of touch in one recording."""
        signs = signs_of(self.detector.rules(self.level), evidence)
        return pd.DataFrame({"reported": self.count * np.arange(1, len(signs) + 1), "confidence": signs[:, 0]})

    def decide(self, recording: Corpus, end: int) -> None:
        """Do the work of one decision after so many frames: signals and evidence of a tick, and a name."""
        frames = recording[0][max(0, end - self.count) : max(end, self.count)]
        ring = np.repeat(self.detector.signals().step(means(frames, self.count)[0])[None], self.detector.memory, 0)
        self.detector.evidence(ring)
        begin = max(0, end - round(LONGEST_S * recording.rate_hz))
        probabilities(self.names, recording, np.array([begin]), np.array([end]))

    def reports(self, recordings: Corpus, evidence: list[np.ndarray] | None = None) -> pd.DataFrame:
        """Touches in recordings, each as if its frames came one by one."""
        seen = self.prepared(recordings)
        evidence = self.evidence(recordings) if evidence is None else evidence
        rows: list[tuple] = []
        for i, series in enumerate(evidence):
            signs = signs_of(self.detector.rules(self.level), series)
            touches = spans_of(signs, self.count, longest_part(seen.rate_hz, self.count))
            if not touches:
                continue
            asked = [[*touch.named, *filter(None, [touch.last])] for touch in touches]
            begin, end = np.array([span for each in asked for span in each], dtype=np.int64).T
            named = probabilities(self.names, seen[[i]], begin, end)
            parts = np.cumsum([len(each) for each in asked])[:-1]
            for touch, each, frames in zip(touches, np.split(named, parts), np.split(end - begin, parts), strict=True):
                mean = frames @ each / frames.sum()  # longer spans count more
                (first, _), (label, sure) = self.label(each[0]), self.label(mean)
                rows.append((i, touch.reported, touch.end, first, label, sure))
        return report_table(rows)

    def renamed(
        self, make_system: Callable[[], contract.System], captures: Corpus, recordings: Recordings
    ) -> TickWatcher:
        """The same with names learned from other captures and their recordings; it rejects nothing."""
        system = make_system().fit(captures, captures.gestures)
        return replace(self, system=system, names=learned_names(make_system, recordings), reject=0.0)

    def label(self, proba: np.ndarray) -> tuple[str, float]:
        """The gesture that is named, and how sure it is."""
        sure, gestures = float(proba.max()), np.asarray(self.names.classes_).astype(str)
        return (str(gestures[proba.argmax()]) if sure > 0 and sure >= self.reject else UNKNOWN), sure


class TickStream:
    """A watcher on frames that come one by one; memory does not grow."""

    def __init__(self, watcher: TickWatcher, grid: tuple[int, int], rate_hz: float, full_scale: float) -> None:
        longest = longest_part(rate_hz, watcher.count)
        self.watcher, self.touches = watcher, Touches(watcher.count, longest)
        self.signals, self.rules = watcher.detector.signals(), watcher.detector.rules(watcher.level)
        self.ring: deque[np.ndarray] = deque(maxlen=watcher.detector.memory)
        kept = (max(longest, watcher.detector.latest + 1) + 1) * watcher.count
        self.recent = Recent(kept, grid, rate_hz, full_scale)
        self.is_refused = False
        self._forget()

    def _forget(self) -> None:
        self.event: Event | None = None
        self.names, self.sum, self.weight = 0, np.zeros(len(self.watcher.names.classes_)), 0.0  # so far
        self.last: tuple[int, int] | None = None
        self.after = self.sum, 0.0  # what the name at the end adds, if the touch ends before it is named again

    @property
    def status(self) -> str:
        """``ok``, ``saturated`` (many taxels are at full scale), or ``refused`` (frames are unlike all training)."""
        return "saturated" if self.recent.is_saturated else "refused" if self.is_refused else "ok"

    def push(self, frame: np.ndarray) -> list[Event]:
        """Take a frame [rows, cols]; the events that it ends, reports or renames, in this order."""
        self.recent.push(frame)
        if self.recent.seen % self.watcher.count:
            return []
        recording = self.recent.recording(self.watcher.prepared)
        tick = means(recording[0][-self.watcher.count :], self.watcher.count)[0]
        self.ring.append(self.signals.step(tick))
        evidence = self.watcher.detector.evidence(np.stack(self.ring))[-1:]
        self.is_refused = bool(self.watcher.detector.refused(evidence)[0])
        sign = self.rules.step(evidence[0])
        ended = self.touches.step(sign)
        news = []
        if ended is not None and self.event is not None:
            self._take(ended, recording)
            label, sure = self.watcher.label((self.sum + self.after[0]) / (self.weight + self.after[1]))
            news.append(replace(self.event, label=label, confidence=sure, end=ended.end))
            self._forget()
        lasting = self.touches.lasting
        if lasting is not None:
            self._take(lasting, recording)
            label, sure = self.watcher.label(self.sum / self.weight)
            before = self.event
            first = label if before is None else before.first
            self.event = Event(lasting.reported, first, label, sure)
            if before is None or before.label != label:
                news.append(self.event)
        return news

    def _take(self, span: Span, recording: Corpus) -> None:
        """Add the names that a touch has got since the last tick."""
        for begin, end in span.named[self.names :]:
            proba, weight = self._name(recording, begin, end)
            self.sum, self.weight = self.sum + proba, self.weight + weight
        self.names = len(span.named)
        if span.last != self.last:
            self.last = span.last
            self.after = (0 * self.sum, 0.0) if span.last is None else self._name(recording, *span.last)

    def _name(self, recording: Corpus, begin: int, end: int) -> tuple[np.ndarray, float]:
        """Probabilities from some frames of the stream, times their weight, and the weight."""
        gone = self.recent.seen - len(self.recent.frames)
        named = probabilities(self.watcher.names, recording, np.array([begin - gone]), np.array([end - gone]))[0]
        return (end - begin) * named, float(end - begin)
