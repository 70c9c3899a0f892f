"""Names of touches as they grow: one system for their beginnings, and one for whole touches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from bench import contract
from bench.corpora.corpus import Corpus, storage
from bench.corpora.recordings import Recordings
from bench.models.recipe import behind

BEGUN_S = (0.7, 2.0, np.inf)  # of training touches, from their start, that the system for beginnings learns from
SHIFTS_S = (-0.125, 0.0, 0.125)  # of their starts: a detector is early or late
WHOLE_S = 1.4  # from this age on, a touch is named by the system for whole touches
LONGEST_S = 4.0  # of a touch that is named: the last so many seconds of a longer one


def touches(recordings: Recordings, seconds: Sequence[float], shifts: Sequence[float]) -> Corpus:
    """All touches as captures, cut to each of some lengths from their start, which is shifted by each of some times.

    Args:
        recordings: recordings with their events.
        seconds: most seconds of a touch.
        shifts: seconds by which its start is moved; it stays before its end.
    """
    corpus, events = recordings.corpus, recordings.events
    recording, start, end = (events[name].to_numpy(np.int64) for name in ("recording", "start", "end"))
    longest = int(corpus.lengths.max())
    lengths = np.clip(np.round(np.multiply(seconds, corpus.rate_hz)), 2, longest).astype(np.int64)
    moved = np.unique(np.round(np.multiply(shifts, corpus.rate_hz)).astype(np.int64))
    length, shift = (each.reshape(-1, 1) for each in np.meshgrid(lengths, moved))
    begin = np.clip(start + shift, 0, end - 1)
    count = np.maximum(np.minimum(start + length, end) - begin, 1)
    event = np.tile(np.arange(len(events)), len(begin))
    table = corpus.captures.iloc[recording[event]].reset_index(drop=True)
    return corpus.changed(
        starts=storage(corpus)[1][recording[event]] + begin.ravel(),
        lengths=count.ravel(),
        captures=table.assign(gesture=events["gesture"].to_numpy()[event]),
        index=np.arange(len(event)),
        piece=np.zeros(len(event), dtype=np.int64),
        digest="",
        path=None,
    )


@dataclass(eq=False)
class Names:
    """What names touches.

    Attributes:
        begun: fitted to the beginnings of training touches.
        whole: fitted to whole training touches.
    """

    begun: contract.System
    whole: contract.System

    @classmethod
    def learned(cls, make_system: Callable[[], contract.System], recordings: Recordings) -> Self:
        """Learn from recordings of training subjects."""
        parts = touches(recordings, BEGUN_S, SHIFTS_S), touches(recordings, (np.inf,), (0.0,))
        return cls(*(make_system().fit(part, part.gestures) for part in parts))

    @property
    def gestures(self) -> np.ndarray:
        """Gestures in the order of their probabilities."""
        return np.asarray(self.whole.classes_).astype(str)

    def probabilities(self, recording: Corpus, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Probabilities of the gestures in some spans of one recording, float32 [spans, gestures].

        Args:
            recording: one recording, after the steps that are done frame by frame.
            begin: first frames of the spans, int64 [spans].
            end: frames behind the last ones.
        """
        rate_hz = recording.rate_hz
        whole = end - begin >= WHOLE_S * rate_hz
        begin = np.maximum(begin, end - max(1, round(LONGEST_S * rate_hz)))
        found = np.empty((len(begin), len(self.gestures)), np.float32)
        for system, some in ((self.begun, ~whole), (self.whole, whole)):
            if some.any():
                spans = recording[np.zeros(some.sum(), np.int64)]
                starts = storage(recording)[1][0] + begin[some]
                spans = spans.changed(starts=starts, lengths=(end - begin)[some], digest="", path=None)
                found[some] = contract.probabilities(behind(system)[1], spans)
        return found
