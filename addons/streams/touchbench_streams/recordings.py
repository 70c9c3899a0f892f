"""Recordings: continuous streams of touch with a table of their events.

They are stored as captures, one for each event, doubtful stretch and gap, and put together again to be watched.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.library import ASIDE, UNTAUGHT
from bench.errors import InputError

COLUMNS = ("recording", "start", "end", "gesture")
BACKGROUND = ("", "None", "none")  # labels of frames outside of events
GAP = "background"  # class of the captures between the events of a recording, so no gesture
DOUBT = "?"  # label of frames that count neither as touch nor as background
RECORDINGS = "recordings"  # in the corpus's info: the first capture of each


@dataclass(frozen=True, eq=False)
class Recordings:
    """Continuous recordings of touch, and the events in them; all other time is background, or doubtful.

    Attributes:
        corpus: one capture per recording, whole; its table has ``subject``, ``gesture`` (always empty) and conditions.
        labelled: one row per event or stretch that is labelled ``?``, neither touch nor background, sorted by recording
            and start: ``recording`` (position in ``corpus``), ``start`` and ``end`` (frames from the start of the
            recording, end exclusive), all int64, and ``gesture`` (str). Those of a recording do not overlap.
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
        """Some of the recordings, with their events; ``recording`` counts from 0 again."""
        chosen, labelled = np.atleast_1d(np.arange(len(self))[key]), self.labelled
        rows = [np.flatnonzero(labelled["recording"] == old) for old in chosen]
        mine = labelled.iloc[np.concatenate([np.zeros(0, np.int64), *rows])].reset_index(drop=True)
        mine["recording"] = np.repeat(np.arange(len(chosen)), [len(r) for r in rows])
        return Recordings(self.corpus[chosen], mine)

    @property
    def subjects(self) -> np.ndarray:
        """Subject of each recording [recordings]."""
        return self.corpus.subjects

    def background_frames(self) -> np.ndarray:
        """Number of frames outside of events and doubtful stretches, int64 [recordings]."""
        labelled = self.labelled
        touched = (labelled["end"] - labelled["start"]).groupby(labelled["recording"]).sum()
        return self.corpus.lengths - touched.reindex(range(len(self)), fill_value=0).to_numpy(
            dtype=np.int64
        )

    def frame_labels(self) -> np.ndarray:
        """Gesture of each frame, object [frames], ``""`` for background: the recordings one after another."""
        labels = np.full(int(self.corpus.lengths.sum()), "", dtype=object)
        firsts = np.cumsum(self.corpus.lengths) - self.corpus.lengths
        for recording, start, end, gesture in self.labelled[[*COLUMNS]].itertuples(index=False):
            labels[firsts[recording] + start : firsts[recording] + end] = gesture
        return labels


def find_events(labels: np.ndarray, lengths: np.ndarray) -> pd.DataFrame:
    """The table of `Recordings` from a label per frame: each run of equal labels within a recording is one.

    Args:
        labels: object [frames], the gesture, or ``""``, None, ``"None"`` or ``"none"`` for background.
        lengths: int64 [recordings], number of frames of each recording, at least 1; they lie one after another.
    """
    words = pd.Series(np.asarray(labels, dtype=object), dtype=object)
    codes, gestures = pd.factorize(words.mask(words.isin(BACKGROUND)))  # -1 for background
    firsts = np.cumsum(lengths) - lengths
    changes = np.append(True, codes[1:] != codes[:-1])[: len(codes)]
    changes[firsts] = True
    starts = np.flatnonzero(changes)
    ends = np.append(starts[1:], len(codes))[: len(starts)]
    touched = codes[starts] >= 0
    starts, ends = starts[touched], ends[touched]
    recording = np.searchsorted(firsts, starts, side="right") - 1
    columns = (
        recording,
        starts - firsts[recording],
        ends - firsts[recording],
        gestures[codes[starts]],
    )
    return event_table(zip(*columns, strict=True))


def event_table(rows: Iterable[tuple[int, int, int, str]]) -> pd.DataFrame:
    """The table of `Recordings` from rows (recording, start, end, gesture), in the types that they have."""
    kinds = {name: np.int64 for name in COLUMNS[:3]} | {"gesture": str}
    return pd.DataFrame(list(rows), columns=[*COLUMNS]).astype(kinds)


