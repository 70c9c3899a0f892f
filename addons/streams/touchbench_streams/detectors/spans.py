"""Touches in the ticks of a stream: when each is reported, named and over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from touchbench_streams.detectors.base import Sign

GROWTH = 1.25  # a touch is named again when its length has grown by this factor
SURE = 0.5  # least confidence in touch in the last tick that a name is made from


def average_blocks(frames: np.ndarray, count: int) -> np.ndarray:
    """Means of blocks of ``count`` frames, float32; of fewer frames, their mean."""
    count = min(count, len(frames))
    used = len(frames) // count * count
    blocks = frames[:used].reshape(-1, count, *frames.shape[1:])
    return blocks.mean(axis=1, dtype=np.float64).astype(np.float32)


@dataclass
class Span:
    """A reported touch; times are counted in frames seen.

    Attributes:
        reported: time of the report.
        end: time of the end, or of the last tick so far.
        named: beginning and end of the frames that it is named from, at the report and as it grows.
            A long touch has consecutive parts, and each name comes from one of them.
        last: the same for its name at the end, if it ends before it is named again; None if that
            is the last of ``named``.
    """

    reported: int
    end: int
    named: list[tuple[int, int]]
    last: tuple[int, int] | None = None


class Touches:
    """The touches of a stream from its signs, one tick after another; nothing looks ahead.

    A touch is named from one part after another, none much longer than ``longest`` ticks of
    ``count`` frames: a chip cannot keep the frames of the last seconds, but it can sum up those
    since a part began.
    """

    def __init__(self, count: int, longest: int) -> None:
        self.count, self.longest = count, longest
        self.lasting: Span | None = None
        self.tick = self.start = self.named = self.sure = 0  # in ticks
        self.first = 0  # ticks of the first name
        self.due = 0.0

    def step(self, sign: Sign | tuple[float, float, bool]) -> Span | None:
        """Take the sign of the next tick; return the touch that ends with it."""
        touch, since, report = sign
        self.tick += 1
        is_over = bool(report or since <= 1)  # at 1, another touch begins
        if is_over or touch < SURE:
            self._plan_last_name()
        ended = None
        if is_over:
            ended, self.lasting = self.lasting, None
        if touch >= SURE:
            self.sure = self.tick
        if report:
            # one tick earlier, in which the touch may have begun
            self.start = max(self.tick - int(since) - 1, 0)
            self.first = self.tick - self.start
            self.lasting = Span(self.tick * self.count, self.tick * self.count, [])
            self._plan_name(self.tick)
        if self.lasting is not None:
            self.lasting.end = self.tick * self.count
            if self.sure == self.tick >= self.due:
                self._plan_name(self.tick)
            if self.tick - self.start >= self.longest:
                if self.sure > self.named:
                    self._plan_name(self.sure)
                self.start = self.named = self.tick
                self.due = self.start + self.first
        return ended

    def end_stream(self) -> Span | None:
        """Return the touch that has not ended at the end of the stream."""
        self._plan_last_name()
        return self.lasting

    def _plan_name(self, tick: int) -> None:
        assert self.lasting is not None
        self.lasting.named.append(self._frames_until(tick))
        self.lasting.last, self.named = None, tick
        self.due = self.start + GROWTH * (tick - self.start)

    def _plan_last_name(self) -> None:
        if self.lasting is not None and self.sure > self.named:
            self.lasting.last = self._frames_until(self.sure)

    def _frames_until(self, tick: int) -> tuple[int, int]:
        return self.start * self.count, tick * self.count


def find_spans(signs: np.ndarray, count: int, longest: int) -> list[Span]:
    """Reported touches of a recording, from its signs; the arguments are those of `Touches`."""
    touches = Touches(count, longest)
    spans = [*map(touches.step, signs.tolist()), touches.end_stream()]
    return [span for span in spans if span is not None]


def longest_spans(touches: list[Span]) -> list[tuple[int, int]]:
    """The longest frames that each touch is named from; of equal ones the latest."""
    spans = [[*filter(None, [touch.last]), *reversed(touch.named)] for touch in touches]
    return [max(of_touch, key=lambda span: span[1] - span[0]) for of_touch in spans]
