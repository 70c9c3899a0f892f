"""Events in an endless stream: a detector finds a touch (`bench.endless.detector`), a recogniser names it.

Decisions fall at every hop of about a tenth of a second. An event begins where the probability of touch rises above
0.95 and ends where it falls below 0.1. The recogniser (any system of touchbench) names the event from windows that lie
within it; the first of them is complete about 0.9 s after the onset.

Everything is causal and has a fixed memory, so that `bench export` can write the same as C.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.recordings import Recordings
from bench.endless.detector import (
    BEGIN,
    END,
    REFUSED,
    UNUSUAL,
    WEIGHT,
    Clock,
    Decisions,
    Detector,
    cut,
    seen_windows,
    touched,
    updated,
    windows_of,
)
from bench.endless.detectors.base import UNKNOWN, Event, InC, Point
from bench.endless.recent import Recent, refused_frames
from bench.features.touch import TouchFeatures
from bench.models.recipe import behind, taken
from bench.outcomes.events import FALSE_ALARM, report_table, touches_of

ON, OFF = float(np.float32(0.95)), float(np.float32(0.1))  # as single precision has them
PROBABLE = 0.5
BIASES = np.arange(-10, 4.25, 0.25, dtype=np.float32)  # one of them is learned
OFFSETS = np.arange(-4, 4.5, 0.5)  # from the learned bias, for the curve


class Rules:
    """When an event begins, is reported and ends: all that the detector alone decides, one decision after another.

    An event begins where touch is detected (a probability above `ON`), and counts from the moment at which touch became
    more probable than not. It is over when the probability has been below `OFF` and not above `ON` again within
    ``clock.hold`` frames. It is reported ``clock.wait`` frames after its first window is complete; a touch that is too
    short for a window if its log-odds reach ``strong``, from the window that is complete at its end.

    Args:
        clock: timing of the windows.
        strong: log-odds from which on short touches are reported.

    Attributes:
        reported: frames seen at the report of the event, 0 before it.
        low: frames seen when the probability fell below `OFF`, 0 while the touch lasts.
        over: True if the event is over with this decision.
    """

    def __init__(self, clock: Clock, strong: float) -> None:
        self.clock, self.strong = clock, strong
        self.before, self.peak, self.rise = 0.0, 0.0, 0
        self.complete = self.first = self.reported = self.low = 0
        self.begun = self.over = False

    def step(self, seen: int, touch: float, log_odds: float) -> bool:
        """Take a decision of the detector; True if the recogniser's window is wanted.

        Args:
            seen: frames so far.
            touch: probability of touch (`bench.endless.detector.touched`).
            log_odds: result of the detector, without the bias.
        """
        if self.over:
            self.begun = self.over = False
        if touch > PROBABLE >= self.before:
            self.rise, self.peak = seen, log_odds
        elif log_odds > self.peak:
            self.peak = log_odds
        self.before = touch
        if not self.begun:
            if touch <= ON:
                return False
            self.begun, self.first, self.reported, self.low = True, 0, 0, 0
            self.complete = max(self.clock.up(self.rise + self.clock.name), seen)
        elif touch < OFF:
            self.low = self.low or seen
        elif touch > ON:
            self.low = 0
        self.over = bool(self.low) and seen > self.low + self.clock.hold
        short = self.low == seen >= self.clock.name and not self.first and self.peak >= self.strong
        wanted = not self.over and (short or seen >= self.complete)
        if wanted and not self.first:
            self.first = seen
        if not self.reported and self.first and self.first <= (self.low or seen):
            self.reported = seen if self.over or seen >= self.first + self.clock.wait else 0
        return wanted


def events_of(
    rules: Rules, times: np.ndarray, touch: np.ndarray, log_odds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Run new rules over one recording.

    Args:
        rules: rules that have not seen a decision.
        times: frames seen at each decision, int64 [decisions].
        touch: probability of touch, float32 [decisions].
        log_odds: result of the detector, without the bias, float32 [decisions].

    Returns:
        Frames seen at the report and at the end of each event that is reported, int64 [events, 2], and at which
        decisions the recogniser's window is wanted, bool [decisions].
    """
    events, wanted = [], np.zeros(len(times), bool)
    for i, (seen, now, odds) in enumerate(zip(times.tolist(), touch.tolist(), log_odds.tolist(), strict=True)):
        wanted[i] = rules.step(seen, now, odds)
        if rules.over and rules.reported:
            events.append((rules.reported, rules.low))
    if rules.begun and not rules.over and rules.reported:  # the recording ends before the touch does
        events.append((rules.reported, rules.low or int(times[-1])))
    return np.array(events, dtype=np.int64).reshape(-1, 2), wanted


