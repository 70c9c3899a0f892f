"""Ticks of a stream, and the touches in them: when each is reported, named and over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from touchbench_streams.detectors.base import Sign

GROWTH = 1.25  # a touch is named again when it is so many times as long
SURE = 0.5  # confidence in touch of the last tick that a name is made from


def average_blocks(frames: np.ndarray, count: int) -> np.ndarray:
    """Means of blocks of frames, float32; of fewer frames than one block, their mean."""
    count = min(count, len(frames))
    whole = len(frames) // count * count
    return (
        frames[:whole]
        .reshape(-1, count, *frames.shape[1:])
        .mean(axis=1, dtype=np.float64)
        .astype(np.float32)
    )


@dataclass
class Span:
    """A touch that rules report; times are frames seen.

    Attributes:
        reported: time of the report.
        end: time of the end, or of the last tick so far.
        named: beginning and end of the frames that it is named from, at the report and as it grows. A long touch has
            parts that follow one another, and each name comes from one of them.
        last: the same for its name at the end, if it ends before it is named again; None if that is the last of
            ``named``.
    """

    reported: int
    end: int
    named: list[tuple[int, int]]
    last: tuple[int, int] | None = None


class Touches:
    """The touches of a stream from its signs, one tick after another; nothing looks ahead.

    Names come from one part of a touch after another, none much longer than ``longest`` ticks of ``count`` frames: a
    chip cannot keep the frames of the last seconds, but it can sum up those since a part began.
    """

    def __init__(self, count: int, longest: int) -> None:
        self.count, self.longest = count, longest
        self.lasting: Span | None = None
        self.tick = self.start = self.named = self.sure = 0  # in ticks
        self.first = 0  # ticks of the first name
        self.due = 0.0

    def step(self, sign: Sign | tuple[float, float, bool]) -> Span | None:
        """Take the sign of the next tick; the touch that is over with it."""
        touch, since, report = sign
        self.tick += 1
        over = bool(report or since <= 1)  # at 1, another touch begins
        if over or touch < SURE:
            self._plan_last_name()
        ended = self.lasting if over else None
        if over:
            self.lasting = None
        if touch >= SURE:
            self.sure = self.tick
        if report:
            self.start = max(
                self.tick - int(since) - 1, 0
            )  # with the tick before, in which the touch may have begun
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
        """The touch that lasts where the stream ends."""
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
    """The touches that are reported, from the signs of one recording; arguments of `Touches`."""
    touches = Touches(count, longest)
    return [
        span
        for span in [*map(touches.step, signs.tolist()), touches.end_stream()]
        if span is not None
    ]
