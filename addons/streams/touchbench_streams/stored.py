"""Recordings by name: imported and generated ones, and further background that the training recordings lack."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora import synth
from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.library import imported_names, make_once, open_imported
from bench.corpora.where import captures_where
from bench.errors import InputError
from touchbench_streams import synth_recordings
from touchbench_streams.recordings import (
    Recordings,
    comes_from_recordings,
    cut_into_captures,
    drop_doubtful,
    restore_recordings,
)


def holds_recordings(name: str) -> bool:
    """Return True for imported recordings."""
    return name in imported_names() and comes_from_recordings(open_imported(name))


def load_recordings(data: str, parameters: dict[str, Any] | None = None, where: str = "") -> Corpus:
    """All captures of imported recordings, or of ``synth``: touches, background and doubtful stretches."""
    if data == "synth":
        values = parameters or {}
        made = partial(synth_recordings.generate, **values)
        captures = make_once(
            "synth", values, lambda: cut_into_captures(made()), synth, synth_recordings
        )
    else:
        captures = open_imported(data)
    if not comes_from_recordings(captures):
        raise InputError(f"{data} holds captures, not recordings; use bench run data={data}")
    return (
        captures[captures_where(where, captures.captures.drop(columns="gesture"), captures.name)]
        if where
        else captures
    )


def load_background(name: str, like: Corpus) -> Recordings:
    """Imported recordings without touch, of the same sensor still or moved, to learn from beside those of ``like``."""
    if name not in imported_names():
        raise InputError(f"background={name}: no such recordings are imported; see bench data list")
    found = restore_recordings(load_recordings(name))
    if len(found.events):
        raise InputError(
            f"background={name}: it has {len(found.events)} touches; give recordings whose frames have no label"
        )
    for word in ("grid", "rate_hz", "full_scale"):
        mine, theirs = getattr(like, word), getattr(found.corpus, word)
        if mine != theirs:
            raise InputError(
                f"background={name}: its {word} is {theirs}, not {mine} as of {like.name}; record it again"
            )
    return found


def join_background(taught: Recordings, idle: Recordings, tested: np.ndarray) -> Recordings:
    """Training recordings and further background, without recordings of the subjects that are tested."""
    idle = idle[np.flatnonzero(~np.isin(idle.subjects.astype(str), tested.astype(str)))]
    if len(idle.doubtful):
        idle = restore_recordings(drop_doubtful(cut_into_captures(idle)))
    corpus, more = taught.corpus, idle.corpus
    own = pd.factorize(more.captures.get("recording", pd.Series(np.arange(len(more)))))[0]
    numbers = int(corpus.captures.get("recording", pd.Series([0])).max()) + 1 + own
    table = pd.concat(
        [corpus.captures, more.captures.assign(gesture="", recording=numbers)], ignore_index=True
    )
    kind = np.result_type(shared_frames(corpus)[0], shared_frames(more)[0])
    streams = [np.asarray(stream, kind) for part in (corpus, more) for stream in part]
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": corpus.info}
    both = Corpus.from_captures(
        streams, table[[*corpus.captures.columns]], corpus.rate_hz, **fields
    )
    return Recordings(both, taught.labelled)
