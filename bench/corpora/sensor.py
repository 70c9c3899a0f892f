"""The sensor at rest in each session: level, noise, repeated frames, and length of captures."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.spellings import find_background_words

SESSION_COLUMNS = ("session", "day", "sitting", "date", "visit")  # columns that tell days apart
REST_SHARE = 0.1  # of the range of summed pressure in a capture of touch; frames below are at rest


def find_session_column(corpus: Corpus) -> str:
    """The condition that names sessions, "" if there is none."""
    columns = [str(name) for name in corpus.captures if str(name).lower() in SESSION_COLUMNS]
    return next(iter(columns), "")


def sensor_table(corpus: Corpus) -> pd.DataFrame:
    """The sensor in each session, or in all captures if none are named.

    Frames at rest are those without touch: captures of background, if there are some, otherwise
    frames whose summed pressure is in the lowest tenth of their capture.

    Returns:
        A row per session, with ``captures``; at rest, in counts, ``level`` (mean reading) and
        ``noise`` (SD of a taxel from frame to frame, median over taxels); ``repeated``, percent of
        frames with the readings of the frame before; ``seconds`` of a capture (median), which shows
        another rate.
    """
    background = find_background_words({*corpus.gestures.astype(str)})
    rests = np.isin(corpus.gestures.astype(str), [*background])
    column = find_session_column(corpus)
    names = np.full(len(corpus), "all", dtype=object)
    if column:
        names = corpus.captures[column].astype(str).to_numpy(dtype=object)
    rows = []
    for name in sorted(set(names)):
        of_session = names == name
        chosen = of_session & rests if (of_session & rests).any() else of_session
        measured = [_measure_rest(corpus[int(i)], bool(rests[i])) for i in np.flatnonzero(chosen)]
        levels, squares, pairs, frames = (
            np.sum(part, axis=0) for part in zip(*measured, strict=True)
        )
        every = [_count_repeated(corpus[int(i)]) for i in np.flatnonzero(of_session)]
        repeated, changes = np.sum(every, axis=0)
        rows.append(
            {
                column or "session": name,
                "captures": int(of_session.sum()),
                "level": float(levels / max(frames, 1)),
                "noise": _median_deviation(squares, pairs),
                "repeated": 100 * float(repeated / max(changes, 1)),
                "seconds": float(np.median(corpus.lengths[of_session])) / corpus.rate_hz,
            }
        )
    return pd.DataFrame(rows)


def rest_noise(frames: np.ndarray) -> float:
    """Noise of a capture at rest, as of `sensor_table`, in the unit of its readings."""
    _, squares, pairs, _ = _measure_rest(frames, is_background=False)
    return _median_deviation(squares, pairs)


def _median_deviation(squares: np.ndarray, pairs: int) -> float:
    """SD of a taxel from squared changes between frames, median over taxels."""
    return float(np.median(np.sqrt(squares / max(2 * pairs, 1))))


def _measure_rest(frames: np.ndarray, is_background: bool) -> tuple[float, np.ndarray, int, int]:
    """Of frames at rest: sum of mean readings, squared changes of each taxel, and two counts."""
    readings = frames.reshape(len(frames), -1).astype(np.float64)
    total = readings.sum(axis=1)
    rest = total - total.min() <= REST_SHARE * (total.max() - total.min())
    rest |= is_background
    pairs = rest[1:] & rest[:-1]
    squares = (np.diff(readings, axis=0)[pairs] ** 2).sum(axis=0)
    return float(readings[rest].mean(axis=1).sum()), squares, int(pairs.sum()), int(rest.sum())


def _count_repeated(frames: np.ndarray) -> tuple[int, int]:
    """Frames that repeat the one before, and all with a frame before them."""
    same = (frames[1:] == frames[:-1]).all(axis=(1, 2))
    return int(same.sum()), len(same)
