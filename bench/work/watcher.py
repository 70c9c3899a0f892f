"""Events in an endless stream: one stage detects that there is a touch, a second one names it.

Decisions fall at every hop of about a tenth of a second. The detector (`Detector`) sees the last half second; a filter
(`touched`) turns its log-odds into the probability that the sensor is touched now. An event begins where that
probability rises above 0.95 and ends where it falls below 0.1. The recogniser (any system of touchbench) names the
event from windows that lie within it, the first of which is complete about a second after the onset.

Everything is causal and has a fixed memory, so that `bench export` can write the same as C.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bench import contract
from bench.corpora.corpus import Corpus, storage
from bench.corpora.recordings import Recordings
from bench.corpora.steps import SETTLED_S, Scale, Step, Windows
from bench.errors import InputError
from bench.outcomes.events import FALSE_ALARM, report_table, touches_of
from bench.work.broken import FEELING, KINDS, broken
from features.base import constant
from features.base import labels as row_labels
from features.touch import TouchFeatures
from models.classic.lda import Discriminants
from models.recipe import Recipe, taken
from models.search.inner_folds import inner_folds

BACKGROUND = ""  # its class in the detector
BROKEN = " "  # begins the class of each kind of broken sensor in the detector; sorts before all gestures
RARE = 8  # one of so many training windows is also learned as broken sensors show it
UNKNOWN = "unknown"  # label of a gesture that is rejected
HOP_S = 0.1
DETECT_S = 0.45  # of the detector's window
NAME_S = 0.75  # of the recogniser's window; a network has its own
WAIT_S = 0.2  # from the first complete window of an event to its report
REPEATED = 4.0  # windows of one event that the detector sees together, as of `Discriminants`
WEIGHT = 4.0  # of a decision's log-odds, for each hop of a detector's window: overlapping windows repeat each other
BEGIN, END = 0.05, 0.2  # touches that begin, and that end, per second
ON, OFF = 0.95, 0.1
STRONG = (np.inf, 40.0, 30.0, 25.0, 20.0, 16.0, 14.0, 12.0, 10.0)  # log-odds of short touches, of which one is learned
HOLD_S = 0.3  # a touch that begins again so soon goes on
PRICE = 0.01  # share of touches that one false alarm per hour too many is worth, where none too many is impossible
NEARLY = 0.005  # share of touches that is given for a lower bias
BIASES = np.arange(-10, 4.25, 0.25, dtype=np.float32)  # of which one is learned
UNUSUAL = 3.0  # SDs of training windows
MARGIN = 1.5  # how much further from training than any training window a window may be
REFUSED = -4.0  # log-odds of a window that is refused
REJECTED = 0.05  # share of touches with a known gesture that may be labelled unknown


Frames = TypeVar("Frames", int, np.ndarray)


@dataclass(frozen=True)
class Clock:
    """Frames of the windows of a watcher; the two windows are whole numbers of hops.

    Attributes:
        hop: frames from one decision to the next.
        detect: frames of the detector's window.
        name: frames of the recogniser's window.
        wait: frames from the first complete window of an event to its report.
        hold: frames in which a touch that begins again goes on.
    """

    hop: int
    detect: int
    name: int
    wait: int
    hold: int

    @classmethod
    def of(cls, system: contract.System, rate_hz: float) -> Clock:
        """The clock of a system: its own window, or 0.75 s, and the hop nearest to 0.1 s that divides it.

        Args:
            system: fitted or not.
            rate_hz: frames per second.
        """
        name = window_of(system, rate_hz)
        wanted = max(1.0, HOP_S * rate_hz)
        fitting = [hop for hop in range(1, name + 1) if name % hop == 0 and wanted / 2 <= hop <= 2 * wanted]
        hop = min(fitting, key=lambda hop: abs(np.log(hop / wanted))) if fitting else max(1, min(round(wanted), name))
        detect = hop * max(1, round(min(DETECT_S * rate_hz, name) / hop))
        wait, hold = (hop * round(seconds * rate_hz / hop) for seconds in (WAIT_S, HOLD_S))
        return cls(hop, detect, hop * max(1, round(name / hop)), wait, hold)

    def up(self, frames: Frames) -> Frames:
        """Round up to frames at which there is a decision: ``detect`` and any number of hops."""
        return self.detect + -(-(frames - self.detect) // self.hop) * self.hop


def window_of(system: contract.System, rate_hz: float) -> int:
    """Frames of the window that a system names touches from: that of a network, otherwise 0.75 s."""
    return contract.window(system, rate_hz) or max(1, round(NAME_S * rate_hz))


def behind(system: contract.System) -> tuple[list[Step], contract.System]:
    """The causal steps that a whole recording goes through, and the system behind them, which is given windows."""
    recipe = getattr(system, "whole_", system)
    if not isinstance(recipe, Recipe):
        return [], system
    return [step for step in recipe.steps() if not isinstance(step, Windows)], recipe.system_


@dataclass(eq=False)
class Detector:
    """Linear discriminants on `features.touch` that tell touch from background, whatever the gesture.

    Background from broken sensors (`bench.work.broken`) has one class for each kind. A window is refused, and is no
    touch, if more of its features lie far from training than in any real training window, or if no taxel changes in it:
    the sensor is tared, saturated or disconnected.

    Args:
        detect: frames of a window.

    Attributes:
        classifier_: fitted to windows of each gesture and of background.
        quiet_: number of its classes that are no gesture; they are the first.
        mean_, sd_: statistics of the features of training windows, float32 [features].
        limit_: share of features beyond 3 SDs above which a window is refused.
    """

    detect: int

    def fit(self, table: np.ndarray, labels: np.ndarray, events: np.ndarray) -> Detector:
        """Learn from windows.

        Args:
            table: features [windows, n_features], float32.
            labels: str [windows]: gesture, `BACKGROUND`, or `BROKEN` followed by the kind of a broken sensor.
            events: number of the event, or the gap between events, that each window lies in.
        """
        rows = pd.DataFrame(table, index=row_labels(events, np.zeros(len(events), np.int64)))
        self.classifier_ = Discriminants(windows=REPEATED).fit(rows, labels)
        real = ~np.char.startswith(labels, BROKEN)
        self.quiet_ = len(set(labels[~real]) | {BACKGROUND})
        self.mean_, self.sd_ = table.mean(axis=0), table.std(axis=0)
        self.sd_[constant(table) | (self.sd_ == 0)] = np.inf
        self.limit_ = MARGIN * float(self.unusual(table[real]).max())
        return self

    def log_odds(self, table: np.ndarray, still: np.ndarray) -> np.ndarray:
        """Log-odds of touch of each window, float32; `REFUSED` for one that is refused.

        Args:
            table: features [windows, n_features], float32.
            still: True if no taxel changes in a window, bool [windows].
        """
        scores = self.classifier_.decision_function(table)
        odds = logsumexp(scores[:, self.quiet_ :], axis=1) - logsumexp(scores[:, : self.quiet_], axis=1)
        return np.where(still | (self.unusual(table) > self.limit_), REFUSED, odds).astype(np.float32)

    @property
    def numbers(self) -> int:
        """Count of learned numbers."""
        return self.classifier_.coef_.size + self.classifier_.intercept_.size + self.mean_.size + self.sd_.size

    def unusual(self, table: np.ndarray) -> np.ndarray:
        """Share of the features of each window that lie beyond 3 SDs of training [windows]."""
        return (~(np.abs(table - self.mean_) <= np.float32(UNUSUAL) * self.sd_)).mean(axis=1)


def windows_of(recording: Corpus, clock: Clock) -> tuple[np.ndarray, np.ndarray]:
    """What a detector sees of one recording: features of its windows, and whether no taxel changes in each.

    Window i is complete after ``clock.detect + i * clock.hop`` frames.

    Returns:
        float32 [windows, n_features] and bool [windows].
    """
    ends = np.arange(clock.detect, int(recording.lengths[0]) + 1, clock.hop)
    return seen_windows(recording, ends, clock.detect)


def seen_windows(recording: Corpus, ends: np.ndarray, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Features of the windows of `cut`, and whether no taxel changes in each; result of `windows_of`."""
    stream = recording[0]
    changes = np.append(0, np.cumsum((stream[1:] != stream[:-1]).any(axis=(1, 2))))
    still = changes[ends - 1] == changes[ends - frames]
    return TouchFeatures().transform(cut(recording, ends, frames)).to_numpy(dtype=np.float32), still


