"""Names of touches as they grow: one system for their beginnings, and one for whole touches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from bench import contract
from bench.corpora.corpus import Corpus, storage
from bench.corpora.recordings import Recordings
from bench.models.recipe import behind

BEGUN_S = (0.7, 2.0)  # of training touches, from their start, that the system for beginnings learns from
SHIFTS_S = (-0.125, 0.0, 0.125)  # of their starts: a detector is early or late
WHOLE_S = 1.4  # from this age on, a touch is named by the system for whole touches
LONGEST_S = 4.0  # of a touch that is named: the last so many seconds of a longer one


def beginnings(recordings: Recordings) -> Corpus:
    """The beginnings of all touches as captures, each in all lengths of `BEGUN_S` with all shifts of `SHIFTS_S`."""
    corpus, events = recordings.corpus, recordings.events
    recording, start, end = (events[name].to_numpy() for name in ("recording", "start", "end"))
    lengths, shifts = (
        np.round(np.multiply(seconds, corpus.rate_hz)).astype(np.int64) for seconds in (BEGUN_S, SHIFTS_S)
    )
    length, shift = (each.ravel()[:, None] for each in np.meshgrid(np.maximum(2, lengths), np.unique(shifts)))
    begin = np.clip(start + shift, 0, end - 1)
    until = np.maximum(np.minimum(start + length, end), begin + 1)
    event = np.broadcast_to(np.arange(len(events)), begin.shape).ravel()
    table = corpus.captures.iloc[recording[event]].reset_index(drop=True)
    return corpus.changed(
        starts=storage(corpus)[1][recording[event]] + begin.ravel(),
        lengths=(until - begin).ravel(),
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
        whole: fitted to training captures.
        background: names of classes that are no gesture.
    """

    begun: contract.System
    whole: contract.System
    background: tuple[str, ...]

    @classmethod
    def learned(
        cls, make_system: Callable[[], contract.System], whole: contract.System, recordings: Recordings
    ) -> Self:
        """Learn the beginnings from recordings of training subjects; the other system is fitted already."""
        touches = beginnings(recordings)
        background = {*np.asarray(whole.classes_).astype(str)} - {*recordings.events["gesture"].astype(str)}
        return cls(make_system().fit(touches, touches.gestures), whole, tuple(sorted(background)))

    @property
    def gestures(self) -> np.ndarray:
        """Gestures that are named, in the order of the classes."""
        classes = np.asarray(self.whole.classes_).astype(str)
        return classes[~np.isin(classes, self.background)]

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
                inner = behind(system)[1]
                kept = ~np.isin(np.asarray(inner.classes_).astype(str), self.background)
                found[some] = contract.probabilities(inner, spans)[:, kept]
        return found / np.maximum(found.sum(axis=1, keepdims=True), 1e-9)
