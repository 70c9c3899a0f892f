"""What captures contradict in what was said of them: grid, rate, full scale, labels, seams; a line each.

Neighbouring taxels change together from one frame to the next. A seam is where they do not, although the last line
changes together with the first: frames were probably cut at the wrong place.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bench.corpora.corpus import Corpus

MOST, CUT = 100, 300  # captures whose readings are looked at, and those that are searched for seams
FITS = 1.1  # times the correlation of neighbours, from which another grid is likelier
LEAST = 0.1  # correlation of neighbours, below which a sensor is too noisy to tell
RARE = 10  # times fewer captures than usual: such a gesture may be another one, misspelt
FRAMES = 100  # fewer of them tell nothing about neighbours
LAGS = (0, 1, -1)  # frames
LOW, HIGH = (
    0.5,
    0.75,
)  # shares of the usual correlation of neighbours: below one they are cut, above the other they fit
BRIEF, LONG = 0.1, 30.0  # seconds of a usual touch


def find_doubts(corpus: Corpus) -> list[str]:
    """What cannot be right, for an import and a survey."""
    if not len(corpus):
        return []
    step = -(-len(corpus) // MOST)
    some = [corpus[i].reshape(int(corpus.lengths[i]), -1) for i in range(0, len(corpus), step)]
    return [
        *_labels(corpus),
        *_seconds(corpus),
        *_range(corpus, np.concatenate(some)),
        *_grid(corpus.grid, some),
    ]


def _labels(corpus: Corpus) -> Iterator[str]:
    for column in ("subject", "gesture"):
        counts = corpus.captures[column].astype(str).value_counts()
        alike = counts.index.to_series().groupby(
            ["".join(word.casefold().split()) for word in counts.index]
        )
        for one, other, *_ in (sorted(words) for _, words in alike if len(words) > 1):
            yield f"{column} {one!r} and {other!r} differ by case or blanks alone; if they are one, correct the file"
    for rare in counts.index[RARE * counts <= counts.median()]:
        others = (word for word in counts.index if word.casefold() != rare.casefold())
        if usual := next((word for word in others if _letters(rare, word) <= 2), ""):
            yield f"gesture {rare!r} has {counts[rare]} of {len(corpus)} captures; if it is {usual!r}, correct the file"


def _letters(one: str, other: str) -> int:
    """Letters to change, add or leave out until one word is the other (Levenshtein's distance)."""
    row = list(range(len(other) + 1))
    for i, letter in enumerate(one, 1):
        last, row[0] = row[0], i
        for j, against in enumerate(other, 1):
            last, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, last + (letter != against))
    return row[-1]


def _seconds(corpus: Corpus) -> Iterator[str]:
    median = float(np.median(corpus.lengths)) / corpus.rate_hz
    if not BRIEF <= median <= LONG:
        what = "less than a touch" if median < BRIEF else "more than a touch"
        yield f"the median capture lasts {median:.2g} s, {what}; check rate_hz={corpus.rate_hz:g}"


def _range(corpus: Corpus, readings: np.ndarray) -> Iterator[str]:
    top, usual, full = float(readings.max()), float(np.median(readings)), corpus.full_scale
    of = f"of full_scale={full:g}"
    if usual > full / 2:
        yield f"the median reading is {usual:g} {of}: pressed at rest; if readings are inverted, turn them"
    if 0 < top <= full / 3:
        most = next(2**bits - 1 for bits in range(1, 33) if top < 2**bits)
        yield f"the highest reading is {top:g} {of}; if the sensor ends at {most:g}, give full_scale={most:g}"
    if (
        np.issubdtype(readings.dtype, np.integer)
        and (step := int(np.gcd.reduce(readings, axis=None))) > 1
    ):
        yield f"all readings are multiples of {step}; if they were scaled, give them and full_scale= as measured"


