"""Is the sensor touched? The first stage of watching an endless stream: log-odds of windows, and a filter over them.

Everything is causal and has a fixed memory, so that `bench export` can write the same as C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bench import contract
from bench.corpora.corpus import Corpus, storage
from bench.features.base import labels as row_labels
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import Discriminants, Summed

BACKGROUND = ""  # class of background
BROKEN = " "  # first letter of the class of each kind of broken sensor; sorts before all gestures
HOP_S = 0.1
DETECT_S = 0.45  # detector's window
NAME_S = 0.75  # recogniser's window; a network has its own
WAIT_S = 0.2  # from the first complete window of an event to its report
HOLD_S = 0.3  # a touch that begins again so soon goes on
REPEATED = 4.0  # windows of one event that decide together, as of `Discriminants`
WEIGHT = 4.0  # of log-odds, for each hop of a detector's window: overlapping windows repeat each other
BEGIN, END = 0.05, 0.2  # touches that begin, and that end, per second
UNUSUAL = 3.0  # SDs of training windows
MARGIN = 1.5  # how much further from training than any training window a window may be
REFUSED = -4.0  # log-odds of a window that is refused


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


@dataclass(frozen=True)
class SubjectSums:
    """What the windows of one subject teach a detector.

    Attributes:
        sums: statistics of all its windows.
        real: features of those that no broken sensor shows [windows, n_features].
    """

    sums: Summed
    real: np.ndarray

    @classmethod
    def of(cls, table: np.ndarray, labels: np.ndarray, events: np.ndarray) -> SubjectSums:
        """Count windows.

        Args:
            table: features [windows, n_features], float32.
            labels: str [windows]: gesture, `BACKGROUND`, or `BROKEN` followed by the kind of a broken sensor.
            events: number of the event, or the gap between events, that each window lies in.
        """
        rows = pd.DataFrame(table, index=row_labels(events, np.zeros(len(events), np.int64)))
        return cls(_discriminants().summed(rows, labels), table[~np.char.startswith(labels, BROKEN)])


def _discriminants() -> Discriminants:
    return Discriminants(windows=REPEATED)


class Decisions(NamedTuple):
    """What a detector makes of windows.

    Attributes:
        odds: log-odds of touch, `REFUSED` for a window that is no touch whatever it shows, float32 [windows].
        refused: True for such windows, and where a broken sensor is more probable than anything else, bool [windows].
    """

    odds: np.ndarray
    refused: np.ndarray


@dataclass(eq=False)
class Detector:
    """Linear discriminants on `bench.features.touch` that tell touch from background, whatever the gesture.

    Background from broken sensors (`bench.endless.broken`) has one class for each kind. A window is refused, and is no
    touch, if more of its features lie far from training than in any real training window, or if no taxel changes in it:
    the sensor is tared, saturated or disconnected. Noise, vibration and drift look like a broken sensor most of the
    time, so windows that do count as refused, too, though their log-odds stay.

    Args:
        detect: frames of a window.

    Attributes:
        classifier_: fitted to windows of each gesture and of background.
        quiet_: number of its classes that are no gesture; they are the first. Without any, all is touch.
        sound_: number of these that are no broken sensor; they are the first.
        limit_: share of features beyond 3 SDs above which a window is refused.
    """

    detect: int

    def fit(self, parts: Sequence[SubjectSums]) -> Detector:
        """Learn from the windows of some subjects, all at once."""
        self.classifier_ = _discriminants().fit_summed([part.sums for part in parts])
        self.sound_ = sum(name == BACKGROUND for name in self.classifier_.classes_)
        self.quiet_ = self.sound_ + sum(name.startswith(BROKEN) for name in self.classifier_.classes_)
        self.limit_ = MARGIN * max(float(self.unusual(part.real).max(initial=0)) for part in parts)
        return self

    def decisions(self, table: np.ndarray, still: np.ndarray) -> Decisions:
        """Decide on windows.

        Args:
            table: features [windows, n_features], float32.
            still: True if no taxel changes in a window, bool [windows].
        """
        scores = self.classifier_.decision_function(table)
        quiet = logsumexp(scores[:, : self.quiet_], axis=1) if self.quiet_ else -np.inf
        odds = logsumexp(scores[:, self.quiet_ :], axis=1) - quiet
        strange, likeliest = still | (self.unusual(table) > self.limit_), scores.argmax(axis=1)
        broken = (likeliest >= self.sound_) & (likeliest < self.quiet_)
        return Decisions(np.where(strange, REFUSED, odds).astype(np.float32), strange | broken)

    @property
    def numbers(self) -> int:
        """Count of learned numbers."""
        return self.classifier_.coef_.size + self.classifier_.intercept_.size + self.classifier_.constants_

    def unusual(self, table: np.ndarray) -> np.ndarray:
        """Share of the features of each window that lie beyond 3 SDs of training [windows]."""
        usual = self.classifier_.learnt_
        return (~(np.abs(table - usual.mean) <= UNUSUAL * usual.sd)).mean(axis=1)


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
    windows = recording if len(ends) == 1 else recording[np.zeros(len(ends), np.int64)]  # which copies the table
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
