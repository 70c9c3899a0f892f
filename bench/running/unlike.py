"""Captures as a whole: whether they look like the captures that a saved system was fitted to."""

from __future__ import annotations

import numpy as np

from bench.corpora.corpus import Corpus

# Of the range in training: 99.9 % of the captures of a left-out person of HAART or CuddleBot lie in
# the wider range.
MARGIN = 0.1
LEVEL = 1e-4  # of the full scale; smaller differences count little
# Added to each number before its logarithm is taken; the C of touch_unlike has the same order.
LEAST = np.array([LEVEL, LEVEL, LEVEL, LEVEL, LEVEL, LEVEL, 1.0])


def reading_statistics(corpus: Corpus) -> np.ndarray:
    """Seven numbers of each capture that depend little on its gesture.

    Mean reading, largest reading, and least mean of a frame, in parts of the full scale; mean
    difference of neighbours in a row and in a column, in parts of the mean; their ratio; share of
    readings that are 0.

    Returns:
        [captures, 7], logarithms.
    """
    rows = np.empty((len(corpus), len(LEAST)))
    for i, capture in enumerate(corpus):
        frames = capture.astype(np.float64) / corpus.full_scale
        mean, least = frames.mean(), frames.mean(axis=(1, 2)).min()
        across, down = (float(mean_gaps(frames, axis).mean()) for axis in (2, 1))
        zeros = (frames == 0).mean()
        rows[i] = combine_statistics(mean, frames.max(), least, across, down, zeros)
    return rows


def combine_statistics(
    mean: float, largest: float, least: float, across: float, down: float, zeros: float
) -> np.ndarray:
    """The seven numbers from means, extremes and mean differences of neighbours."""
    across, down = across + LEVEL, down + LEVEL
    gaps = [across / (mean + LEVEL), down / (mean + LEVEL), across / down]
    return np.log([mean, largest, least, *gaps, zeros] + LEAST)


def mean_gaps(frames: np.ndarray, axis: int) -> np.ndarray:
    """Mean difference of neighbours along an axis in each frame; 0 if it has one taxel."""
    gaps = np.abs(np.diff(frames, axis=axis))
    return gaps.sum(axis=(1, 2)) / max(gaps[0].size, 1)


def usual_range(corpus: Corpus) -> np.ndarray:
    """Least and largest usual value of each number [2, 7]: the range here, a little wider."""
    numbers = reading_statistics(corpus)
    least, most = numbers.min(axis=0), numbers.max(axis=0)
    margin = MARGIN * (most - least) + 1e-6  # a constant number differs by rounding
    return np.stack([least - margin, most + margin])


def is_unlike_training(corpus: Corpus, usual: np.ndarray) -> np.ndarray:
    """True for captures with a number outside the usual range, bool [captures]."""
    numbers = reading_statistics(corpus)
    return ((numbers < usual[0]) | (numbers > usual[1])).any(axis=1)
