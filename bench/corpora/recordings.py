"""Recordings: continuous streams of touch with a table of their events. A value, like the Corpus; it knows no disk."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, storage
from bench.errors import InputError

COLUMNS = ("recording", "start", "end", "gesture")
BACKGROUND = ("", "None", "none")  # labels of frames outside of events
GAP = "background"  # class of the captures between the events of a recording, so no gesture
RECORDED = "cut from recordings"  # in the corpus's info


@dataclass(frozen=True, eq=False)
class Recordings:
    """Continuous recordings of touch, and the events in them; all other time is background.

    Attributes:
        corpus: one capture per recording, whole; its table has ``subject``, ``gesture`` (always empty) and conditions.
        events: one row per event, sorted by recording and start: ``recording`` (position in ``corpus``), ``start`` and
            ``end`` (frames from the start of the recording, end exclusive), all int64, and ``gesture`` (str). Events
            of a recording do not overlap.
    """

    corpus: Corpus
    events: pd.DataFrame

    def __len__(self) -> int:
        return len(self.corpus)

    def __getitem__(self, key: int | slice | np.ndarray | list) -> Recordings:
        """Some of the recordings, with their events; ``recording`` counts from 0 again."""
        chosen = np.atleast_1d(np.arange(len(self))[key])
        rows = [np.flatnonzero(self.events["recording"] == old) for old in chosen]
        events = self.events.iloc[np.concatenate([np.zeros(0, np.int64), *rows])].reset_index(drop=True)
        events["recording"] = np.repeat(np.arange(len(chosen)), [len(r) for r in rows])
        return Recordings(self.corpus[chosen], events)

    @property
    def subjects(self) -> np.ndarray:
        """Subject of each recording, str [recordings]."""
        return self.corpus.subjects

    def background_frames(self) -> np.ndarray:
        """Number of frames outside of events, int64 [recordings]."""
        touched = (self.events["end"] - self.events["start"]).groupby(self.events["recording"]).sum()
        return self.corpus.lengths - touched.reindex(range(len(self)), fill_value=0).to_numpy(dtype=np.int64)

    def frame_labels(self) -> np.ndarray:
        """Gesture of each frame, ``""`` for background, object [frames]: the recordings one after another."""
        labels = np.full(int(self.corpus.lengths.sum()), "", dtype=object)
        firsts = np.cumsum(self.corpus.lengths) - self.corpus.lengths
        for recording, start, end, gesture in self.events[[*COLUMNS]].itertuples(index=False):
            labels[firsts[recording] + start : firsts[recording] + end] = gesture
        return labels

    def check(self) -> None:
        """Refuse events that cannot be.

        Raises:
            InputError: a column is missing; an event is empty, without a gesture, out of range, out of order, or
                overlaps another one. The message names the first such event.
        """
        if missing := [name for name in COLUMNS if name not in self.events]:
            raise InputError(f"events of {self.corpus.name}: no column {', '.join(missing)}; add it")
        recording, start, end = (self.events[name].to_numpy() for name in COLUMNS[:3])
        if any(column.dtype != np.int64 for column in (recording, start, end)):
            raise InputError(f"events of {self.corpus.name}: recording, start and end must be int64; convert them")
        known = (recording >= 0) & (recording < len(self))
        lengths = np.where(known, np.append(self.corpus.lengths, 0)[np.where(known, recording, -1)], 0)
        same = recording[1:] == recording[:-1]
        sorted_ = (recording[1:] > recording[:-1]) | (same & (start[1:] >= start[:-1]))
        for wrong, reason in (
            (~known, f"there are {len(self)} recordings, counted from 0"),
            (start < 0, "starts before its recording"),
            (end <= start, "has no frames; end must be above start"),
            (end > lengths, "ends after its recording"),
            (self.events["gesture"].isin(BACKGROUND) | self.events["gesture"].isna(), "has no gesture"),
            (self.events["gesture"] == GAP, f"is called {GAP}, but time between touches has an empty label"),
            (np.append(False, ~sorted_)[: len(start)], "comes too late; sort events by recording and start"),
            (np.append(False, same & (start[1:] < end[:-1]))[: len(start)], "overlaps the event before it"),
        ):
            if len(rows := np.flatnonzero(wrong)):
                i = rows[0]
                where = f"recording {recording[i]}, frames {start[i]} to {end[i]}"
                raise InputError(f"events of {self.corpus.name}: event {i} ({where}) {reason}; correct it")


def events_of(labels: np.ndarray, lengths: np.ndarray) -> pd.DataFrame:
    """Events from a label per frame: each run of equal labels within a recording is one.

    Two touches of the same gesture without background between them are one event.

    Args:
        labels: object [frames], the gesture, or ``""``, None, ``"None"`` or ``"none"`` for background.
        lengths: int64 [recordings], number of frames of each recording, at least 1; the recordings lie one after
            another.

    Returns:
        The ``events`` of `Recordings`.
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
    columns = (recording, starts - firsts[recording], ends - firsts[recording], gestures[codes[starts]])
    return event_table(zip(*columns, strict=True))


