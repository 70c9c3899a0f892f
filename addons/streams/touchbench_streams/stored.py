"""Recordings by name, imported or generated, and further background to learn from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bench.corpora import synth
from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.library import imported_names, make_once, open_designed, open_imported
from bench.corpora.skin import design_of
from bench.corpora.where import where_mask
from bench.errors import InputError
from touchbench_streams import synth_recordings
from touchbench_streams.recordings import (
    Recordings,
    comes_from_recordings,
    convert_recordings,
    cut_into_captures,
    drop_doubtful,
    restore_recordings,
)


def holds_recordings(name: str) -> bool:
    """Return True for imported recordings."""
    return name in imported_names() and comes_from_recordings(open_imported(name))


def load_recordings(
    data: str, parameters: dict[str, Any] | None = None, where: str = "", design: Any = None
) -> Corpus:
    """Captures of imported recordings, or of ``synth``: touches, background, doubtful stretches.

    With a design, as that skin measures them.
    """
    if data == "synth":
        values = parameters or {}

        def generate() -> Corpus:
            return cut_into_captures(synth_recordings.generate(**values))

        captures = make_once("synth", values, generate, synth, synth_recordings)
    else:
        captures = open_imported(data)
    if not comes_from_recordings(captures):
        raise InputError(f"{data} holds captures, not recordings; use bench run data={data}")
    if design:
        captures = open_designed(captures, design, convert_recordings)
    if not where:
        return captures
    table = captures.captures.drop(columns="gesture")
    return captures[where_mask(where, table, captures.name)]


def load_background(name: str, corpus: Corpus) -> Recordings:
    """Imported recordings without touch, to learn from besides those of a corpus.

    Their sensor must be that of the corpus.
    """
    if name not in imported_names():
        raise InputError(f"background={name}: no such recordings are imported; see bench data list")
    background = restore_recordings(load_recordings(name, design=design_of(corpus.info)))
    if len(background.events):
        raise InputError(
            f"background={name}: it has {len(background.events)} touches; give recordings whose "
            "frames have no label"
        )
    for field in ("grid", "rate_hz", "full_scale"):
        value, required = getattr(background.corpus, field), getattr(corpus, field)
        if value != required:
            raise InputError(
                f"background={name}: its {field} is {value}, not {required} as of {corpus.name}; "
                "record it again"
            )
    return background


def join_background(train: Recordings, background: Recordings, tested: np.ndarray) -> Recordings:
    """Training recordings and further background, without that of the tested subjects."""
    is_tested = np.isin(background.subjects.astype(str), tested.astype(str))
    background = background[np.flatnonzero(~is_tested)]
    if len(background.doubtful):
        background = restore_recordings(drop_doubtful(cut_into_captures(background)))
    corpus, idle = train.corpus, background.corpus
    names = idle.captures.get("recording", pd.Series(np.arange(len(idle))))
    first = int(corpus.captures.get("recording", pd.Series([0])).max()) + 1
    idle_table = idle.captures.assign(gesture="", recording=first + pd.factorize(names)[0])
    table = pd.concat([corpus.captures, idle_table], ignore_index=True)
    dtype = np.result_type(shared_frames(corpus)[0], shared_frames(idle)[0])
    streams = [np.asarray(stream, dtype) for part in (corpus, idle) for stream in part]
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": corpus.info}
    table = table[[*corpus.captures.columns]]
    joined = Corpus.from_captures(streams, table, corpus.rate_hz, **fields)
    return Recordings(joined, train.labelled)