def cut_into_captures(recordings: Recordings) -> Corpus:
    """Recordings as captures: one per event, doubtful stretch and gap between them; no frame is copied.

    The class of a gap is ``background``, that of a doubtful stretch ``?``. The table has the conditions of the
    recordings, and as ``recording`` their names or, without, their positions. Runs on captures use the events alone.
    """
    lengths, labelled = recordings.corpus.lengths, recordings.labelled
    for i in np.flatnonzero(labelled["gesture"] == GAP):
        recording, start, end = labelled.iloc[i][["recording", "start", "end"]]
        raise InputError(
            f"events of {recordings.corpus.name}: event {i} (recording {recording}, frames {start} to {end}) is called "
            f"{GAP}, but time between touches has an empty label; correct it"
        )
    labels = pd.Series(recordings.frame_labels())
    firsts = np.cumsum(lengths) - lengths
    recording = np.repeat(np.arange(len(recordings)), lengths)
    begins = np.append(True, recording[1:] != recording[:-1])
    edges = begins.copy()
    edges[(firsts[labelled["recording"]] + labelled["start"]).to_numpy()] = True
    ends = (firsts[labelled["recording"]] + labelled["end"]).to_numpy()
    edges[ends[ends < len(edges)]] = True
    starts = np.flatnonzero(edges)
    table = recordings.corpus.captures.iloc[recording[starts]].reset_index(drop=True)
    table = table.assign(gesture=labels[starts].replace("", GAP).to_numpy())
    if "recording" not in table:
        table["recording"] = recording[starts]
    return recordings.corpus.with_fields(
        starts=shared_frames(recordings.corpus)[1][recording[starts]]
        + starts
        - firsts[recording[starts]],
        lengths=np.append(starts[1:], len(edges))[: len(starts)] - starts,
        captures=table,
        index=np.arange(len(starts)),
        piece=np.zeros(len(starts), dtype=np.int64),
        path=None,
        info=recordings.corpus.info
        | {
            RECORDINGS: np.flatnonzero(begins[starts]).tolist(),
            ASIDE: [GAP, DOUBT],
            UNTAUGHT: [DOUBT],
        },
    )


def drop_doubtful(captures: Corpus) -> Corpus:
    """Captures from `cut_into_captures` without doubtful stretches; any other captures as they are."""
    return captures[captures.gestures != DOUBT] if comes_from_recordings(captures) else captures


def restore_recordings(captures: Corpus) -> Recordings:
    """The recordings that `cut_into_captures` has cut, with ``subject``, ``gesture`` and, as ``recording``, their number.

    A recording of which captures are missing, such as doubtful stretches in training, becomes one recording for each
    part without a gap: nothing that learns from it sees a frame in between, or a frame beyond as if it came next.
    """
    number = np.searchsorted(captures.info[RECORDINGS], captures.index, side="right") - 1
    table = captures.captures.assign(
        recording=number, start=shared_frames(captures)[1], length=captures.lengths
    )
    table = table.sort_values(["recording", "start"])
    same = table["recording"] == table["recording"].shift()
    part = ((table["start"] != (table["start"] + table["length"]).shift()) | ~same).cumsum() - 1
    groups = table.groupby(part, sort=True)
    first = groups["start"].min()
    start = (table["start"] - part.map(first)).to_numpy()
    labelled = (table["gesture"] != GAP).to_numpy()
    events = zip(part, start, start + table["length"], table["gesture"], strict=True)
    whole = pd.DataFrame({"subject": groups["subject"].first().to_numpy(), "gesture": ""})
    corpus = captures.with_fields(
        starts=first.to_numpy(),
        lengths=groups["length"].sum().to_numpy(),
        captures=whole.assign(recording=groups["recording"].first().to_numpy()),
        index=np.arange(len(first)),
        piece=np.zeros(len(first), dtype=np.int64),
    )
    return Recordings(
        corpus, event_table([event for event, kept in zip(events, labelled, strict=True) if kept])
    )


def comes_from_recordings(captures: Corpus) -> bool:
    """Return True for captures that `cut_into_captures` has cut from recordings."""
    return RECORDINGS in captures.info
