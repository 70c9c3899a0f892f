"""Events in an endless stream: one stage detects that there is a touch, a second one names it.

Decisions fall at every hop of about a tenth of a second. The detector (`Detector`) sees the last half second; a filter
(`touched`) turns its log-odds into the probability that the sensor is touched now. An event begins where that
probability rises above 0.95 and ends where it falls below 0.1. The recogniser (any system of touchbench) names the
event from windows that lie within it, the first of which is complete about a second after the onset.

Everything is causal and has a fixed memory, so that `bench export` can write the same as C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bench import contract
from bench.corpora.corpus import Corpus, storage
from bench.corpora.recordings import Recordings
from bench.corpora.steps import Step, Windows
from bench.outcomes.events import FALSE_ALARM, report_table, touches_of
from features.base import constant
from features.base import labels as row_labels
from features.touch import TouchFeatures
from models.classic.lda import Discriminants
from models.recipe import Recipe, taken
from models.search.inner_folds import inner_folds

BACKGROUND = ""  # its class in the detector
UNKNOWN = "unknown"  # label of a gesture that is rejected
HOP_S = 0.1
DETECT_S = 0.45  # of the detector's window
NAME_S = 0.75  # of the recogniser's window; a network has its own
WAIT_S = 0.2  # from the first complete window of an event to its report
REPEATED = 4.0  # windows of one event that the detector sees together, as of `Discriminants`
WEIGHT = 3.0  # of a decision's log-odds, for each hop of a detector's window: overlapping windows repeat each other
BEGIN, END = 0.05, 0.2  # touches that begin, and that end, per second
ON, OFF = 0.95, 0.1
BIASES = np.arange(-10, 4.25, 0.25, dtype=np.float32)  # of which one is learned
UNUSUAL = 3.0  # SDs of training windows
MARGIN = 1.5  # how much further from training than any training window a window may be
REFUSED = -4.0  # log-odds of a window that is refused


@dataclass(frozen=True)
class Clock:
    """Frames of the windows of a watcher; the two windows are whole numbers of hops.

    Attributes:
        hop: frames from one decision to the next.
        detect: frames of the detector's window.
        name: frames of the recogniser's window.
    """

    hop: int
    detect: int
    name: int

    @classmethod
    def of(cls, system: contract.System, rate_hz: float) -> Clock:
        """The clock of a system: its own window, or a second, and the hop nearest to 0.1 s that divides it.

        Args:
            system: fitted or not.
            rate_hz: frames per second.
        """
        name = window_of(system, rate_hz)
        wanted = max(1.0, HOP_S * rate_hz)
        fitting = [hop for hop in range(1, name + 1) if name % hop == 0 and wanted / 2 <= hop <= 2 * wanted]
        hop = min(fitting, key=lambda hop: abs(np.log(hop / wanted))) if fitting else max(1, min(round(wanted), name))
        detect = hop * max(1, round(min(DETECT_S * rate_hz, name) / hop))
        return cls(hop, detect, hop * max(1, round(name / hop)))

    def up(self, frames: np.ndarray) -> np.ndarray:
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

    A window is refused, and is no touch, if more of its features lie far from training than in any training window, or
    if no taxel changes in it: the sensor is tared, saturated or disconnected.

    Args:
        detect: frames of a window.

    Attributes:
        classifier_: fitted to windows of each gesture and of background.
        mean_, sd_: statistics of the features of training windows, float32 [features].
        limit_: share of features beyond 3 SDs from which on a window is refused.
    """

    detect: int

    def fit(self, table: np.ndarray, labels: np.ndarray, events: np.ndarray) -> Detector:
        """Learn from windows.

        Args:
            table: features [windows, n_features], float32.
            labels: gesture of each window, `BACKGROUND` for background.
            events: number of the event, or the gap between events, that each window lies in.
        """
        rows = pd.DataFrame(table, index=row_labels(events, np.zeros(len(events), np.int64)))
        self.classifier_ = Discriminants(windows=REPEATED).fit(rows, labels)
        self.mean_, self.sd_ = table.mean(axis=0), table.std(axis=0)
        self.sd_[constant(table) | (self.sd_ == 0)] = np.inf
        self.limit_ = MARGIN * float(self.unusual(table).max())
        return self

    def log_odds(self, table: np.ndarray, still: np.ndarray) -> np.ndarray:
        """Log-odds of touch of each window, float32; `REFUSED` for one that is refused.

        Args:
            table: features [windows, n_features], float32.
            still: True if no taxel changes in a window, bool [windows].
        """
        scores = self.classifier_.decision_function(table)
        quiet = self.classifier_.classes_ == BACKGROUND
        odds = logsumexp(scores[:, ~quiet], axis=1) - scores[:, quiet][:, 0]
        return np.where(still | (self.unusual(table) > self.limit_), REFUSED, odds).astype(np.float32)

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
    frames = recording[0]
    changes = np.append(0, np.cumsum((frames[1:] != frames[:-1]).any(axis=(1, 2))))
    still = changes[ends - 1] == changes[ends - clock.detect]
    return TouchFeatures().transform(cut(recording, ends, clock.detect)).to_numpy(dtype=np.float32), still


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
    hop_s = np.float32(clock.hop / rate_hz)
    begin, end = np.float32(BEGIN) * hop_s, np.float32(END) * hop_s
    weight = np.float32(WEIGHT * clock.hop / clock.detect)
    steps = np.clip(weight * np.asarray(log_odds, np.float32), -10, 10)
    q = np.zeros(steps.shape[1:], np.float32)
    series = np.empty_like(steps)
    for i, step in enumerate(steps):
        prior = q * (1 - end) + (1 - q) * begin
        odds = prior / (1 - prior) * np.exp(step)
        series[i] = q = odds / (1 + odds)
    return series


