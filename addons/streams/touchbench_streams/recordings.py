"""Recordings: continuous streams of touch with a table of their events.

They are stored as captures, one for each event, doubtful stretch and gap, and are put together
again to be watched.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.library import ASIDE, UNTAUGHT
from bench.corpora.spellings import find_background_words
from bench.errors import InputError

COLUMNS = ("recording", "start", "end", "gesture")
GAP = "background"  # class of the captures between events; no gesture
DOUBT = "?"  # label of frames that count neither as touch nor as background
RECORDINGS = "recordings"  # key of the corpus's info: the first capture of each recording


@dataclass(frozen=True, eq=False)
class Recordings:
    """Continuous recordings of touch, and the events in them; all other time is background.

    Attributes:
        corpus: one capture per recording; its table has ``subject``, ``gesture`` (always empty)
            and conditions.
        labelled: one row per event or doubtful stretch (labelled ``?``, neither touch nor
            background), sorted by recording and start: ``recording`` (position in ``corpus``),
            ``start`` and ``end`` (frames from the start of the recording, end exclusive), all
            int64, and ``gesture`` (str). Rows of a recording do not overlap.
    """

    corpus: Corpus
    labelled: pd.DataFrame

    @cached_property
    def events(self) -> pd.DataFrame:
        """The rows of events."""
        return self.labelled[self.labelled["gesture"] != DOUBT].reset_index(drop=True)

    @cached_property
    def doubtful(self) -> pd.DataFrame:
        """The rows of doubtful stretches."""
        return self.labelled[self.labelled["gesture"] == DOUBT].reset_index(drop=True)

    def __len__(self) -> int:
        return len(self.corpus)

    def __getitem__(self, key: int | slice | np.ndarray | list) -> Recordings:
        """Select recordings with their events; ``recording`` counts from 0 again."""
        positions = np.atleast_1d(np.arange(len(self))[key])
        rows = [np.flatnonzero(self.labelled["recording"] == position) for position in positions]
        labelled = self.labelled.iloc[np.concatenate([np.zeros(0, np.int64), *rows])]
        labelled = labelled.reset_index(drop=True)
        labelled["recording"] = np.repeat(np.arange(len(positions)), [len(r) for r in rows])
        return Recordings(self.corpus[positions], labelled)

    @property
    def subjects(self) -> np.ndarray:
        """Subject of each recording [recordings]."""
        return self.corpus.subjects

    def background_frames(self) -> np.ndarray:
        """Number of frames outside events and doubtful stretches, int64 [recordings]."""
        labelled = self.labelled
        counts = (labelled["end"] - labelled["start"]).groupby(labelled["recording"]).sum()
        counts = counts.reindex(range(len(self)), fill_value=0)
        return self.corpus.lengths - counts.to_numpy(dtype=np.int64)

    def frame_labels(self) -> np.ndarray:
        """Gesture of each frame of all recordings, ``""`` for background, object [frames]."""
        labels = np.full(int(self.corpus.lengths.sum()), "", dtype=object)
        firsts = np.cumsum(self.corpus.lengths) - self.corpus.lengths
        for recording, start, end, gesture in self.labelled[[*COLUMNS]].itertuples(index=False):
            labels[firsts[recording] + start : firsts[recording] + end] = gesture
        return labels


def find_events(labels: np.ndarray, lengths: np.ndarray) -> pd.DataFrame:
    """The table of `Recordings`: a row for each run of equal labels within a recording.

    Args:
        labels: gesture of each frame; None, ``""`` or another word for background
            (`bench.corpora.spellings.find_background_words`); object [frames].
        lengths: number of frames of each recording, at least 1, int64 [recordings].
    """
    column = pd.Series(np.asarray(labels, dtype=object), dtype=object)
    background = find_background_words(column.dropna().unique().tolist())
    codes, gestures = pd.factorize(column.mask(column.isin(background)))  # -1 for background
    firsts = np.cumsum(lengths) - lengths
    changes = np.append(True, codes[1:] != codes[:-1])[: len(codes)]
    changes[firsts] = True
    starts = np.flatnonzero(changes)
    ends = np.append(starts[1:], len(codes))[: len(starts)]
    is_touch = codes[starts] >= 0
    starts, ends = starts[is_touch], ends[is_touch]
    recording = np.searchsorted(firsts, starts, side="right") - 1
    first, gesture = firsts[recording], gestures[codes[starts]]
    return event_table(zip(recording, starts - first, ends - first, gesture, strict=True))


def event_table(rows: Iterable[tuple[int, int, int, str]]) -> pd.DataFrame:
    """The table of `Recordings` from rows (recording, start, end, gesture), in its types."""
    kinds = {name: np.int64 for name in COLUMNS[:3]} | {"gesture": str}
    return pd.DataFrame(list(rows), columns=[*COLUMNS]).astype(kinds)


def cut_into_captures(recordings: Recordings) -> Corpus:
    """Cut recordings into captures, one per event, doubtful stretch and gap; no frame is copied.

    The class of a gap is ``background``, that of a doubtful stretch ``?``. The table has the
    conditions of the recordings, and their names or else positions as ``recording``. Runs on
    captures use the events alone.
    """
    lengths, labelled = recordings.corpus.lengths, recordings.labelled
    for i in np.flatnonzero(labelled["gesture"] == GAP):
        recording, start, end = labelled.iloc[i][["recording", "start", "end"]]
        raise InputError(
            f"events of {recordings.corpus.name}: event {i} (recording {recording}, frames {start} "
            f"to {end}) is called {GAP}, but time between touches has an empty label; correct it"
        )
    labels = pd.Series(recordings.frame_labels())
    firsts = np.cumsum(lengths) - lengths
    recording = np.repeat(np.arange(len(recordings)), lengths)
    begins = np.append(True, recording[1:] != recording[:-1])
    first = firsts[labelled["recording"]]
    ends = (first + labelled["end"]).to_numpy()
    is_edge = begins.copy()
    is_edge[(first + labelled["start"]).to_numpy()] = True
    is_edge[ends[ends < len(is_edge)]] = True
    starts = np.flatnonzero(is_edge)
    table = recordings.corpus.captures.iloc[recording[starts]].reset_index(drop=True)
    table = table.assign(gesture=labels[starts].replace("", GAP).to_numpy())
    if "recording" not in table:
        table["recording"] = recording[starts]
    recording_starts = shared_frames(recordings.corpus)[1]
    info = {
        RECORDINGS: np.flatnonzero(begins[starts]).tolist(),
        ASIDE: [GAP, DOUBT],
        UNTAUGHT: [DOUBT],
    }
    return recordings.corpus.with_fields(
        starts=(recording_starts - firsts)[recording[starts]] + starts,
        lengths=np.append(starts[1:], len(is_edge))[: len(starts)] - starts,
        captures=table,
        index=np.arange(len(starts)),
        piece=np.zeros(len(starts), dtype=np.int64),
        path=None,
        info=recordings.corpus.info | info,
    )


def convert_recordings(design: Any, captures: Corpus) -> Corpus:
    """Captures of `cut_into_captures` as a skin of a design measures their recordings.

    A recording is converted as a whole. Captures begin at the nearest frames, and have one at
    least.

    Raises:
        InputError: the design cannot be made of the recorded skin, or has too few frames.
    """
    firsts = np.array(captures.info[RECORDINGS])
    whole = captures[firsts].with_fields(lengths=np.add.reduceat(captures.lengths, firsts))
    converted = design.convert(whole)
    rate = converted.rate_hz / captures.rate_hz
    parts = np.split(captures.lengths, firsts[1:])
    starts, lengths = [], []
    for first, total, part in zip(converted.starts, converted.lengths, parts, strict=True):
        place = np.arange(len(part))
        start = np.round((np.cumsum(part) - part) * rate).astype(np.int64)
        start = np.maximum.accumulate(start - place) + place
        start = np.minimum(start, total - len(part) + place)
        if start[0] < 0:
            raise InputError(
                f"skin.rate_hz={design.rate_hz:g}: a recording has {len(part)} touches and gaps, "
                f"and {total} frames at this rate; give a higher one"
            )
        starts.append(first + start)
        lengths.append(np.diff(start, append=total))
    return converted.with_fields(
        starts=np.concatenate(starts),
        lengths=np.concatenate(lengths),
        captures=captures.captures,
        index=captures.index,
        piece=captures.piece,
    )


def drop_doubtful(captures: Corpus) -> Corpus:
    """Drop doubtful stretches from captures of `cut_into_captures`; return others unchanged."""
    return captures[captures.gestures != DOUBT] if comes_from_recordings(captures) else captures


def restore_recordings(captures: Corpus) -> Recordings:
    """Put the captures of `cut_into_captures` together again.

    If captures of a recording are missing, such as doubtful stretches in training, each part
    without a gap becomes a recording: nothing learns from a frame in between, or takes the frame
    after it for the next one. The table has ``subject``, ``gesture`` and ``recording``, the number
    of the original.
    """
    number = np.searchsorted(captures.info[RECORDINGS], captures.index, side="right") - 1
    table = captures.captures.assign(
        recording=number, start=shared_frames(captures)[1], length=captures.lengths
    )
    table = table.sort_values(["recording", "start"])
    previous_end = (table["start"] + table["length"]).shift()
    is_new = table["recording"] != table["recording"].shift()
    part = (is_new | (table["start"] != previous_end)).cumsum() - 1
    groups = table.groupby(part, sort=True)
    first = groups["start"].min()
    start = (table["start"] - part.map(first)).to_numpy()
    rows = zip(part, start, start + table["length"], table["gesture"], strict=True)
    labelled = event_table(row for row in rows if row[-1] != GAP)
    captures_table = pd.DataFrame({"subject": groups["subject"].first().to_numpy(), "gesture": ""})
    corpus = captures.with_fields(
        starts=first.to_numpy(),
        lengths=groups["length"].sum().to_numpy(),
        captures=captures_table.assign(recording=groups["recording"].first().to_numpy()),
        index=np.arange(len(first)),
        piece=np.zeros(len(first), dtype=np.int64),
    )
    return Recordings(corpus, labelled)


def comes_from_recordings(captures: Corpus) -> bool:
    """Return True for captures that `cut_into_captures` has cut from recordings."""
    return RECORDINGS in captures.info
