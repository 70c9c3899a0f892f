"""Steps that captures go through before a system, and windows of captures.

A step is called with a `Corpus` and returns another one, with the captures in the same order. It learns nothing, so it
does the same in training and in tests. Each resulting capture depends on one original capture alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.corpora.corpus import Corpus, corpus_origin, shared_frames


class Step:
    """A step, which turns each capture into one or several."""

    def source_rows(self, corpus: Corpus) -> np.ndarray:
        """The original capture of each new one, as an index."""
        return np.arange(len(corpus))

    def code_objects(self) -> list[Callable]:
        """The code that its results depend on."""
        return [type(self)]

    def kept_numbers(self, taxels: int) -> int:
        """Numbers in memory where frames come one by one."""
        return 0

    def __call__(self, corpus: Corpus) -> Corpus:
        """The captures that are made of those of a corpus, in the same order."""
        raise NotImplementedError


@dataclass(frozen=True)
class Windows(Step):
    """Every capture as windows of ``seconds``, one every ``hop``, 0 for half a window; no frame is copied.

    Windows begin with the capture and at every hop, as far as they are full. A shorter capture stays as it is.
    """

    seconds: float
    hop: float = 0.0

    def window_and_hop(self, rate_hz: float) -> tuple[int, int]:
        """Frames of a window and of a hop."""
        frames = max(1, round(self.seconds * rate_hz))
        return frames, max(1, round(self.hop * rate_hz) if self.hop else (frames + 1) // 2)

    def source_rows(self, corpus: Corpus) -> np.ndarray:
        """The original capture of each window, as an index."""
        frames, hop = self.window_and_hop(corpus.rate_hz)
        return np.repeat(np.arange(len(corpus)), np.maximum(corpus.lengths - frames, 0) // hop + 1)

    def __call__(self, corpus: Corpus) -> Corpus:
        """The windows of each capture."""
        frames, hop = self.window_and_hop(corpus.rate_hz)
        row = self.source_rows(corpus)
        begin = (np.arange(len(row)) - np.searchsorted(row, row)) * hop
        cut = (
            corpus[row] if len(row) > len(corpus) else corpus
        )  # a robot's one window is not worth copying a table
        source = corpus_origin(cut)
        return cut.with_fields(
            starts=shared_frames(cut)[1] + begin,
            lengths=np.minimum(cut.lengths, frames),
            piece=source.piece + begin,
            steps=(*source.steps, self),
        )