def spans(probability: np.ndarray, clock: Clock) -> np.ndarray:
    """When the sensor was touched, as the probabilities of one recording show it.

    Returns:
        A row per touch, in frames seen: when touch became more probable than not, when it was detected, and when its
        end was detected (the last decision for a touch that goes on), int64 [touches, 3].
    """
    rising = np.flatnonzero((probability > 0.5) & (np.append(np.float32(0), probability[:-1]) <= 0.5))
    high, low = np.flatnonzero(probability > ON), np.flatnonzero(probability < OFF)
    rows, now = [], 0
    while (place := np.searchsorted(high, now)) < len(high):
        begun = high[place]
        after = np.searchsorted(low, begun)
        now = low[after] if after < len(low) else len(probability) - 1
        rows.append((rising[np.searchsorted(rising, begun, side="right") - 1], begun, now))
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
        reject: confidence below which a label is ``unknown``; 0 for never.
    """

    system: contract.System
    background: tuple[str, ...]
    clock: Clock
    detector: Detector
    bias: float
    tail: int
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
        steps, inner = behind(self.system)
        seen = taken(contract.blinded(self.system, recordings), steps)[0]
        rows: list[tuple] = []
        for i in range(len(seen)):
            recording = seen[[i]]
            odds = self.detector.log_odds(*windows_of(recording, self.clock)) + np.float32(self.bias)
            touches = spans(touched(odds, self.clock, seen.rate_hz), self.clock)
            times, kept = reports_of(touches, self.clock, seen.rate_hz)
            series = [
                np.arange(self.clock.up(crossed + self.clock.name), end + 1, self.clock.hop)
                for crossed, end in touches[kept][:, [0, 2]]
            ]
            if not series:
                continue
            proba = self._probabilities(inner, cut(recording, np.concatenate(series), self.clock.name))
            parts = np.split(proba, np.cumsum([len(ends) for ends in series])[:-1])
            for (reported, ended), ends, part in zip(times[kept].tolist(), series, parts, strict=True):
                rows.append((i, reported, ended, *self._named(part, ends, reported, ended)))
        return report_table(rows)

    def _probabilities(self, inner: contract.System, windows: Corpus) -> np.ndarray:
        """Probabilities of the gestures, without background, float32 [windows, gestures]."""
        gestures = ~np.isin(np.asarray(inner.classes_).astype(str), self.background)
        proba = contract.probabilities(inner, windows)[:, gestures]
        return (proba / np.maximum(proba.sum(axis=1, keepdims=True), 1e-9)).astype(np.float32)

    def _named(self, proba: np.ndarray, ends: np.ndarray, reported: int, ended: int) -> tuple[str, str, float]:
        """Labels of an event when it is reported and at its end: of the mean over its windows until then."""
        first = proba[ends <= reported].mean(axis=0)
        last = proba[(ends <= ended - self.tail) | (ends <= reported)].mean(axis=0)
        names = [str(self.names[p.argmax()]) if p.max() >= self.reject else UNKNOWN for p in (first, last)]
        return names[0], names[1], float(last.max())


def reports_of(touches: np.ndarray, clock: Clock, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """When events are reported: `WAIT_S` after their first window is complete, or at their end if that comes first.

    Args:
        touches: result of `spans` [touches, 3].
        clock: timing of the windows.
        rate_hz: frames per second.

    Returns:
        Frames seen at the report and at the end [touches, 2], and which touches are long enough for one window.
    """
    complete = np.maximum(clock.up(touches[:, 0] + clock.name), touches[:, 1])
    wait = clock.hop * round(WAIT_S * rate_hz / clock.hop)
    reported = np.minimum(complete + wait, touches[:, 2])
    return np.column_stack([reported, touches[:, 2]]), complete <= touches[:, 2]


def learned(system: contract.System, recordings: Recordings, false_alarms: float) -> Watcher:
    """A watcher whose detector and post-processing are learned from training recordings.

    Each subject is left out in turn; a detector that is fitted to the others watches the subject's recordings. Of the
    biases that give at most ``false_alarms`` per hour, counting one more than there were, the one that finds most
    touches is taken.

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
    tables = [training_windows(recordings[i], table, clock) for i, (table, _) in enumerate(seen)]
    odds: list[np.ndarray] = [np.zeros(0)] * len(seen)
    for train, judged in inner_folds(recordings.subjects.astype(str), "loso"):
        detector = _fitted([tables[i] for i in train], clock)
        for i in judged:
            odds[i] = detector.log_odds(*seen[i])
    settings = bias_table(recordings, odds, clock)
    fitting = settings[settings["alarms"] + 1 <= false_alarms * settings["hours"]]
    chosen = settings.iloc[0] if fitting.empty else fitting.loc[fitting["found"].idxmax()]
    gestures = set(recordings.events["gesture"])
    background = tuple(sorted(set(np.asarray(system.classes_).astype(str)) - gestures))
    return Watcher(system, background, clock, _fitted(tables, clock), float(chosen["bias"]), int(chosen["tail"]))


