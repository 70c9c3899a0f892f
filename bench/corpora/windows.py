"""Steps that captures go through before a system, and windows of captures.

A step is called with a `Corpus` and returns another one, with the captures in the same order. It
learns nothing, so it does the same in training and in tests. Each resulting capture depends on one
original capture alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.corpora.corpus import Corpus, shared_frames, unblind


class Step:
    """A step, which turns each capture into one or several."""

    def source_rows(self, corpus: Corpus) -> np.ndarray:
        """Position of the original capture of each resulting one."""
        return np.arange(len(corpus))

    def code_objects(self) -> list[Callable]:
        """The code on which its results depend."""
        return [type(self)]

    def kept_numbers(self, taxels: int) -> int:
        """Numbers in memory where frames come one by one."""
        return 0

    def __call__(self, corpus: Corpus) -> Corpus:
        """Apply the step: captures in the order of their originals."""
        raise NotImplementedError


@dataclass(frozen=True)
class Windows(Step):
    """Cut every capture into windows; no frame is copied.

    Windows begin with the capture and at every hop, as far as they are full. A shorter capture
    stays as it is.

    Args:
        seconds: length of a window.
        hop: seconds from the beginning of one window to that of the next; 0 is half a window.
    """

    seconds: float
    hop: float = 0.0

    def window_and_hop(self, rate_hz: float) -> tuple[int, int]:
        """Frames of a window and of a hop."""
        frames = max(1, round(self.seconds * rate_hz))
        hop = round(self.hop * rate_hz) if self.hop else (frames + 1) // 2
        return frames, max(1, hop)

    def source_rows(self, corpus: Corpus) -> np.ndarray:
        """Position of the original capture of each window."""
        frames, hop = self.window_and_hop(corpus.rate_hz)
        windows = np.maximum(corpus.lengths - frames, 0) // hop + 1
        return np.repeat(np.arange(len(corpus)), windows)

    def __call__(self, corpus: Corpus) -> Corpus:
        """The windows of each capture."""
        frames, hop = self.window_and_hop(corpus.rate_hz)
        rows = self.source_rows(corpus)
        begin = (np.arange(len(rows)) - np.searchsorted(rows, rows)) * hop
        if len(rows) > len(corpus):  # a robot's only window is not worth the copy of a table
            corpus = corpus[rows]
        origin = unblind(corpus)
        return corpus.with_fields(
            starts=shared_frames(corpus)[1] + begin,
            lengths=np.minimum(corpus.lengths, frames),
            piece=origin.piece + begin,
            steps=(*origin.steps, self),
        )