def _grid(grid: tuple[int, int], some: list[np.ndarray]) -> Iterator[str]:
    """Another grid whose neighbours change together more than those of the given one."""
    changes = [np.diff(frames.astype(np.float32), axis=0) for frames in some if len(frames) > 1]
    taxels = grid[0] * grid[1]
    if min(grid) < 2 or sum(map(len, changes)) < FRAMES:
        return
    with np.errstate(all="ignore"):
        together = np.corrcoef(np.concatenate(changes).T)
    fits = {
        (n, taxels // n): _fit(together, n, taxels // n)
        for n in range(2, taxels // 2 + 1)
        if taxels % n == 0
    }
    best = max(fits, key=fits.__getitem__)
    if fits[best] > max(LEAST, FITS * fits[grid]):
        yield (
            f"neighbours change together less in a grid of {grid[0]}x{grid[1]} ({fits[grid]:.2f}) than of "
            f"{best[0]}x{best[1]} ({fits[best]:.2f}); if rows and columns are mistaken, give grid={best[0]}x{best[1]}"
        )


def _fit(together: np.ndarray, rows: int, cols: int) -> float:
    """Mean correlation of the changes of neighbouring taxels; 0 where none change."""
    taxel = np.arange(rows * cols).reshape(rows, cols)
    pairs = [together[taxel[:, :-1], taxel[:, 1:]].ravel(), together[taxel[:-1], taxel[1:]].ravel()]
    known = np.concatenate(pairs)
    return float(known[np.isfinite(known)].mean()) if np.isfinite(known).any() else 0.0


class Seam(NamedTuple):
    """How the rows, or the columns, of a corpus fit each other, by the correlation of their changes."""

    lines: str  # "rows" or "columns"
    usual: float  # median over each line and the next
    weakest: int  # the line after the weakest of these pairs
    weak: float  # correlation of that pair
    lag: int  # frames by which the first line is later, where it fits the last line best
    fit: float  # correlation of these two

    @property
    def is_cut(self) -> bool:
        """True if frames look cut: one pair does not fit, and the last and the first line do."""
        return self.usual >= LEAST and self.weak < LOW * self.usual and self.fit > HIGH * self.usual

    def __str__(self) -> str:
        line, pair = (
            self.lines.removesuffix("s"),
            f"{self.lines} {self.weakest - 1} and {self.weakest}",
        )
        when = {0: "the same frame", 1: "the next frame", -1: "the previous frame"}[self.lag]
        text = (
            f"Changes of adjacent {self.lines} correlate with {self.usual:.2f} (median), of {pair} with "
            f"{self.weak:.2f}, of the last {line} and the first of {when} with {self.fit:.2f}"
        )
        remedy = (
            f"; import with align={self.weakest}:{self.lag} to put them together"
            if self.lines == "rows"
            else ""
        )
        return f"{text}: frames look cut between {pair}{remedy}" if self.is_cut else text


def measure_seams(corpus: Corpus) -> list[Seam]:
    """How rows and columns fit each other, in at most `CUT` captures; of fewer than four of them, nothing."""
    result = []
    some = [corpus[i].astype(np.float32) for i in range(0, len(corpus), -(-len(corpus) // CUT))]
    for axis, lines in ((1, "rows"), (2, "columns")):
        pairs = [_pairs(np.moveaxis(frames, axis, 1)) for frames in some if len(frames) > 3]
        if corpus.grid[axis - 1] < 4 or not pairs:
            continue
        sums, counts = np.sum(pairs, axis=0)
        neighbours, ends = np.split(sums / np.maximum(counts, 1), [-1], axis=1)
        weakest, lag = int(neighbours[0].argmin()), int(ends.argmax())
        fit = float(ends[lag, 0])
        usual = float(np.median(neighbours[0]))
        result.append(
            Seam(lines, usual, weakest + 1, float(neighbours[0, weakest]), LAGS[lag], fit)
        )
    return result


def _pairs(frames: np.ndarray) -> np.ndarray:
    """Correlations of the changes of taxels [frames, lines, taxels] and their neighbours in the next line.

    Sums over the taxels, and numbers of pairs that change [2, lags, lines]; the last line's neighbour is the first.
    """
    changes = np.diff(frames, axis=0)
    following, count = np.roll(changes, -1, axis=1), len(changes)
    parts = []
    for lag in LAGS:
        one = changes[max(-lag, 0) : count - max(lag, 0)]
        other = following[max(lag, 0) : count - max(-lag, 0)]
        one, other = one - one.mean(axis=0), other - other.mean(axis=0)
        both = np.sqrt((one**2).sum(axis=0) * (other**2).sum(axis=0))
        ratio = np.divide((one * other).sum(axis=0), both, out=np.zeros_like(both), where=both > 0)
        parts.append((ratio.sum(axis=1), (both > 0).sum(axis=1)))
    return np.swapaxes(parts, 0, 1)
