"""The detector `threshold`: mean pressure above slow baselines, two ticks in a row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from touchbench_streams.detectors.base import DetectorC, Sign
from touchbench_streams.detectors.detector import Detector, read_c_beside
from touchbench_streams.recordings import Recordings

ENDS = 0.5  # share of the threshold below which a touch is over


class Excess:
    """Mean pressure above the baseline of each taxel.

    In a tick the baseline goes shares ``up`` or ``down`` of the way to the reading.
    """

    def __init__(self, up: float, down: float) -> None:
        self.up, self.down = np.float32(up), np.float32(down)
        self.baseline: np.ndarray | None = None

    def step(self, frame: np.ndarray) -> np.ndarray:
        """Mean excess of a frame [1]; the baseline follows."""
        if self.baseline is None:
            self.baseline = np.array(frame, np.float32)
        above = frame - self.baseline
        self.baseline += np.where(above > 0, self.up, self.down) * above
        return np.array([np.maximum(above, 0).mean()], np.float32)


class TwoInARow:
    """Report a touch at the second tick above a level; it is over below half of the level."""

    def __init__(self, level: float) -> None:
        self.level, self.since, self.reported = level, 0, False

    def step(self, evidence: np.ndarray) -> Sign:
        """Take the evidence of a tick: the excess, in units of that of training touches."""
        excess = float(evidence[0])
        threshold = ENDS * self.level if self.reported else self.level
        self.since = self.since + 1 if excess > threshold else 0
        report = self.since == 2 and not self.reported
        self.reported = self.since > 0 and (self.reported or report)
        touch = excess / (excess + self.level) if excess > 0 else 0.0
        return Sign(touch, self.since, report)


@dataclass
class Threshold(Detector):
    """Mean pressure above a slow baseline of each taxel, two ticks in a row; the simple reference.

    Args:
        tick: seconds of a tick, at least one frame. Default: chosen on recordings of a skin at
            7 Hz.
        up: seconds in which the baseline follows a higher reading: much longer than a touch.
            Default: the longest touch of HAART.
        down: seconds in which it follows a lower one. Default: shorter than most gaps.
    """

    tick: float = 0.125
    up: float = 60.0
    down: float = 2.0

    levels: ClassVar[np.ndarray] = np.geomspace(0.02, 4, 40)
    soonest: ClassVar[int] = 2
    latest: ClassVar[int] = 2
    numbers: ClassVar[int] = 1

    def signals(self) -> Excess:
        """Signals of a new stream."""
        return Excess(self.tick / self.up, self.tick / self.down)

    def fit(self, signals: list[np.ndarray], recordings: Recordings) -> Self:
        """Learn the median excess in training touches."""
        touched = [s[recordings[[i]].frame_labels() != "", 0] for i, s in enumerate(signals)]
        fitted = replace(self)
        fitted.unit_ = float(np.median(np.concatenate(touched))) or 1.0
        return fitted

    def evidence(self, signals: np.ndarray) -> np.ndarray:
        """Excess in units of training touches."""
        return signals / np.float32(self.unit_)

    def rules(self, level: float) -> TwoInARow:
        """Rules of a new stream."""
        return TwoInARow(level)

    @classmethod
    def find_signs(
        cls, detectors: Sequence[Self], evidence: Sequence[np.ndarray], levels: np.ndarray
    ) -> Iterator[np.ndarray]:
        """As of `Detector`; all levels at once."""
        if cls.rules is not Threshold.rules:  # a subclass decides otherwise
            yield from super().find_signs(detectors, evidence, levels)
            return
        for series in evidence:
            since, is_reported = np.zeros(len(levels), np.int64), np.zeros(len(levels), bool)
            excess = np.maximum(series[:, :1].astype(np.float64), 0)
            signs = np.stack([excess / (excess + levels)] * 3, axis=2)
            for i, value in enumerate(series[:, 0].astype(np.float64)):
                since = (since + 1) * (value > np.where(is_reported, ENDS * levels, levels))
                report = (since == 2) & ~is_reported
                is_reported = (since > 0) & (is_reported | report)
                signs[i, :, 1], signs[i, :, 2] = since, report
            yield signs

    def in_c(self) -> DetectorC:
        """As of `touchbench_streams.detectors.detector.Detector`."""
        constants = (
            "The baseline; the excess of training touches, learned; where a touch is over.",
            {
                "UP": self.tick / self.up,
                "DOWN": self.tick / self.down,
                "UNIT": self.unit_,
                "ENDS": ENDS,
            },
        )
        state = (
            "float baseline[{TAXELS}];",
            "int felt, since, is_known;  /* ticks; whether the touch was reported */",
        )
        pretended = "w->level = touched ? -1 : 1e30f;"
        return DetectorC(read_c_beside(__file__), state, (constants,), pretended=pretended)