Windowed = tuple[np.ndarray, np.ndarray, np.ndarray]  # features, labels and events of windows


def training_windows(recording: Recordings, table: np.ndarray, clock: Clock) -> Windowed:
    """Every second window of one recording that lies within one event or one gap: features, label, number of it."""
    ends = clock.detect + clock.hop * np.arange(len(table))
    starts = recording.events["start"].to_numpy()
    edges = np.unique(np.append(starts, recording.events["end"].to_numpy()))
    number = np.searchsorted(edges, ends - 1, side="right")
    inside = number == np.searchsorted(edges, ends - clock.detect, side="right")
    inside[1::2] = False
    labels = recording.frame_labels()[ends - 1]
    return table[inside], np.where(labels == "", BACKGROUND, labels)[inside].astype(str), number[inside]


def _fitted(parts: list[Windowed], clock: Clock) -> Detector:
    """A detector that is fitted to the windows of some recordings."""
    events = [number + 1_000_000 * i for i, (_, _, number) in enumerate(parts)]
    table, labels = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return Detector(clock.detect).fit(table, labels, np.concatenate(events))


def bias_table(recordings: Recordings, odds: list[np.ndarray], clock: Clock) -> pd.DataFrame:
    """What each bias gives on recordings: ``bias``, ``tail`` (frames), ``alarms``, ``hours``, ``found`` (share).

    Args:
        recordings: with their events.
        odds: log-odds of the windows of each recording.
        clock: timing of the windows.
    """
    rate_hz = recordings.corpus.rate_hz
    hours = int(recordings.background_frames().sum()) / rate_hz / 3600
    times: list[list[np.ndarray]] = [[] for _ in BIASES]
    for i, series in enumerate(odds):
        for k, column in enumerate(touched(series[:, None] + BIASES, clock, rate_hz).T):
            reported, kept = reports_of(spans(column, clock), clock, rate_hz)
            times[k].append(np.insert(reported[kept], 0, i, axis=1))
    rows = []
    for bias, each in zip(BIASES, times, strict=True):
        reports = pd.DataFrame(np.concatenate(each), columns=["recording", "reported", "end"])
        touch = touches_of(recordings.events, reports, rate_hz)
        late = (reports["end"].to_numpy() - recordings.events["end"].to_numpy()[touch])[touch != FALSE_ALARM]
        tail = max(int(np.median(late)), 0) if len(late) else 0
        found = len(np.setdiff1d(touch, [FALSE_ALARM])) / max(len(recordings.events), 1)
        rows.append((bias, tail, int((touch == FALSE_ALARM).sum()), hours, found))
    return pd.DataFrame(rows, columns=["bias", "tail", "alarms", "hours", "found"])
