"""What captures contradict in what was said of them: grid, rate, full scale, labels. A line each, with what to do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.corpora.corpus import Corpus

MOST = 100  # captures whose readings are looked at
FITS = 1.1  # times the correlation of neighbours, from which another grid is likelier
LEAST = 0.1  # correlation of neighbours, below which a sensor is too noisy to tell
RARE = 10  # times fewer captures than usual: such a gesture may be another one, misspelt
FRAMES = 100  # fewer of them tell nothing about neighbours
BRIEF, LONG = 0.1, 30.0  # seconds of a usual touch


def doubts(corpus: Corpus) -> list[str]:
    """What cannot be right, for an import and a survey."""
    if not len(corpus):
        return []
    step = -(-len(corpus) // MOST)
    some = [corpus[i].reshape(int(corpus.lengths[i]), -1) for i in range(0, len(corpus), step)]
    return [*_labels(corpus), *_seconds(corpus), *_range(corpus, np.concatenate(some)), *_grid(corpus.grid, some)]


def _labels(corpus: Corpus) -> Iterator[str]:
    for column in ("subject", "gesture"):
        counts = corpus.captures[column].astype(str).value_counts()
        alike = counts.index.to_series().groupby(["".join(word.casefold().split()) for word in counts.index])
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
    if np.issubdtype(readings.dtype, np.integer) and (step := int(np.gcd.reduce(readings, axis=None))) > 1:
        yield f"all readings are multiples of {step}; if they were scaled, give them and full_scale= as measured"


def _grid(grid: tuple[int, int], some: list[np.ndarray]) -> Iterator[str]:
    """Another grid whose neighbours change together more than those of the given one."""
    changes = [np.diff(frames.astype(np.float32), axis=0) for frames in some if len(frames) > 1]
    taxels = grid[0] * grid[1]
    if min(grid) < 2 or sum(map(len, changes)) < FRAMES:
        return
    with np.errstate(all="ignore"):
        together = np.corrcoef(np.concatenate(changes).T)
    fits = {(n, taxels // n): _fit(together, n, taxels // n) for n in range(2, taxels // 2 + 1) if taxels % n == 0}
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
