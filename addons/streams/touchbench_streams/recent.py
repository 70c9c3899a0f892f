"""The last frames of an endless stream, for a detector and a recogniser."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import pandas as pd

from bench.corpora.corpus import SATURATED_ONE_IN, Corpus
from bench.models.steps import SETTLED_S


def find_saturated(frames: np.ndarray, full_scale: float) -> np.ndarray:
    """Whether many taxels are at full scale in each of the frames [frames, rows, cols]."""
    return np.count_nonzero(frames >= full_scale, axis=(1, 2)) * SATURATED_ONE_IN >= frames[0].size


class Recent:
    """The last frames of a stream, and the extremes of older ones, which show stuck taxels."""

    def __init__(
        self, capacity: int, grid: tuple[int, int], rate_hz: float, full_scale: float
    ) -> None:
        self.rate_hz, self.full_scale = rate_hz, full_scale
        self.frames: deque[np.ndarray] = deque(maxlen=capacity)
        self.seen = 0  # frames so far
        table = pd.DataFrame({"subject": [""], "gesture": [""]})
        capture = np.zeros((1, *grid))
        corpus = Corpus.from_captures([capture], table, rate_hz, full_scale=full_scale)
        self.template = corpus.blind()
        self.lowest = np.full(grid, np.inf)  # of frames that were dropped
        self.highest = np.full(grid, -np.inf)

    def push(self, frame: np.ndarray) -> None:
        """Take a frame [rows, cols]."""
        if len(self.frames) == self.frames.maxlen:
            self.lowest = np.minimum(self.lowest, self.frames[0])
            self.highest = np.maximum(self.highest, self.frames[0])
        self.frames.append(frame)
        self.seen += 1

    def as_recording(self, apply_steps: Callable[[Corpus], Corpus]) -> Corpus:
        """The kept frames after steps, to which older frames contribute their extremes."""
        older = min(self.seen - len(self.frames), max(2, int(np.ceil(SETTLED_S * self.rate_hz))))
        extremes = [self.lowest] * (older - 1) + [self.highest] * bool(older)
        frames = np.stack([*extremes, *self.frames])
        recording = self.template.with_fields(
            frames=frames, starts=np.array([0]), lengths=np.array([len(frames)])
        )
        kept = {"starts": np.array([older]), "lengths": np.array([len(self.frames)])}
        return apply_steps(recording).with_fields(**kept)
