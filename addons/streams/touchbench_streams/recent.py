"""The last frames of an endless stream, as a detector and a recogniser see them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import pandas as pd

from bench.corpora.corpus import SATURATED_ONE_IN, Corpus
from bench.models.steps import SETTLED_S


def find_saturated(frames: np.ndarray, full_scale: float) -> np.ndarray:
    """Whether many taxels of each frame [frames, rows, cols] are at full scale, bool [frames]."""
    return np.count_nonzero(frames >= full_scale, axis=(1, 2)) * SATURATED_ONE_IN >= frames[0].size


class Recent:
    """The last frames; of those before, the smallest and largest values, from which steps tell what is stuck."""

    def __init__(self, most: int, grid: tuple[int, int], rate_hz: float, full_scale: float) -> None:
        self.rate_hz, self.full_scale = rate_hz, full_scale
        self.frames: deque[np.ndarray] = deque(maxlen=most)
        self.seen = 0  # frames so far
        table = pd.DataFrame({"subject": [""], "gesture": [""]})
        self.one = Corpus.from_captures(
            [np.zeros((1, *grid))], table, rate_hz, full_scale=full_scale
        ).blind()
        self.least, self.most = (
            np.full(grid, np.inf),
            np.full(grid, -np.inf),
        )  # of frames that were dropped

    def push(self, frame: np.ndarray) -> None:
        """Take a frame [rows, cols]."""
        if len(self.frames) == self.frames.maxlen:
            self.least = np.minimum(self.least, self.frames[0])
            self.most = np.maximum(self.most, self.frames[0])
        self.frames.append(frame)
        self.seen += 1

    @property
    def is_saturated(self) -> bool:
        """True if many taxels of the last frame are at full scale."""
        return bool(find_saturated(self.frames[-1][None], self.full_scale)[0])

    def as_recording(self, prepared: Callable[[Corpus], Corpus]) -> Corpus:
        """The frames that are kept, after the steps; older frames count by their smallest and largest values."""
        older = min(self.seen - len(self.frames), max(2, int(np.ceil(SETTLED_S * self.rate_hz))))
        before = [self.least] * (older - 1) + [self.most] * bool(older)
        frames = np.stack([*before, *self.frames])
        whole = self.one.with_fields(
            frames=frames, starts=np.array([0]), lengths=np.array([len(frames)])
        )
        return prepared(whole).with_fields(
            starts=np.array([older]), lengths=np.array([len(self.frames)])
        )
