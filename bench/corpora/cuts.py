"""Changes to a corpus when it is imported: a smaller grid, fewer frames, rows put together again."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError

KNOWN = {"haart": "2:1"}  # seams of formats, which align=yes means; see bench data show


def apply_changes(corpus: Corpus, kind: str, options: Mapping[str, str]) -> Corpus:
    """A corpus of a format with the changes that were asked for, which its ``info`` lists under ``changes``."""
    done = []
    for name, change in OPTIONS.items():
        text = options.get(name, "")
        if text in ("", "no", "false"):
            continue
        if name == "align" and text in ("yes", "true"):
            text = KNOWN.get(kind, text)
        corpus = change(corpus, text)
        done.append(f"{name}={text}")
    if not done:
        return corpus
    source = f"{corpus.info.get('source', '')}; changed by {', '.join(done)}"
    return corpus.with_fields(info=corpus.info | {"source": source, "changes": ", ".join(done)})


def align_frames(frames: np.ndarray, row: int, lag: int) -> np.ndarray:
    """Put frames together again that begin with ``row`` in the sensor: rows from there on, then those before it.

    These come ``lag`` frames later in the file, 1, 0 or -1; so many frames are lost.
    """
    count = len(frames) - abs(lag)
    after, before = (frames[:count], frames[lag:]) if lag >= 0 else (frames[-lag:], frames[:count])
    return np.concatenate([after[:, row:], before[:, :row]], axis=1)


def _aligned(corpus: Corpus, text: str) -> Corpus:
    rows = corpus.grid[0]
    match = re.fullmatch(r"([0-9]{1,4}):(-1|0|1)", text)
    if not match or not 0 < int(match[1]) < rows:
        raise InputError(
            f"align={text}: give ROW:LAG, such as 2:1 (a frame begins with row 2, and rows before it are from the next "
            f"frame), with a row from 1 to {rows - 1}; bench data show says what fits"
        )
    row, lag = int(match[1]), int(match[2])
    if corpus.lengths.min(initial=2) <= abs(lag):
        raise InputError(f"align={text}: a capture has one frame only; leave align= out")
    return _with([align_frames(frames, row, lag) for frames in corpus], corpus)


def _trimmed(corpus: Corpus, text: str) -> Corpus:
    match = re.fullmatch("([0-9]{1,9}):([0-9]{1,9})", text)
    if not match or not int(match[1]) < int(match[2]):
        raise InputError(
            f"frames={text}: give FIRST:END, such as 54:486, which keeps the frames 54 to 485"
        )
    first, end = int(match[1]), int(match[2])
    if short := int((corpus.lengths < end).sum()):
        raise InputError(
            f"frames={text}: {short} captures have fewer than {end} frames (the shortest {corpus.lengths.min()}); give "
            "an earlier end"
        )
    return _with([frames[first:end] for frames in corpus], corpus)


def _cropped(corpus: Corpus, text: str) -> Corpus:
    match = re.fullmatch("([0-9]{1,4})x([0-9]{1,4})", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(0 < a <= b for a, b in zip(size, corpus.grid, strict=True)):
        whole = "x".join(map(str, corpus.grid))
        raise InputError(
            f"crop={text}: give ROWSxCOLS of the centre, at most the whole grid {whole}, such as 8x8"
        )
    top, left = ((b - a) // 2 for a, b in zip(size, corpus.grid, strict=True))
    return _with(
        [frames[:, top : top + size[0], left : left + size[1]] for frames in corpus], corpus
    )


def _with(arrays: list[np.ndarray], corpus: Corpus) -> Corpus:
    lengths = np.array([len(frames) for frames in arrays], dtype=np.int64)
    return corpus.with_fields(frames=np.concatenate(arrays), lengths=lengths)


OPTIONS = {
    "align": _aligned,
    "frames": _trimmed,
    "crop": _cropped,
}  # of an import, in the order in which they are done