def event_table(rows: Iterable[tuple[int, int, int, str]]) -> pd.DataFrame:
    """The ``events`` of `Recordings` from rows (recording, start, end, gesture), in the types that they have."""
    kinds = {name: np.int64 for name in COLUMNS[:3]} | {"gesture": str}
    return pd.DataFrame(list(rows), columns=[*COLUMNS]).astype(kinds)


def captures_in(recordings: Recordings) -> Corpus:
    """Recordings as captures, one per event and one per gap between events; no frame is copied.

    The class of a gap is ``background``. The table has the position of the recording as ``recording``, and the
    conditions of the recordings.

    Raises:
        InputError: as of `Recordings.check`: an earlier version may have imported them.
    """
    recordings.check()
    lengths = recordings.corpus.lengths
    labels = pd.Series(recordings.frame_labels())
    firsts = np.cumsum(lengths) - lengths
    recording = np.repeat(np.arange(len(recordings)), lengths)
    edges = np.append(True, recording[1:] != recording[:-1])
    edges[(firsts[recordings.events["recording"]] + recordings.events["start"]).to_numpy()] = True
    ends = (firsts[recordings.events["recording"]] + recordings.events["end"]).to_numpy()
    edges[ends[ends < len(edges)]] = True
    starts = np.flatnonzero(edges)
    table = recordings.corpus.captures.iloc[recording[starts]].reset_index(drop=True)
    table = table.assign(gesture=labels[starts].replace("", GAP).to_numpy(), recording=recording[starts])
    return recordings.corpus.changed(
        starts=storage(recordings.corpus)[1][recording[starts]] + starts - firsts[recording[starts]],
        lengths=np.append(starts[1:], len(edges))[: len(starts)] - starts,
        captures=table,
        index=np.arange(len(starts)),
        piece=np.zeros(len(starts), dtype=np.int64),
        path=None,
        info=recordings.corpus.info | {RECORDED: True},
    )


def recorded(captures: Corpus) -> Recordings:
    """The recordings that `captures_in` has cut, from all captures of some of them.

    Raises:
        ValueError: captures of a recording are missing.
    """
    table = captures.captures.assign(start=storage(captures)[1], length=captures.lengths)
    table = table.sort_values(["recording", "start"])
    groups = table.groupby("recording", sort=True)
    first, lengths = groups["start"].min(), groups["length"].sum()
    if (groups["start"].max() + groups["length"].last() != first + lengths).any():
        raise ValueError("captures of a recording are missing")
    number = table["recording"].map({name: i for i, name in enumerate(first.index)}).to_numpy()
    start = (table["start"] - table["recording"].map(first)).to_numpy()
    touched = (table["gesture"] != GAP).to_numpy()
    events = zip(number, start, start + table["length"], table["gesture"], strict=True)
    subjects = pd.DataFrame({"subject": groups["subject"].first().to_numpy(), "gesture": ""})
    corpus = captures.changed(
        starts=first.to_numpy(),
        lengths=lengths.to_numpy(),
        captures=subjects,
        index=np.arange(len(first)),
        piece=np.zeros(len(first), dtype=np.int64),
    )
    return Recordings(corpus, event_table([event for event, kept in zip(events, touched, strict=True) if kept]))


def is_recorded(captures: Corpus) -> bool:
    """Return True for captures that `captures_in` has cut from recordings."""
    return bool(captures.info.get(RECORDED))
