"""Seams: rows or columns that a file puts beside each other although they are not, or are from different frames.

Neighbouring taxels change together from one frame to the next. Where they do not, and the last row changes together
with the first, frames were probably cut at the wrong place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.corpora.corpus import Corpus

LAGS = (0, 1, -1)  # frames
LOW, HIGH = 0.5, 0.75  # shares of the usual correlation of neighbours: below one they are cut, above the other they fit
LEAST = 0.1  # median correlation of neighbours, below which a sensor is too noisy to tell
MOST = 300  # captures that are looked at


@dataclass(frozen=True)
class Seam:
    """How the rows, or the columns, of a corpus fit each other."""

    lines: str  # "rows" or "columns"
    neighbours: np.ndarray  # mean correlation of the changes of each line and the next [lines - 1]
    ends: dict[int, float]  # the same of the last and the first line, by frames by which the first one is later

    @property
    def weakest(self) -> int:
        """The line after the weakest pair."""
        return int(self.neighbours.argmin()) + 1

    @property
    def lag(self) -> int:
        """The lag at which the last and the first line fit best."""
        return max(self.ends, key=lambda lag: (self.ends[lag], -abs(lag)))

    @property
    def found(self) -> bool:
        """True if frames look cut: one pair does not fit, and the last and the first line do."""
        usual = float(np.median(self.neighbours))
        low, high = self.neighbours[self.weakest - 1] < LOW * usual, self.ends[self.lag] > HIGH * usual
        return usual >= LEAST and bool(low and high)

    def __str__(self) -> str:
        line, k, fit = self.lines.removesuffix("s"), self.weakest, self.ends[self.lag]
        when = {0: "the same frame", 1: "the next frame", -1: "the previous frame"}[self.lag]
        usual, weak = np.median(self.neighbours), self.neighbours[k - 1]
        text = (
            f"Changes of adjacent {self.lines} correlate with {usual:.2f} (median), of {self.lines} {k - 1} and {k} "
            f"with {weak:.2f}, of the last {line} and the first of {when} with {fit:.2f}"
        )
        if not self.found:
            return text
        remedy = f"; import with align={k}:{self.lag} to put them together" if self.lines == "rows" else ""
        return f"{text}: frames look cut between {self.lines} {k - 1} and {k}{remedy}"


def seams(corpus: Corpus) -> list[Seam]:
    """How rows and columns fit each other, in at most `MOST` captures; of fewer than four of them, nothing."""
    result = []
    step = -(-len(corpus) // MOST)
    chosen = [corpus[i].astype(np.float32) for i in range(0, len(corpus), step)]
    for axis, lines in ((1, "rows"), (2, "columns")):
        if corpus.grid[axis - 1] < 4:
            continue
        pairs = [_pairs(np.moveaxis(frames, axis, 1)) for frames in chosen if len(frames) > 3]
        if not pairs:
            continue
        total = np.nansum([sums for sums, _ in pairs], axis=0)
        mean = total / np.maximum(np.sum([counts for _, counts in pairs], axis=0), 1)
        ends = {lag: float(mean[k, -1]) for k, lag in enumerate(LAGS)}
        result.append(Seam(lines, mean[0, :-1], ends))
    return result


def _pairs(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Correlations of the changes of taxels [frames, lines, taxels] and their neighbours in the next line.

    Sums over the taxels, and numbers of pairs that change, [lags, lines]; the last line's neighbour is the first.
    """
    changes = np.diff(frames, axis=0)
    following = np.roll(changes, -1, axis=1)
    sums, counts = [], []
    for lag in LAGS:
        end = len(changes) - abs(lag)
        one, other = (changes[:end], following[lag:]) if lag >= 0 else (changes[-lag:], following[:end])
        one, other = one - one.mean(axis=0), other - other.mean(axis=0)
        both = np.sqrt((one**2).sum(axis=0) * (other**2).sum(axis=0))
        moving = both > 0
        ratio = np.where(moving, (one * other).sum(axis=0) / np.where(moving, both, 1), 0)
        sums.append(ratio.sum(axis=1))
        counts.append(moving.sum(axis=1))
    return np.array(sums), np.array(counts)