def cut(recording: Corpus, ends: np.ndarray, frames: int) -> Corpus:
    """Windows of one recording that are complete after ``ends`` frames; no frame is copied."""
    windows = recording[np.zeros(len(ends), np.int64)]
    starts = storage(recording)[1][0] + ends - frames
    return windows.changed(starts=starts, lengths=np.full(len(ends), frames), digest="", path=None)


def touched(log_odds: np.ndarray, clock: Clock, rate_hz: float) -> np.ndarray:
    """Probability of touch now, from the log-odds of windows so far: a filter with two states, float32.

    Args:
        log_odds: log-odds of the windows of one recording, in order [windows, ...].
        clock: timing of the windows.
        rate_hz: frames per second.
    """
    q = np.zeros(np.shape(log_odds)[1:], np.float32)
    series = np.empty(np.shape(log_odds), np.float32)
    for i, odds in enumerate(np.asarray(log_odds, np.float32)):
        series[i] = q = updated(q, odds, clock, rate_hz)
    return series


def updated(q: np.ndarray, log_odds: np.ndarray, clock: Clock, rate_hz: float) -> np.ndarray:
    """Probability of touch after one more window, float32; arguments of `touched`, and the probability before."""
    hop_s = np.float32(clock.hop / rate_hz)
    begin, end = np.float32(BEGIN) * hop_s, np.float32(END) * hop_s
    step = np.clip(np.float32(WEIGHT * clock.hop / clock.detect) * log_odds, -10, 10)
    prior = q * (1 - end) + (1 - q) * begin
    odds = prior / (1 - prior) * np.exp(step)
    return odds / (1 + odds)


