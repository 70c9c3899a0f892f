"""Captures as a whole: whether a saved system has ever seen their like."""

from __future__ import annotations

import numpy as np

from bench.corpora.corpus import Corpus

MARGIN = 0.1  # of the range in training; a left-out person of HAART or CuddleBot is within it in 99.9 % of captures
LEVEL = 1e-4  # of the full scale; smaller differences count little
# Added to each number before its logarithm is taken; the C of touch_unlike has the same order.
LEAST = np.array([LEVEL, LEVEL, LEVEL, LEVEL, LEVEL, LEVEL, 1.0])


def capture_statistics(corpus: Corpus) -> np.ndarray:
    """Seven numbers of each capture that depend little on its gesture.

    Mean reading, largest reading, least mean of a frame, in parts of the full scale; mean difference of neighbours in
    a row and in a column, in parts of the mean; their ratio; share of readings that are 0.

    Returns:
        [captures, 7], logarithms.
    """
    rows = np.empty((len(corpus), len(LEAST)))
    for i, capture in enumerate(corpus):
        frames = capture.astype(np.float64) / corpus.full_scale
        mean, across, down = (frames.mean(), *(mean_gap(frames, axis) + LEVEL for axis in (2, 1)))
        level = mean + LEVEL
        numbers = [
            mean,
            frames.max(),
            frames.mean(axis=(1, 2)).min(),
            across / level,
            down / level,
            across / down,
        ]
        rows[i] = np.log([*numbers, (frames == 0).mean()] + LEAST)
    return rows


def mean_gap(frames: np.ndarray, axis: int) -> float:
    """Mean difference of neighbours along an axis; 0 where it has one taxel."""
    return float(np.abs(np.diff(frames, axis=axis)).mean()) if frames.shape[axis] > 1 else 0.0


def usual_range(corpus: Corpus) -> np.ndarray:
    """Least and largest of each number that is usual, [2, 7]: the range in these captures, a little wider."""
    numbers = capture_statistics(corpus)
    least, most = numbers.min(axis=0), numbers.max(axis=0)
    wider = MARGIN * (most - least) + 1e-6  # a number that never differs differs by rounding
    return np.stack([least - wider, most + wider])


def is_unlike_training(corpus: Corpus, range_: np.ndarray) -> np.ndarray:
    """Which captures have a number outside the usual range."""
    numbers = capture_statistics(corpus)
    return ((numbers < range_[0]) | (numbers > range_[1])).any(axis=1)