def lasting(touch: np.ndarray) -> np.ndarray:
    """Decisions in a row, so far, in which touch was probable, int64 [decisions].

    Args:
        touch: probability of touch at each decision of one recording.
    """
    decisions = np.arange(1, len(touch) + 1)
    return decisions - np.maximum.accumulate(np.where(touch > PROBABLE, 0, decisions))


class Tracker:
    """The events of a stream with their names, one decision after another; memory does not grow.

    A name is the gesture with the highest mean probability over windows of the event: those until its report, later
    those that end before the touch does, as far as training has taught how late an end is noticed.

    Args:
        watcher: a watcher that was learned.

    Attributes:
        event: the event that goes on, if it is reported.
    """

    def __init__(self, watcher: Watcher) -> None:
        self.watcher, self.rules = watcher, Rules(watcher.clock, watcher.strong)
        self.event: Event | None = None
        self._forget()

    def _forget(self) -> None:
        self.waiting: deque[tuple[int, np.ndarray]] = deque()  # windows that are not in the sum yet
        self.total, self.count = np.zeros(len(self.watcher.names)), 0

    def step(self, seen: int, touch: float, log_odds: float) -> bool:
        """Take a decision of the detector; True if the recogniser's window is wanted (`Rules.step`)."""
        if self.rules.over:
            self.event = None
            self._forget()
        return self.rules.step(seen, touch, log_odds)

    def name(self, seen: int, proba: np.ndarray) -> None:
        """Take the probabilities of the gestures in the recogniser's window."""
        self.waiting.append((seen, proba))

    def news(self, seen: int) -> Event | None:
        """The event that this decision reports, renames or ends; None without news."""
        before, rules = self.event, self.rules
        if not rules.begun or not rules.reported:
            return None
        limit = rules.low or seen
        if before is not None:
            limit -= self.watcher.tail
        while self.waiting and self.waiting[0][0] <= limit:
            self.total += self.waiting.popleft()[1]
            self.count += 1
        confidence = float(self.total.max() / self.count)
        known = confidence > 0 and confidence >= self.watcher.reject  # 0 where the system abstains
        label = str(self.watcher.names[self.total.argmax()]) if known else UNKNOWN
        if before is None:
            self.event = Event(rules.reported, label, label, confidence)
        else:
            self.event = replace(before, label=label, confidence=confidence)
        if rules.over:
            return replace(self.event, end=rules.low)
        return self.event if before is None or before.label != label else None


