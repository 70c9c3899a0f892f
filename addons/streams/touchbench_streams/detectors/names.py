"""Names of touches as they grow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import COPY, Corpus, shared_frames
from bench.corpora.windows import Step
from bench.features.signals import capture_blocks
from bench.models.recipe import apply_steps, split_causal_steps, split_training
from touchbench_streams.disturbed import NAMING_KINDS, disturb_recordings
from touchbench_streams.recordings import Recordings

BEGINNINGS_S = (0.7, 2.0, np.inf)  # of training touches, that a system learns from
DAMAGED_S = (0.7, np.inf)  # the same of damaged copies of touches, which are many
SHIFTS_S = (-0.125, 0.0, 0.125)  # of their starts, as a detector is early or late
BLOCK_VALUES = 1 << 20  # readings of touches that are damaged at once
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
    damaging, steps, recipe = split_training(make_system())
    # with the frames of these recordings alone
    corpus = recordings.corpus.with_fields(frames=recordings.corpus.frames)
    recordings = Recordings(corpus, recordings.events)
    return recipe.fit_parts(_training_parts(recordings, damaging, steps))


def _training_parts(
    recordings: Recordings, damaging: Sequence[Step], steps: Sequence[Step]
) -> Iterator[Corpus]:
    """Yield the touches that names are learned from, after steps, in parts that fit in memory."""
    count = 0
    for cuts, copy in _cut_after_steps(recordings, damaging, steps):
        index = np.arange(count, count + len(cuts))
        piece = np.full(len(cuts), copy * COPY)
        count += len(cuts)
        yield cuts.with_fields(index=index, piece=piece, steps=(*damaging, *steps))


def _cut_after_steps(
    recordings: Recordings, damaging: Sequence[Step], steps: Sequence[Step]
) -> Iterator[tuple[Corpus, int]]:
    """Yield beginnings of touches after steps, and 1 for those of damaged copies, 0 for others."""
    corpus, events = recordings.corpus, recordings.events
    stepped = Recordings(apply_steps(corpus, [*steps])[0], events)
    yield cut_touches(stepped, BEGINNINGS_S, SHIFTS_S), 0
    for k, (kind, shift) in enumerate(zip(NAMING_KINDS, SHIFTS_S, strict=True)):
        half = np.arange(k % 2, len(corpus), 2)
        if len(half):
            disturbed = apply_steps(disturb_recordings(corpus, kind, half), [*steps])[0]
            copy = Recordings(disturbed, recordings[half].events)
            yield cut_touches(copy, BEGINNINGS_S, (shift,)), 0
    if not damaging:
        return
    touches = cut_touches(recordings, (np.inf,), (0.0,))
    for block in capture_blocks(touches, BLOCK_VALUES):
        copies = apply_steps(touches[block], [*damaging])[0]
        copies = apply_steps(copies[copies.piece >= COPY], [*steps])[0]
        ends = {"recording": np.arange(len(copies)), "start": 0, "end": copies.lengths}
        events = pd.DataFrame(ends).assign(gesture=copies.gestures)
        yield cut_touches(Recordings(copies, events), DAMAGED_S, (0.0,)), 1


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
