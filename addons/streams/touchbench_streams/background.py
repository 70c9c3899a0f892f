"""Further recordings without touch, of a still or a moved sensor: background that the training recordings lack."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, storage
from bench.corpora.library import imported, stored_value
from bench.errors import InputError
from touchbench_streams.recordings import Recordings, captures_in, certain, recorded
from touchbench_streams.stored import holds_recordings, whole


def further(name: str, like: Corpus) -> Recordings:
    """Imported recordings without touch that a detector can learn from beside others.

    Args:
        name: name of the recordings.
        like: captures of the recordings that are watched.

    Raises:
        InputError: there are none of this name, they have touches, or their frames are of another sensor.
    """
    if name not in imported():
        raise InputError(f"background={name}: no such recordings are imported; see bench data list")
    found = recorded(whole(name))
    if len(found.events):
        raise InputError(
            f"background={name}: it has {len(found.events)} touches; give recordings whose frames have no label"
        )
    for word, mine, theirs in (
        ("grid", like.grid, found.corpus.grid),
        ("rate_hz", like.rate_hz, found.corpus.rate_hz),
        ("full_scale", like.full_scale, found.corpus.full_scale),
    ):
        if mine != theirs:
            raise InputError(
                f"background={name}: its {word} is {theirs}, not {mine} as of {like.name}; record it again"
            )
    return found


def joined(taught: Recordings, idle: Recordings, tested: np.ndarray) -> Recordings:
    """Training recordings and further background, without recordings of subjects that are tested.

    Args:
        taught: recordings of training subjects.
        idle: result of `further`.
        tested: names of the test subjects.
    """
    idle = idle[np.flatnonzero(~np.isin(idle.subjects.astype(str), tested.astype(str)))]
    if len(idle.doubtful):
        idle = recorded(certain(captures_in(idle)))
    corpus, more = taught.corpus, idle.corpus
    own = pd.factorize(more.captures.get("recording", pd.Series(np.arange(len(more)))))[0]
    numbers = int(corpus.captures.get("recording", pd.Series([0])).max()) + 1 + own
    table = pd.concat([corpus.captures, more.captures.assign(gesture="", recording=numbers)], ignore_index=True)
    kind = np.result_type(storage(corpus)[0], storage(more)[0])
    streams = [np.asarray(stream, kind) for part in (corpus, more) for stream in part]
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": corpus.info}
    both = Corpus.from_captures(streams, table[[*corpus.captures.columns]], corpus.rate_hz, **fields)
    return Recordings.of(both, taught.labelled)


def digest_of(name: str) -> list[str]:
    """The digest of the recordings of a name, if there are any."""
    return [stored_value(name).digest] if holds_recordings(name) else []
