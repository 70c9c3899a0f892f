"""A detector that decides tick by tick, on frames that come one by one."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bench.endless.detectors.base import Event
from bench.endless.detectors.names import LONGEST_S, probabilities, weights
from bench.endless.detectors.ticks import Span, Touches, means
from bench.endless.recent import Recent

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.endless.detectors.ticks import TickWatcher


class TickStream:
    """A watcher on frames that come one by one; memory does not grow.

    Args:
        watcher: a watcher that was learned.
        grid: (rows, cols) of the sensor.
        rate_hz: frames per second.
        full_scale: largest value of a channel.
    """

    def __init__(self, watcher: TickWatcher, grid: tuple[int, int], rate_hz: float, full_scale: float) -> None:
        self.watcher, self.touches = watcher, Touches(watcher.count)
        self.signals, self.rules = watcher.detector.signals(), watcher.detector.rules(watcher.level)
        self.ring: deque[np.ndarray] = deque(maxlen=watcher.detector.memory)
        longest = max(1, round(LONGEST_S * rate_hz))
        self.recent = Recent(longest + 2 * watcher.count, grid, rate_hz, full_scale)
        self._forget()

    def _forget(self) -> None:
        self.event: Event | None = None
        self.names, self.sum, self.weight = 0, np.zeros(len(self.watcher.names.classes_)), 0.0  # so far
        self.last: tuple[int, int] | None = None
        self.after = self.sum, 0.0  # what the name at the end adds, if the touch ends before it is named again

    def push(self, frame: np.ndarray) -> list[Event]:
        """Take a frame [rows, cols]; the events that it ends, reports or renames, in this order."""
        self.recent.push(frame)
        if self.recent.seen % self.watcher.count:
            return []
        recording = self.recent.recording(self.watcher.prepared)
        tick = means(recording[0][-self.watcher.count :], self.watcher.count)[0]
        self.ring.append(self.signals.step(tick))
        evidence = self.watcher.detector.evidence(np.stack(self.ring))[-1]
        sign = self.rules.step(evidence)
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
        span = np.array([max(begin, gone)]) - gone, np.array([end]) - gone
        weight = weights(np.array([end - begin]), recording.rate_hz)[0]
        return weight * probabilities(self.watcher.names, recording, *span)[0], float(weight)