def spans(probability: np.ndarray, clock: Clock) -> np.ndarray:
    """When the sensor was touched, as the probabilities of one recording show it.

    A touch that is detected again within `HOLD_S` of its end goes on.

    Returns:
        A row per touch, in frames seen: when touch became more probable than not, when it was detected, and when its
        end was detected (the last decision for a touch that goes on), int64 [touches, 3].
    """
    rising = np.flatnonzero((probability > 0.5) & (np.append(np.float32(0), probability[:-1]) <= 0.5))
    high, low = np.flatnonzero(probability > ON), np.flatnonzero(probability < OFF)
    rows: list[list[int]] = []
    now = 0
    while (place := np.searchsorted(high, now)) < len(high):
        begun = high[place]
        after = np.searchsorted(low, begun)
        now = low[after] if after < len(low) else len(probability) - 1
        if rows and begun - rows[-1][2] <= clock.hold // clock.hop + 1:
            rows[-1][2] = now
        else:
            rows.append([rising[np.searchsorted(rising, begun, side="right") - 1], begun, now])
        now += 1
    return clock.detect + clock.hop * np.array(rows, dtype=np.int64).reshape(-1, 3)


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
        reject: confidence below which a label is ``unknown``; 0 for never.
    """

    system: contract.System
    background: tuple[str, ...]
    clock: Clock
    detector: Detector
    bias: float
    tail: int
    strong: float = np.inf
    reject: float = 0.0

    @property
    def names(self) -> np.ndarray:
        """Gestures that are reported, in the order of the system's classes."""
        classes = np.asarray(self.system.classes_).astype(str)
        return classes[~np.isin(classes, self.background)]

    def reports(self, recordings: Corpus) -> pd.DataFrame:
        """Events in recordings, each as if its frames came one by one.

        Returns:
            A row per event: ``recording``, ``reported`` and ``end`` (frames seen when it was first reported and when
            it was over), ``first`` and ``label`` (its gesture then), ``confidence`` (mean probability of ``label``).
        """
        inner = behind(self.system)[1]
        seen = self.prepared(recordings)
        rows: list[tuple] = []
        for i in range(len(seen)):
            recording = seen[[i]]
            odds = self.detector.log_odds(*windows_of(recording, self.clock))
            touch = touched(odds + np.float32(self.bias), self.clock, seen.rate_hz)
            times = self.clock.detect + self.clock.hop * np.arange(len(touch))
            dry = Tracker(self)
            series = [*zip(times.tolist(), touch, odds, strict=True)]
            wanted = np.array([dry.step(*each) for each in series], bool)
            windows = cut(recording, times[wanted], self.clock.name)
            named = iter(self.probabilities(inner, windows) if len(windows) else [])
            tracker = Tracker(self)
            for each in series:
                if tracker.step(*each):
                    tracker.name(each[0], next(named))
                event = tracker.news(each[0])
                if event is not None and event.end is not None:
                    rows.append((i, event.reported, event.end, event.first, event.label, event.confidence))
            if (event := tracker.event) is not None and not tracker.over:  # the recording ends before the touch does
                end = tracker.low or int(times[-1])
                rows.append((i, event.reported, end, event.first, event.label, event.confidence))
        return report_table(rows)

    def prepared(self, recordings: Corpus) -> Corpus:
        """Recordings without their labels, after the steps that are done frame by frame."""
        return taken(contract.blinded(self.system, recordings), behind(self.system)[0])[0]

    def log_odds(self, recordings: Corpus) -> list[np.ndarray]:
        """The detector's log-odds of touch in each recording, without the bias."""
        seen = self.prepared(recordings)
        return [self.detector.log_odds(*windows_of(seen[[i]], self.clock)) for i in range(len(seen))]

    def probabilities(self, inner: contract.System, windows: Corpus) -> np.ndarray:
        """Probabilities of the gestures, without background, float32 [windows, gestures]."""
        gestures = ~np.isin(np.asarray(inner.classes_).astype(str), self.background)
        proba = contract.probabilities(inner, windows)[:, gestures]
        return (proba / np.maximum(proba.sum(axis=1, keepdims=True), 1e-9)).astype(np.float32)


