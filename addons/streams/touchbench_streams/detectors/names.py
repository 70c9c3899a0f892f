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

BEGINNINGS_S = (0.7, 2.0, np.inf)  # of training touches, that a system learns from
SHIFTS_S = (-0.125, 0.0, 0.125)  # of their starts, as a detector is early or late
LONGEST_S = 3.0  # of a part that a touch is named from; chosen on HAART among 2, 3 and 4


def cut_touches(
    recordings: Recordings, seconds: Sequence[float], shifts: Sequence[float]
) -> Corpus:
    """Cut all touches to each of some lengths from their start, shifted by each of some times."""
    corpus, events = recordings.corpus, recordings.events
    recording, start, end = (
        events[name].to_numpy(np.int64) for name in ("recording", "start", "end")
    )
    longest = int(corpus.lengths.max())
    lengths = np.clip(np.round(np.multiply(seconds, corpus.rate_hz)), 2, longest).astype(np.int64)
    frame_shifts = np.unique(np.round(np.multiply(shifts, corpus.rate_hz)).astype(np.int64))
    length, shift = (values.reshape(-1, 1) for values in np.meshgrid(lengths, frame_shifts))
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
    """Ticks of ``count`` frames in the longest part that a touch is named from."""
    return max(1, round(LONGEST_S * rate_hz / count))


def fit_names(
    make_system: Callable[[], contract.System], recordings: Recordings
) -> contract.System:
    """Fit a system that names touches to beginnings of touches and to whole touches.

    It also learns from every second recording with each kind of disturbance, with a shift for each
    kind.
    """
    # with the frames of these recordings alone
    corpus = recordings.corpus.with_fields(frames=recordings.corpus.frames)
    parts = [cut_touches(Recordings(corpus, recordings.events), BEGINNINGS_S, SHIFTS_S)]
    for k, (kind, shift) in enumerate(zip(NAMING_KINDS, SHIFTS_S, strict=True)):
        half = np.arange(k % 2, len(corpus), 2)
        if len(half):
            copy = Recordings(disturb_recordings(corpus, kind, half), recordings[half].events)
            parts.append(cut_touches(copy, BEGINNINGS_S, (shift,)))
    frames, starts, first = [], [], 0
    for part_frames, part_starts in map(shared_frames, parts):
        frames.append(part_frames)
        starts.append(first + part_starts)
        first += len(part_frames)
    count = sum(map(len, parts))
    captures = corpus.with_fields(
        frames=np.concatenate(frames),
        starts=np.concatenate(starts),
        lengths=np.concatenate([part.lengths for part in parts]),
        captures=pd.concat([part.captures for part in parts], ignore_index=True),
        index=np.arange(count),
        piece=np.zeros(count, np.int64),
        digest="",
        path=None,
    )
    return make_system().fit(captures, captures.gestures)


def name_probabilities(
    system: contract.System, recording: Corpus, begin: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Probabilities of gestures from spans of one recording, float32 [spans, gestures]."""
    spans = recording
    if len(begin) > 1:  # this copies the table
        spans = recording[np.zeros(len(begin), np.int64)]
    starts = shared_frames(recording)[1][0] + begin
    spans = spans.with_fields(starts=starts, lengths=end - begin, digest="", path=None)
    return contract.predict_probabilities(split_causal_steps(system)[1], spans).astype(np.float32)