@dataclass(eq=False)
class Watcher:
    """A fitted system with the post-processing that turns its predictions into events.

    Attributes:
        system: fitted to captures.
        background: names of its classes that are no gesture.
        clock: timing of both windows.
        detector: fitted to windows of training recordings.
        bias: added to the detector's log-odds, learned for a number of false alarms per hour.
        tail: frames from the end of a touch until that is detected, learned.
        strong: log-odds from which on a touch that is too short for a window is reported, learned.
        longest: decisions that a touch may last; what lasts longer is refused.
        reject: confidence below which a label is ``unknown``; 0 for never.
        points: bias, false alarms per hour and share of touches found of operating points on training recordings, from
            the strictest to the most eager.
    """

    system: contract.System
    background: tuple[str, ...]
    clock: Clock
    detector: Detector
    bias: float
    tail: int
    strong: float = np.inf
    longest: float = np.inf
    reject: float = 0.0
    points: tuple[Point, ...] = ()

    @property
    def names(self) -> np.ndarray:
        """Gestures that are reported, in the order of the system's classes."""
        classes = np.asarray(self.system.classes_).astype(str)
        return classes[~np.isin(classes, self.background)]

    @property
    def numbers(self) -> int:
        """Count of learned numbers, besides those of the system."""
        return self.detector.numbers

    @property
    def chosen(self) -> dict[str, object]:
        """What training has chosen, by name."""
        learned: dict[str, object] = {"detector": "filter", "bias": self.bias, "tail": self.tail, "strong": self.strong}
        return learned | {"refused": self.detector.limit_, "reject": self.reject}

    @property
    def soonest(self) -> int:
        """Frames from the start of a touch to its report, at least."""
        return self.clock.name + self.clock.wait

    def stream(self, grid: tuple[int, int], rate_hz: float, full_scale: float) -> LiveStream:
        """The same on frames that come one by one; arguments of `LiveStream`."""
        return LiveStream(self, grid, rate_hz, full_scale)

    def at(self, point: int) -> Watcher:
        """The same at another of its ``points``."""
        return replace(self, bias=self.points[point][0])

    def in_c(self, classes: list[str], rate_hz: float) -> InC:
        """What its C needs; arguments of `bench.endless.detectors.base.Watches`."""
        clock, learnt = self.clock, self.detector
        features, hop_s = learnt.classifier_.n_features_in_, np.float32(clock.hop / rate_hz)
        constants = (
            (
                "Frames from a decision to the next, of the windows of detector and recogniser; hops of the latter.",
                {"WATCH_HOP": clock.hop, "DETECT": clock.detect, "NAME": clock.name, "PARTS": clock.name // clock.hop},
            ),
            (
                "Frames from the first name to the report, from the end to its report, and how late an end is noticed; "
                "names that wait.",
                {
                    "WAIT": clock.wait,
                    "HOLD": clock.hold,
                    "TAIL": self.tail,
                    "PENDING": -(-(self.tail + clock.hold) // clock.hop) + 1,
                },
            ),
            (
                "The detector's classes, and how many of its features may lie beyond so many SDs; learned.",
                {
                    "DETECTED": len(learnt.classifier_.classes_),
                    "SOUND": learnt.sound_,
                    "QUIET": learnt.quiet_,
                    "UNUSUAL": UNUSUAL,
                    "MOST_UNUSUAL": max(n for n in range(features + 1) if n / features <= learnt.limit_),
                    "REFUSED": REFUSED,
                },
            ),
            (
                "The filter of its log-odds, and of events; learned.",
                {
                    "ODDS_WEIGHT": WEIGHT * clock.hop / clock.detect,
                    "BEGIN": float(np.float32(BEGIN) * hop_s),
                    "STAY": float(1 - np.float32(END) * hop_s),
                    "STRONG": float(min(self.strong, 1e30)),
                    "LASTING": int(min(self.longest, 1e9)),
                    "ON": ON,
                    "OFF": OFF,
                    "REJECT": float(self.reject),
                },
            ),
        )
        state = (
            "part_t parts[{PARTS} > {HELD} ? {PARTS} - {HELD} : 1];  /* hops of the last window, others lie in now */",
            "int part, within, filled, unchanged;  /* last part, frames in it, parts, frames since a change */",
            "float touched, peak;  /* probability of touch at the last hop, largest log-odds since */",
            "int begun, falling, over, is_reported, label;  /* of the event that goes on */",
            "int lasts;  /* hops in a row in which touch is probable */",
            "uint32_t rise, crossed, low, limit, first, reported;  /* frames; all of them may wrap */",
            "uint32_t named, joined;  /* windows of the event, and of them those in the mean */",
            "uint32_t ends[{PENDING}];  /* of the last windows */",
            "float waiting[{PENDING}][{CLASSES}], mean[{CLASSES}];  /* probabilities of them, and mean */",
        )
        return InC(
            Path(__file__).with_suffix(".c").read_text(encoding="utf-8"),
            state,
            constants,
            clock.name,
            clock.hop,
            self.bias,
            {"gesture": (~np.isin(classes, self.background)).astype(np.int8)},
            {"detect": learnt.classifier_},
            "w->begun = touched; w->crossed = w->falling = 0; w->touched = touched ? w->touched : 0;",
        )

    def adapted(self, system: contract.System, captures: Corpus, y: np.ndarray | None) -> Watcher:
        """The same with a system that was adapted to a person."""
        return replace(self, system=system)

    def reports(self, recordings: Corpus, evidence: list[Decisions] | None = None) -> pd.DataFrame:
        """Events in recordings, each as if its frames came one by one.

        Args:
            recordings: whole recordings.
            evidence: result of `evidence` for them; computed if not given.

        Returns:
            A row per event: ``recording``, ``reported`` and ``end`` (frames seen when it was first reported and when
            it was over), ``first`` and ``label`` (its gesture then), ``confidence`` (mean probability of ``label``).
        """
        inner = behind(self.system)[1]
        seen = self.prepared(recordings)
        rows: list[tuple] = []
        for i in range(len(seen)):
            recording = seen[[i]]
            odds = (self._decisions(recording) if evidence is None else evidence[i]).odds
            touch = touched(odds + np.float32(self.bias), self.clock, seen.rate_hz)
            times = self.clock.detect + self.clock.hop * np.arange(len(touch))
            _, wanted = events_of(Rules(self.clock, self.strong), times, touch, odds)
            windows = cut(recording, times[wanted], self.clock.name)
            named = iter(self.probabilities(inner, windows) if len(windows) else [])
            tracker = Tracker(self)
            for time, now, score in zip(times.tolist(), touch.tolist(), odds.tolist(), strict=True):
                if tracker.step(time, now, score):
                    tracker.name(time, next(named))
                event = tracker.news(time)
                if event is not None and event.end is not None:
                    rows.append((i, event.reported, event.end, event.first, event.label, event.confidence))
            if (event := tracker.event) is not None and not tracker.rules.over:  # the recording ends before the touch
                end = tracker.rules.low or int(times[-1])
                rows.append((i, event.reported, end, event.first, event.label, event.confidence))
        return report_table(rows)

    def renamed(self, make_system: Callable[[], contract.System], captures: Corpus, recordings: Recordings) -> Watcher:
        """As `bench.endless.detectors.base.Watches`."""
        return replace(self, system=make_system().fit(captures, captures.gestures), reject=0.0)

    def prepared(self, recordings: Corpus) -> Corpus:
        """Recordings without their labels, after the steps that are done frame by frame."""
        return taken(contract.blinded(self.system, recordings), behind(self.system)[0])[0]

    def evidence(self, recordings: Corpus) -> list[Decisions]:
        """The detector's decisions on each recording, without the bias."""
        seen = self.prepared(recordings)
        return [self._decisions(seen[[i]]) for i in range(len(seen))]

    def refused(self, recordings: Corpus, evidence: list[Decisions]) -> np.ndarray:
        """Frames of each recording that are saturated, or whose last decision refused its window or lasts too long."""
        refused = [
            each.refused | (lasting(self._touched(each, recordings.rate_hz)) > self.longest) for each in evidence
        ]
        return refused_frames(recordings, refused, self.clock.detect, self.clock.hop)

    def _touched(self, evidence: Decisions, rate_hz: float) -> np.ndarray:
        return touched(evidence.odds + np.float32(self.bias), self.clock, rate_hz)

    def _decisions(self, recording: Corpus) -> Decisions:
        return self.detector.decisions(*windows_of(recording, self.clock))

    def sweep(self, recordings: Recordings, evidence: list[Decisions]) -> pd.DataFrame:
        """Touches found, false alarms and reports by offset of the bias."""
        odds, biases = [each.odds for each in evidence], (OFFSETS + self.bias).astype(np.float32)
        settings = bias_table(recordings, odds, self.clock, biases, (self.strong,))
        hits = (settings["found"] * len(recordings.events)).round()
        return pd.DataFrame({"offset": OFFSETS, "hits": hits, **settings[["alarms", "reports"]]})

    def probability(self, evidence: Decisions, rate_hz: float) -> pd.DataFrame:
        """The probability of touch in one recording."""
        probability = self._touched(evidence, rate_hz)
        times = self.clock.detect + self.clock.hop * np.arange(len(probability))
        return pd.DataFrame({"reported": times, "confidence": probability})

    def decide(self, recording: Corpus, end: int) -> None:
        """Do the work of one decision after so many frames: the detector's window, and the recogniser's."""
        end = max(end, self.clock.name, self.clock.detect)
        TouchFeatures().transform(cut(recording, np.array([end]), self.clock.detect))
        contract.probabilities(behind(self.system)[1], cut(recording, np.array([end]), self.clock.name))

    def probabilities(self, inner: contract.System, windows: Corpus) -> np.ndarray:
        """Probabilities of the gestures, without background, float32 [windows, gestures]."""
        gestures = ~np.isin(np.asarray(inner.classes_).astype(str), self.background)
        proba = contract.probabilities(inner, windows)[:, gestures]
        return (proba / np.maximum(proba.sum(axis=1, keepdims=True), 1e-9)).astype(np.float32)


def bias_table(
    recordings: Recordings,
    odds: list[np.ndarray],
    clock: Clock,
    biases: np.ndarray = BIASES,
    strong: tuple[float, ...] = (np.inf,),
) -> pd.DataFrame:
    """Count what each bias gives on recordings.

    Args:
        recordings: recordings with their events.
        odds: log-odds of the windows of each recording.
        clock: timing of the windows.
        biases: values to try, float32.
        strong: thresholds for short touches to try, each with each bias.

    Returns:
        Columns ``bias``, ``strong``, ``tail`` (frames), ``alarms``, ``hours`` (of background), ``found`` (share),
        ``reports`` outside of doubtful stretches.
    """
    rate_hz = recordings.corpus.rate_hz
    hours = int(recordings.background_frames().sum()) / rate_hz / 3600
    times: dict[tuple[float, float], list[np.ndarray]] = {(bias, level): [] for bias in biases for level in strong}
    for i, series in enumerate(odds):
        seen = clock.detect + clock.hop * np.arange(len(series))
        for bias, touch in zip(biases, touched(series[:, None] + biases, clock, rate_hz).T, strict=True):
            for level in strong:
                events, _ = events_of(Rules(clock, level), seen, touch, series)
                times[bias, level].append(np.insert(events, 0, i, axis=1))
    rows = []
    for (bias, level), each in times.items():
        reports = pd.DataFrame(np.concatenate(each), columns=["recording", "reported", "end"])
        touch = touches_of(recordings.events, reports, rate_hz, doubtful=recordings.doubtful)
        hit = touch >= 0
        late = reports["end"].to_numpy()[hit] - recordings.events["end"].to_numpy()[touch[hit]]
        tail = max(int(np.median(late)), 0) if len(late) else 0
        found = len(np.unique(touch[hit])) / max(len(recordings.events), 1)
        alarms = int((touch == FALSE_ALARM).sum())
        rows.append((bias, level, tail, alarms, hours, found, int(hit.sum()) + alarms))
    return pd.DataFrame(rows, columns=["bias", "strong", "tail", "alarms", "hours", "found", "reports"])


class LiveStream:
    """A watcher on frames that come one by one; memory does not grow.

    Args:
        watcher: a watcher that was learned.
        grid: (rows, cols) of the sensor.
        rate_hz: frames per second.
        full_scale: largest value of a channel.
    """

    def __init__(self, watcher: Watcher, grid: tuple[int, int], rate_hz: float, full_scale: float) -> None:
        self.watcher, self.tracker = watcher, Tracker(watcher)
        self.recent = Recent(max(watcher.clock.detect, watcher.clock.name) + 1, grid, rate_hz, full_scale)
        self.touch, self.lasts, self.is_refused = np.zeros((), np.float32), 0, False

    @property
    def status(self) -> str:
        """As of `bench.endless.detectors.base.Stream`."""
        return "saturated" if self.recent.is_saturated else "refused" if self.is_refused else "ok"

    def push(self, frame: np.ndarray) -> list[Event]:
        """Take a frame [rows, cols]; the event that it reports, renames or ends, none without news."""
        self.recent.push(frame)
        clock, seen, rate_hz = self.watcher.clock, self.recent.seen, self.recent.rate_hz
        if seen < clock.detect or (seen - clock.detect) % clock.hop:
            return []
        recording = self.recent.recording(self.watcher.prepared)
        ends = recording.lengths
        (odds,), (refused,) = self.watcher.detector.decisions(*seen_windows(recording, ends, clock.detect))
        self.touch = updated(self.touch, odds + np.float32(self.watcher.bias), clock, rate_hz)
        self.lasts = self.lasts + 1 if self.touch > PROBABLE else 0
        self.is_refused = bool(refused) or self.lasts > self.watcher.longest
        if self.tracker.step(seen, float(self.touch), float(odds)):
            inner = behind(self.watcher.system)[1]
            self.tracker.name(seen, self.watcher.probabilities(inner, cut(recording, ends, clock.name))[0])
        event = self.tracker.news(seen)
        return [] if event is None else [event]
