"""What captures contradict in their description: grid, rate, full scale, labels, seams.

Neighbouring taxels change together from one frame to the next. At a seam they do not, although the
last line changes together with the first: frames were probably cut at the wrong place.
"""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.spellings import may_be_same, spelling_doubts

MOST_CAPTURES, MOST_FOR_SEAMS = 100, 300  # whose readings are looked at, evenly spread
BETTER_FIT = 1.1  # times the correlation of neighbours, from which another grid is likelier
LEAST_SPREAD, LAST_TAXELS = 4, 3  # of readings in a frame, and taxels that may be statistics
LEAST_CORRELATION = 0.1  # of neighbours; below it a sensor is too noisy to tell
RARE = 10  # times fewer captures than usual: such a gesture may be another one, misspelt
SIMILAR = 0.65  # of two words, from 0 to 1
LEAST_FRAMES = 100  # fewer of them tell nothing about neighbours
LAGS = (0, 1, -1)  # frames
CUT, FITTING = 0.5, 0.75  # shares of the usual correlation: below the one, above the other
SHORTEST_S, LONGEST_S = 0.1, 30.0  # of a usual touch


def find_doubts(corpus: Corpus) -> list[str]:
    """What looks wrong, a line each, for an import and a survey."""
    if not len(corpus):
        return []
    step = -(-len(corpus) // MOST_CAPTURES)
    some = [corpus[i].reshape(int(corpus.lengths[i]), -1) for i in range(0, len(corpus), step)]
    return [
        *_doubt_labels(corpus),
        *_doubt_rate(corpus),
        *_doubt_full_scale(corpus, np.concatenate(some)),
        *_doubt_statistics(np.concatenate(some).astype(np.float64)),
        *_doubt_grid(corpus.grid, some),
    ]


def doubt_spellings(corpus: Corpus) -> list[str]:
    """Subjects and gestures that may be one, spelt differently; joined corpora each for itself."""
    captures, lines = corpus.captures.astype(str), []
    origin = captures["corpus"] if corpus.info.get("format") == "joined" else [""] * len(captures)
    for _, part in captures.groupby(origin):
        for column in ("subject", "gesture"):
            lines += spelling_doubts(column, part[column].value_counts().to_dict())
    return list(dict.fromkeys(lines))


def _doubt_labels(corpus: Corpus) -> Iterator[str]:
    """Names that may be misspelt."""
    yield from doubt_spellings(corpus)
    counts = corpus.captures["gesture"].astype(str).value_counts()
    for rare in counts.index[RARE * counts <= counts.median()]:
        others = [word for word in counts.index if not may_be_same(word, rare)]
        for usual in get_close_matches(rare, others, n=1, cutoff=SIMILAR):
            yield (
                f"gesture {rare!r} has {counts[rare]} of {len(corpus)} captures; "
                f"if it is {usual!r}, correct the file"
            )


def _doubt_rate(corpus: Corpus) -> Iterator[str]:
    median = float(np.median(corpus.lengths)) / corpus.rate_hz
    if not SHORTEST_S <= median <= LONGEST_S:
        comparison = "less" if median < SHORTEST_S else "more"
        yield (
            f"the median capture lasts {median:.2g} s, {comparison} than a touch; "
            f"check rate_hz={corpus.rate_hz:g}"
        )


def _doubt_full_scale(corpus: Corpus, readings: np.ndarray) -> Iterator[str]:
    highest, median = float(readings.max()), float(np.median(readings))
    of_full_scale = f"of full_scale={corpus.full_scale:g}"
    if median > corpus.full_scale / 2:
        yield (
            f"the median reading is {median:g} {of_full_scale}: pressed at rest; "
            "if readings are inverted, turn them"
        )
    if 0 < highest <= corpus.full_scale / 3:
        end = 2 ** max(1, int(highest).bit_length()) - 1
        yield (
            f"the highest reading is {highest:g} {of_full_scale}; "
            f"if the sensor ends at {end:g}, give full_scale={end:g}"
        )
    is_whole = np.issubdtype(readings.dtype, np.integer)
    if is_whole and (step := np.gcd.reduce(readings, axis=None)) > 1:
        yield (
            f"all readings are multiples of {step}; "
            "if they were scaled, give them and full_scale= as measured"
        )


def _doubt_statistics(readings: np.ndarray) -> Iterator[str]:
    """Find a mean, a sum or a maximum of the taxels among the last of them."""
    taxels = readings.shape[1]
    if np.median(np.ptp(readings, axis=1)) < LEAST_SPREAD:
        return
    for taxel in range(max(3, taxels - LAST_TAXELS), taxels):
        reading, before = readings[:, taxel], readings[:, :taxel]
        total = before.sum(axis=1)
        counts = range(taxel, taxel + LAST_TAXELS + 1)  # some taxels may be missing
        is_mean = any((np.abs(reading - total / count) < 1).all() for count in counts)
        relations = {
            "sum": (reading == total).all(),
            "mean": is_mean,
            "maximum": (reading == before.max(axis=1)).all(),
        }
        for relation in (name for name, fits in relations.items() if fits and np.ptp(reading)):
            yield (
                f"taxel {taxel + 1} of {taxels} is always the {relation} of those before it; "
                "if it is no taxel, delete its column and check grid="
            )


def _doubt_grid(grid: tuple[int, int], some: list[np.ndarray]) -> Iterator[str]:
    """Find a grid whose neighbours change together more than those of the given one."""
    changes = [np.diff(frames.astype(np.float32), axis=0) for frames in some if len(frames) > 1]
    if min(grid) < 2 or sum(map(len, changes)) < LEAST_FRAMES:
        return
    with np.errstate(all="ignore"):
        correlations = np.corrcoef(np.concatenate(changes).T)
    taxels = grid[0] * grid[1]
    sides = [rows for rows in range(2, taxels // 2 + 1) if taxels % rows == 0]
    fits = {(rows, taxels // rows): _grid_fit(correlations, rows, taxels // rows) for rows in sides}
    best = max(fits, key=fits.__getitem__)
    if fits[best] > max(LEAST_CORRELATION, BETTER_FIT * fits[grid]):
        size = f"{best[0]}x{best[1]}"
        yield (
            f"neighbours change together less in a grid of {grid[0]}x{grid[1]} ({fits[grid]:.2f}) "
            f"than of {size} ({fits[best]:.2f}); if rows and columns are mistaken, give grid={size}"
        )


def _grid_fit(correlations: np.ndarray, rows: int, cols: int) -> float:
    """Mean correlation of the changes of neighbouring taxels; 0 if none change."""
    taxel = np.arange(rows * cols).reshape(rows, cols)
    beside, below = correlations[taxel[:, :-1], taxel[:, 1:]], correlations[taxel[:-1], taxel[1:]]
    pairs = np.append(beside, below)
    pairs = pairs[np.isfinite(pairs)]
    return float(pairs.mean()) if len(pairs) else 0.0


class Seam(NamedTuple):
    """How the rows, or the columns, of a corpus fit each other, by the correlation of changes.

    Attributes:
        lines: ``"rows"`` or ``"columns"``.
        usual: median correlation of each line and the next.
        weakest: the line after the weakest of these pairs.
        weak: correlation of that pair.
        lag: frames by which the first line is later, where it fits the last line best.
        fit: correlation of these two.
    """

    lines: str
    usual: float
    weakest: int
    weak: float
    lag: int
    fit: float

    @property
    def is_cut(self) -> bool:
        """True if frames look cut: one pair does not fit, and the last and the first line do."""
        is_weak = self.usual >= LEAST_CORRELATION and self.weak < CUT * self.usual
        return is_weak and self.fit > FITTING * self.usual

    def __str__(self) -> str:
        line = self.lines.removesuffix("s")
        pair = f"{self.lines} {self.weakest - 1} and {self.weakest}"
        frame = {0: "the same frame", 1: "the next frame", -1: "the previous frame"}[self.lag]
        text = (
            f"Changes of adjacent {self.lines} correlate with {self.usual:.2f} (median), of {pair} "
            f"with {self.weak:.2f}, of the last {line} and the first of {frame} with {self.fit:.2f}"
        )
        if self.is_cut:
            text += f": frames look cut between {pair}"
            if self.lines == "rows":
                text += f"; import with align={self.weakest}:{self.lag} to put them together"
        return text


def measure_seams(corpus: Corpus) -> list[Seam]:
    """How rows and columns fit each other; nothing for fewer than four of them.

    At most `MOST_FOR_SEAMS` captures are measured.
    """
    result = []
    step = -(-len(corpus) // MOST_FOR_SEAMS)
    some = [corpus[i].astype(np.float32) for i in range(0, len(corpus), step)]
    for axis, lines in ((1, "rows"), (2, "columns")):
        sums = [_sum_correlations(np.moveaxis(f, axis, 1)) for f in some if len(f) > 3]
        if corpus.grid[axis - 1] < 4 or not sums:
            continue
        total, count = np.sum(sums, axis=0)
        neighbours, ends = np.split(total / np.maximum(count, 1), [-1], axis=1)
        weakest, best = int(neighbours[0].argmin()), int(ends.argmax())
        usual, weak = float(np.median(neighbours[0])), float(neighbours[0, weakest])
        result.append(Seam(lines, usual, weakest + 1, weak, LAGS[best], float(ends[best, 0])))
    return result


def _sum_correlations(frames: np.ndarray) -> np.ndarray:
    """Correlations of the changes of taxels and their neighbours in the next line.

    Args:
        frames: frames of a capture [frames, lines, taxels]. The line after the last is the first.

    Returns:
        Sums over the taxels, and numbers of pairs that change [2, lags, lines].
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