def reports_of(touches: np.ndarray, odds: np.ndarray, clock: Clock, strong: float) -> tuple[np.ndarray, np.ndarray]:
    """When `Tracker` reports touches, from the detector alone.

    Args:
        touches: result of `spans` [touches, 3].
        odds: log-odds of the windows of the recording, without the bias.
        clock: timing of the windows.
        strong: log-odds from which on short touches are reported.

    Returns:
        Frames seen at the report and at the end [touches, 2], and which touches are reported: those with a complete
        window, and short ones.
    """
    complete = np.maximum(clock.up(touches[:, 0] + clock.name), touches[:, 1])
    first, last = ((touches[:, column] - clock.detect) // clock.hop for column in (0, 2))
    short = np.array([odds[a : b + 1].max() >= strong for a, b in zip(first, last, strict=True)], bool)
    reported = np.minimum(np.minimum(complete, touches[:, 2]) + clock.wait, touches[:, 2] + clock.hold + clock.hop)
    short &= touches[:, 2] >= clock.name
    return np.column_stack([reported, touches[:, 2]]), (complete <= touches[:, 2]) | short


@dataclass
class Event:
    """A touch that a `Tracker` reports; times are frames seen.

    Attributes:
        reported: time of the first report.
        first: gesture then.
        label: gesture by now.
        confidence: mean probability of ``label``.
        end: time of the end; None while the touch lasts.
    """

    reported: int
    first: str
    label: str
    confidence: float
    end: int | None = None


class Tracker:
    """Events from what is known at each decision; the exported C follows the same rules.

    Args:
        watcher: a watcher that was learned.
    """

    def __init__(self, watcher: Watcher) -> None:
        self.watcher = watcher
        self.before = np.float32(0)
        self.rise = self.crossed = self.begun = self.low = self.limit = 0
        self.over = self.named = False
        self.peak = np.float32(0)
        self.event: Event | None = None
        self.ends: list[int] = []
        self.proba: list[np.ndarray] = []

    def step(self, seen: int, touch: np.float32, log_odds: np.float32) -> bool:
        """Take what the detector says after so many frames; True if the recogniser's window is wanted (`name`).

        Args:
            seen: frames so far.
            touch: probability of touch (`touched`).
            log_odds: result of the detector, without the bias.
        """
        clock = self.watcher.clock
        if self.over:
            self.begun, self.over, self.event, self.ends, self.proba = 0, False, None, [], []
        if touch > 0.5 >= self.before:
            self.rise, self.peak = seen, log_odds
        self.peak = max(self.peak, log_odds)
        self.before = touch
        if not self.begun:
            if touch > ON:
                self.crossed, self.begun, self.low, self.named = self.rise, seen, 0, False
        elif touch < OFF:
            self.low = self.low or seen
        elif touch > ON:
            self.low = 0
        self.over = bool(self.begun and self.low and seen > self.low + clock.hold)
        if not self.begun or self.over:
            return False
        complete = bool(seen >= max(clock.up(self.crossed + clock.name), self.begun))
        short = bool(self.low == seen >= clock.name and not self.named and self.peak >= self.watcher.strong)
        self.named = self.named or complete or short
        return complete or short

    def name(self, seen: int, proba: np.ndarray) -> None:
        """Take the probabilities of the gestures in the recogniser's window."""
        self.ends.append(seen)
        self.proba.append(proba)

    def news(self, seen: int) -> Event | None:
        """The event that this decision reports, renames or ends; None without news."""
        before, limit = self.event, self.low or seen
        if before is None:
            if self.ends and self.ends[0] <= limit and (self.over or seen >= self.ends[0] + self.watcher.clock.wait):
                self.limit = limit
                label, confidence = self._label(limit)
                self.event = Event(seen, label, label, confidence)
        else:
            label, confidence = self._label(max(limit - self.watcher.tail, self.limit))
            self.event = replace(before, label=label, confidence=confidence)
        if self.event is None:
            return None
        if self.over:
            return replace(self.event, end=self.low)
        return self.event if before is None or before.label != self.event.label else None

    def _label(self, limit: int) -> tuple[str, float]:
        """Gesture, and its mean probability over the windows that are complete after ``limit`` frames."""
        mean = np.mean(self.proba[: bisect_right(self.ends, limit)], axis=0)
        confidence = float(mean.max())
        known = confidence >= self.watcher.reject
        return str(self.watcher.names[mean.argmax()]) if known else UNKNOWN, confidence


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
        self.rate_hz, self.full_scale = rate_hz, full_scale
        self.frames: deque[np.ndarray] = deque(maxlen=max(watcher.clock.detect, watcher.clock.name) + 1)
        self.seen, self.touch = 0, np.zeros((), np.float32)
        self.least, self.most = np.full(grid, np.inf), np.full(grid, -np.inf)  # of frames that were dropped

    def push(self, frame: np.ndarray) -> Event | None:
        """Take a frame [rows, cols]; the event that it reports, renames or ends, None without news."""
        if len(self.frames) == self.frames.maxlen:
            self.least = np.minimum(self.least, self.frames[0])
            self.most = np.maximum(self.most, self.frames[0])
        self.frames.append(frame)
        self.seen += 1
        clock = self.watcher.clock
        if self.seen < clock.detect or (self.seen - clock.detect) % clock.hop:
            return None
        recording = self._recent()
        ends = recording.lengths
        odds = self.watcher.detector.log_odds(*seen_windows(recording, ends, clock.detect))[0]
        self.touch = updated(self.touch, odds + np.float32(self.watcher.bias), clock, self.rate_hz)
        if self.tracker.step(self.seen, np.float32(self.touch), odds):
            inner = behind(self.watcher.system)[1]
            self.tracker.name(self.seen, self.watcher.probabilities(inner, cut(recording, ends, clock.name))[0])
        return self.tracker.news(self.seen)

    def _recent(self) -> Corpus:
        """The frames that are kept, after the steps; older frames count by their smallest and largest values."""
        older = min(self.seen - len(self.frames), max(2, int(np.ceil(SETTLED_S * self.rate_hz))))
        before = [self.least] * (older - 1) + [self.most] * bool(older)
        frames = np.stack([*before, *self.frames])
        table = pd.DataFrame({"subject": [""], "gesture": [""]})
        whole = Corpus.from_captures([frames], table, self.rate_hz, full_scale=self.full_scale)
        seen = self.watcher.prepared(whole)
        return seen.changed(starts=np.array([older]), lengths=np.array([len(self.frames)]))


def learned(system: contract.System, recordings: Recordings, false_alarms: float) -> tuple[Watcher, pd.DataFrame]:
    """A watcher whose detector and post-processing are learned from training recordings.

    Each subject is left out in turn; a detector that is fitted to the others watches the subject's recordings. The bias
    that finds most touches is taken, less `PRICE` for each false alarm per hour above ``false_alarms``, counting one
    more than there were; of biases that find nearly as many (`NEARLY`), the lowest. Then so is the threshold for short
    touches (`STRONG`), of which the highest is taken. The table of `bias_table` comes
    with it.

    Args:
        system: fitted to captures of the same subjects.
        recordings: recordings of training subjects.
        false_alarms: per hour of background, at most.

    Raises:
        InputError: fewer than two subjects.
    """
    steps, _ = behind(system)
    corpus = taken(recordings.corpus, steps)[0]
    clock = Clock.of(system, corpus.rate_hz)
    seen = [windows_of(corpus[[i]], clock) for i in range(len(corpus))]
    whole = storage(recordings.corpus)[0].dtype.kind in "iu" and not any(isinstance(step, Scale) for step in steps)
    tables = [
        joined(
            [
                training_windows(recordings[i], table, clock),
                *broken_windows(recordings[i], corpus[[i]], clock, whole),
            ]
        )
        for i, (table, _) in enumerate(seen)
    ]
    odds: list[np.ndarray] = [np.zeros(0)] * len(seen)
    for train, judged in inner_folds(recordings.subjects.astype(str), "loso"):
        detector = _fitted([tables[i] for i in train], clock)
        for i in judged:
            odds[i] = detector.log_odds(*seen[i])
    settings = bias_table(recordings, odds, clock)
    bias = float(best(settings, false_alarms)["bias"])
    short = bias_table(recordings, odds, clock, np.array([bias], np.float32), STRONG)
    chosen = best(short, false_alarms)
    gestures = set(recordings.events["gesture"])
    background = tuple(sorted(set(np.asarray(system.classes_).astype(str)) - gestures))
    detector = _fitted(tables, clock)
    return Watcher(system, background, clock, detector, bias, int(chosen["tail"]), float(chosen["strong"])), settings


def best(settings: pd.DataFrame, false_alarms: float) -> pd.Series:
    """The first row of `bias_table` that is nearly the best; see `learned`."""
    excess = (settings["alarms"] + 1) / settings["hours"] - false_alarms
    worth = settings["found"] - PRICE * excess.clip(lower=0)
    return settings[worth >= worth.max() - NEARLY].iloc[0]


Windowed = tuple[np.ndarray, np.ndarray, np.ndarray]  # features, labels and events of windows


def training_windows(recording: Recordings, table: np.ndarray, clock: Clock) -> Windowed:
    """Every second window of one recording that lies within one event or one gap: features, label, number of it."""
    chosen, labels, number = _inside(recording, clock)
    return table[chosen], labels, number


def broken_windows(recording: Recordings, seen: Corpus, clock: Clock, whole: bool) -> list[Windowed]:
    """Some windows of one recording as broken sensors show them, a part for each kind of broken sensor.

    Background becomes a class of its own for each kind; touch stays touch, where a broken sensor still feels it.

    Args:
        recording: one recording with its events.
        seen: the same after the steps before the system.
        clock: timing of the windows.
        whole: True if readings after the steps are whole numbers.
    """
    chosen, labels, number = _inside(recording, clock)
    parts = []
    for quiet, kinds in ((True, KINDS), (False, FEELING)):
        some = np.flatnonzero((labels == BACKGROUND) == quiet)[::RARE]
        windows = cut(seen, clock.detect + clock.hop * chosen[some], clock.detect)
        for kind in kinds if len(some) else ():
            frames = broken(windows, kind, whole, f"{recording.subjects[0]}, {'background' if quiet else 'touch'}")
            table = TouchFeatures().transform(frames).to_numpy(dtype=np.float32)
            names = np.full(len(some), BROKEN + kind.__name__) if quiet else labels[some]
            parts.append((table, names, np.arange(len(some)) if quiet else number[some]))
    return parts


def _inside(recording: Recordings, clock: Clock) -> Windowed:
    """Every second window of one recording that lies within one event or one gap: position, label, number of it."""
    ends = np.arange(clock.detect, int(recording.corpus.lengths[0]) + 1, clock.hop)
    starts = recording.events["start"].to_numpy()
    edges = np.unique(np.append(starts, recording.events["end"].to_numpy()))
    number = np.searchsorted(edges, ends - 1, side="right")
    inside = number == np.searchsorted(edges, ends - clock.detect, side="right")
    inside[1::2] = False
    labels = recording.frame_labels()[ends - 1]
    return np.flatnonzero(inside), np.where(labels == "", BACKGROUND, labels)[inside].astype(str), number[inside]


def joined(parts: list[Windowed]) -> Windowed:
    """Windows of several parts together; events of different parts stay apart."""
    firsts = np.cumsum([0, *(number.max(initial=0) + 1 for _, _, number in parts)])
    events = [number + first for (_, _, number), first in zip(parts, firsts[:-1], strict=True)]
    table, labels = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return table, labels, np.concatenate(events)


def _fitted(parts: list[Windowed], clock: Clock) -> Detector:
    """A detector that is fitted to the windows of some recordings."""
    return Detector(clock.detect).fit(*joined(parts))


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
        Columns ``bias``, ``strong``, ``tail`` (frames), ``alarms``, ``hours`` (of background), ``found`` (share).
    """
    rate_hz = recordings.corpus.rate_hz
    hours = int(recordings.background_frames().sum()) / rate_hz / 3600
    times: dict[tuple[float, float], list[np.ndarray]] = {(bias, level): [] for bias in biases for level in strong}
    for i, series in enumerate(odds):
        for bias, column in zip(biases, touched(series[:, None] + biases, clock, rate_hz).T, strict=True):
            touches = spans(column, clock)
            for level in strong:
                reported, kept = reports_of(touches, series, clock, level)
                times[bias, level].append(np.insert(reported[kept], 0, i, axis=1))
    rows = []
    for (bias, level), each in times.items():
        reports = pd.DataFrame(np.concatenate(each), columns=["recording", "reported", "end"])
        touch = touches_of(recordings.events, reports, rate_hz)
        late = (reports["end"].to_numpy() - recordings.events["end"].to_numpy()[touch])[touch != FALSE_ALARM]
        tail = max(int(np.median(late)), 0) if len(late) else 0
        found = len(np.setdiff1d(touch, [FALSE_ALARM])) / max(len(recordings.events), 1)
        rows.append((bias, level, tail, int((touch == FALSE_ALARM).sum()), hours, found))
    return pd.DataFrame(rows, columns=["bias", "strong", "tail", "alarms", "hours", "found"])


def learn_reject(
    make_system: Callable[[], contract.System],
    captures: Corpus,
    recordings: Recordings,
    watcher: Watcher,
    groups: str = "3",
) -> float:
    """The confidence below which a label is ``unknown`` (`Watcher.reject`), learned on training subjects.

    Each group of subjects is left out in turn; a system that is fitted to the captures of the others names the touches
    that the watcher's detector finds in the group's recordings.

    Args:
        make_system: factory of the watcher's system, not fitted.
        captures: training captures, without the gesture that is left out.
        recordings: recordings of training subjects, without that gesture.
        watcher: watcher that was learned on the same captures and recordings.
        groups: number of groups of subjects, or ``loso`` for each subject alone.

    Raises:
        InputError: fewer than two subjects, or no touch is found.
    """
    subjects = recordings.subjects.astype(str)
    found = []
    for _, judged in inner_folds(subjects, groups):
        train = captures[~np.isin(captures.subjects.astype(str), subjects[judged])]
        system = make_system().fit(train, train.gestures)
        held = recordings[judged]
        reports = replace(watcher, system=system, reject=0.0).reports(held.corpus)
        found.append(known_confidence(held.events, reports, held.corpus.rate_hz))
    return reject_threshold(np.concatenate(found))


def known_confidence(touches: pd.DataFrame, reports: pd.DataFrame, rate_hz: float) -> np.ndarray:
    """Confidence of the last label of each touch that was found, float64 [touches found], in order of the touches.

    Args:
        touches: the ``events`` of recordings.
        reports: result of `Watcher.reports`.
        rate_hz: frames per second.
    """
    reports = reports.assign(touch=touches_of(touches, reports, rate_hz))
    ordered = reports[reports["touch"] != FALSE_ALARM].sort_values(["touch", "reported", "end"], kind="stable")
    return ordered.drop_duplicates("touch", keep="last")["confidence"].to_numpy()


def reject_threshold(confidence: np.ndarray, share: float = REJECTED) -> float:
    """Threshold that rejects at most a share of touches with known gestures.

    Args:
        confidence: confidence of the label of each training touch with a known gesture [touches].
        share: share of them that may lie below the threshold.

    Raises:
        InputError: there are no touches.
    """
    if not len(confidence):
        raise InputError("unknown= learns a threshold from training touches, and none was found; leave unknown= out")
    return float(np.quantile(confidence, share, method="lower"))
