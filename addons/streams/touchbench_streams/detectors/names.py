"""Names of touches as they grow."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus, shared_frames
from bench.models.recipe import split_causal_steps
from touchbench_streams.disturbed import NAMING_KINDS, disturb_recordings
from touchbench_streams.recordings import Recordings

BEGUN_S = (0.7, 2.0, np.inf)  # of training touches, from their start, that a system learns from
SHIFTS_S = (-0.125, 0.0, 0.125)  # of their starts: a detector is early or late
LONGEST_S = 3.0  # of a part of a touch that names come from; chosen on HAART among 2, 3 and 4


def cut_touches(
    recordings: Recordings, seconds: Sequence[float], shifts: Sequence[float]
) -> Corpus:
    """All touches as captures, cut to each of some lengths from their start, which each of some times shifts."""
    corpus, events = recordings.corpus, recordings.events
    recording, start, end = (
        events[name].to_numpy(np.int64) for name in ("recording", "start", "end")
    )
    longest = int(corpus.lengths.max())
    lengths = np.clip(np.round(np.multiply(seconds, corpus.rate_hz)), 2, longest).astype(np.int64)
    moved = np.unique(np.round(np.multiply(shifts, corpus.rate_hz)).astype(np.int64))
    length, shift = (each.reshape(-1, 1) for each in np.meshgrid(lengths, moved))
    begin = np.clip(start + shift, 0, end - 1)
    count = np.maximum(np.minimum(start + length, end) - begin, 1)
    event = np.tile(np.arange(len(events)), len(begin))
    table = corpus.captures.iloc[recording[event]].reset_index(drop=True)
    return corpus.with_fields(
        starts=shared_frames(corpus)[1][recording[event]] + begin.ravel(),
        lengths=count.ravel(),
        captures=table.assign(gesture=events["gesture"].to_numpy()[event]),
        index=np.arange(len(event)),
        piece=np.zeros(len(event), dtype=np.int64),
        digest="",
        path=None,
    )


def longest_part(rate_hz: float, count: int) -> int:
    """Ticks of so many frames of the longest part of a touch that names come from."""
    return max(1, round(LONGEST_S * rate_hz / count))


def fit_names(
    make_system: Callable[[], contract.System], recordings: Recordings
) -> contract.System:
    """A system that names touches, fitted to beginnings of touches and to whole ones.

    It also learns from every second recording as each kind of disturbed sensor shows it, with a shift for each kind.
    """
    corpus = recordings.corpus.with_fields(
        frames=recordings.corpus.frames
    )  # these recordings alone
    parts = [cut_touches(Recordings(corpus, recordings.events), BEGUN_S, SHIFTS_S)]
    for k, (kind, shift) in enumerate(zip(NAMING_KINDS, SHIFTS_S, strict=True)):
        if len(half := np.arange(k % 2, len(corpus), 2)):
            copy = Recordings(disturb_recordings(corpus, kind, half), recordings[half].events)
            parts.append(cut_touches(copy, BEGUN_S, (shift,)))
    frames, starts = zip(*map(shared_frames, parts), strict=True)
    before = np.cumsum([0, *map(len, frames)])
    count = sum(map(len, parts))
    both = corpus.with_fields(
        frames=np.concatenate(frames),
        starts=np.concatenate(
            [first + each for first, each in zip(before[:-1], starts, strict=True)]
        ),
        lengths=np.concatenate([part.lengths for part in parts]),
        captures=pd.concat([part.captures for part in parts], ignore_index=True),
        index=np.arange(count),
        piece=np.zeros(count, np.int64),
        digest="",
        path=None,
    )
    return make_system().fit(both, both.gestures)


def name_probabilities(
    system: contract.System, recording: Corpus, begin: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Probabilities of the gestures from frames ``begin`` to ``end`` of one recording, float32 [spans, gestures]."""
    spans = (
        recording if len(begin) == 1 else recording[np.zeros(len(begin), np.int64)]
    )  # which copies the table
    starts = shared_frames(recording)[1][0] + begin
    spans = spans.with_fields(starts=starts, lengths=end - begin, digest="", path=None)
    return contract.predict_probabilities(split_causal_steps(system)[1], spans).astype(np.float32)
