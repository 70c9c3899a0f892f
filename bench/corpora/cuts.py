"""Changes to a corpus at its import: rows put together again, fewer frames, a smaller grid."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError

KNOWN_SEAMS = {"haart": "2:1"}  # of formats, for align=yes; bench data show finds them


def apply_changes(corpus: Corpus, kind: str, options: Mapping[str, str]) -> Corpus:
    """Apply the changes of an import.

    Args:
        corpus: captures as a reader gave them.
        kind: their format.
        options: values of keys of `OPTIONS`.

    Returns:
        The changed captures, whose ``info`` lists the changes.

    Raises:
        InputError: a change does not fit the captures.
    """
    applied = []
    for name, change in OPTIONS.items():
        text = options.get(name, "")
        if text in ("", "no", "false"):
            continue
        if name == "align" and text in ("yes", "true"):
            text = KNOWN_SEAMS.get(kind, text)
        arrays = change(corpus, text)
        lengths = np.array([len(frames) for frames in arrays], dtype=np.int64)
        corpus = corpus.with_fields(frames=np.concatenate(arrays), lengths=lengths)
        applied.append(f"{name}={text}")
    if not applied:
        return corpus
    changes = ", ".join(applied)
    source = f"{corpus.info.get('source', '')}; changed by {changes}"
    return corpus.with_fields(info=corpus.info | {"source": source, "changes": changes})


def align_frames(frames: np.ndarray, row: int, lag: int) -> np.ndarray:
    """Put frames together again that were cut at the wrong place.

    Args:
        frames: frames of a capture [frames, rows, cols].
        row: the sensor's row with which a frame of the file begins.
        lag: frames by which the rows before it come later in the file: 1, 0 or -1.

    Returns:
        Frames from the sensor's first row on, ``abs(lag)`` fewer.
    """
    count = len(frames) - abs(lag)
    below, above = frames[max(-lag, 0) :][:count], frames[max(lag, 0) :][:count]
    return np.concatenate([below[:, row:], above[:, :row]], axis=1)


def _align(corpus: Corpus, text: str) -> list[np.ndarray]:
    rows = corpus.grid[0]
    match = re.fullmatch(r"([0-9]{1,4}):(-1|0|1)", text)
    if not match or not 0 < int(match[1]) < rows:
        raise InputError(
            f"align={text}: give ROW:LAG, such as 2:1 (a frame begins with row 2, and rows before "
            f"it are from the next frame), with a row from 1 to {rows - 1}; "
            "bench data show says what fits"
        )
    row, lag = int(match[1]), int(match[2])
    if corpus.lengths.min(initial=2) <= abs(lag):
        raise InputError(f"align={text}: a capture has one frame only; leave align= out")
    return [align_frames(frames, row, lag) for frames in corpus]


def _trim(corpus: Corpus, text: str) -> list[np.ndarray]:
    match = re.fullmatch("([0-9]{1,9}):([0-9]{1,9})", text)
    if not match or not int(match[1]) < int(match[2]):
        raise InputError(
            f"frames={text}: give FIRST:END, such as 54:486, which keeps the frames 54 to 485"
        )
    first, end = int(match[1]), int(match[2])
    if shorter := int((corpus.lengths < end).sum()):
        raise InputError(
            f"frames={text}: {shorter} captures have fewer than {end} frames "
            f"(the shortest {corpus.lengths.min()}); give an earlier end"
        )
    return [frames[first:end] for frames in corpus]


def _crop(corpus: Corpus, text: str) -> list[np.ndarray]:
    match = re.fullmatch("([0-9]{1,4})x([0-9]{1,4})", text)
    rows, cols = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (0 < rows <= corpus.grid[0] and 0 < cols <= corpus.grid[1]):
        raise InputError(
            f"crop={text}: give ROWSxCOLS of the centre, at most the whole grid "
            f"{corpus.grid[0]}x{corpus.grid[1]}, such as 8x8"
        )
    top, left = (corpus.grid[0] - rows) // 2, (corpus.grid[1] - cols) // 2
    return [frames[:, top : top + rows, left : left + cols] for frames in corpus]


OPTIONS = {"align": _align, "frames": _trim, "crop": _crop}  # of an import, in this order
