"""Captures of one skin as another would have given them: full scale, rate and grid, each by a function of its own.

Nothing is learnt, and what becomes of a capture depends on that capture alone. What the other skin cannot hold is lost:
`bench_transfer.py` in benchmarks sends a corpus through each step and back and says what that costs.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.duplicates import named, shared
from bench.errors import InputError

OWN, SOURCE = "own", "source"  # what the column ``skin`` says


def weights(count: int, wanted: int) -> np.ndarray:
    """How values along an axis make up more or fewer of them, rows of which each sums to 1 [wanted, count].

    Both lie evenly over the same length. Where there are to be fewer, each is the mean over its share of that length;
    where there are to be more, each lies on the line between the two values whose middles are next to its own.

    Args:
        count: values that there are.
        wanted: values that there are to be.
    """
    if wanted < count:
        edges = np.arange(wanted + 1) * count / wanted
        inside = np.clip(edges[1:, None], np.arange(count), np.arange(1, count + 1))
        return (inside - np.clip(edges[:-1, None], np.arange(count), np.arange(1, count + 1))) * wanted / count
    place = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
    return np.clip(1 - np.abs(place[:, None] - np.arange(count)), 0, 1)


def scaled(frames: np.ndarray, full_scale: float, wanted: float) -> np.ndarray:
    """Frames as the same shares of another full scale, float32."""
    return frames.astype(np.float32) * np.float32(wanted / full_scale)


def resampled(frames: np.ndarray, rate_hz: float, wanted_hz: float) -> np.ndarray:
    """Frames [frames, rows, cols] at another rate, float32; their number is rounded, at least one stays.

    As `weights` says, without a weight for each pair of frames, of which a long capture has too many.
    """
    n = len(frames)
    count = max(1, round(n * wanted_hz / rate_hz))
    if count == n:
        return frames.astype(np.float32)
    values = frames.astype(np.float64)
    if count > n:
        place = np.clip((np.arange(count) + 0.5) * n / count - 0.5, 0, n - 1)
        low = np.minimum(place.astype(int), n - 1)
        part = (place - low)[:, None, None]
        return (values[low] * (1 - part) + values[np.minimum(low + 1, n - 1)] * part).astype(np.float32)
    edges = np.arange(count + 1) * n / count
    whole = np.minimum(edges.astype(int), n - 1)
    until = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    sums = until[whole] + (edges - whole)[:, None, None] * values[whole]
    return (np.diff(sums, axis=0) * count / n).astype(np.float32)


def regridded(frames: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Frames [frames, rows, cols] on another grid over the same area, float32."""
    if frames.shape[1:] == (rows, cols):
        return frames.astype(np.float32)
    down, across = (weights(n, w).astype(np.float32) for n, w in zip(frames.shape[1:], (rows, cols), strict=True))
    return down @ frames.astype(np.float32) @ across.T


def brought(corpus: Corpus, rate_hz: float, grid: tuple[int, int], full_scale: float) -> list[np.ndarray]:
    """Captures of a corpus as a skin with this rate, grid and full scale would have given them, float32."""
    shares = (scaled(frames, corpus.full_scale, full_scale) for frames in corpus)
    return [regridded(resampled(values, corpus.rate_hz, rate_hz), *grid) for values in shares]


def _refuse_the_same(own: Corpus, source: Corpus) -> None:
    """Nobody is trained on who is tested.

    Raises:
        InputError: a capture is in both, or both are generated from one seed, and so of the same people.
    """
    if both := shared(own, source):
        mine, theirs = both[0]
        raise InputError(
            f"protocol=transfer: {own.name} and {source.name} have the same captures: {len(both)}, such as "
            f"{named(own, mine)} and {named(source, theirs)}; name another source"
        )
    if own.synthetic and own.info.get("source") == source.info.get("source"):
        raise InputError(
            "protocol=transfer: generated captures of one seed are of the same people; add +seed=1 to protocol.source="
        )


def joined(own: Corpus, source: Corpus, names: dict[str, str]) -> Corpus:
    """Captures of one skin, and behind them those of another, of the classes that both have.

    Both are brought to the lower of their rates, and each way to the fewer of their taxels; the full scale is that of
    the first. What is the same already stays as it is.

    Args:
        own: captures.
        source: captures of the other skin.
        names: what classes of ``source`` are called in ``own``, where that is something else.

    Returns:
        A corpus in memory, float32, whose column ``skin`` says which is which. People of the other skin are others,
        whatever they are called.

    Raises:
        InputError: a class that is not there is given a name, less than two are left, or a capture is in both.
    """
    for old, new in names.items():
        for name, corpus in ((old, source), (new, own)):
            if name not in set(corpus.gestures):
                raise InputError(
                    f"protocol.classes={old}:{new}: {corpus.name} has no {name!r}; it has "
                    f"{', '.join(sorted(set(corpus.gestures)))}"
                )
    _refuse_the_same(own, source)
    called = np.array([names.get(name, name) for name in source.gestures], dtype=object)
    shared = set(own.gestures) & set(called)
    if len(shared) < 2:
        theirs, ours = (", ".join(sorted(set(c.gestures))) for c in (source, own))
        raise InputError(
            f"protocol=transfer: {own.name} and {source.name} share {len(shared)} classes; name more with "
            f"protocol.classes=, which maps those of {source.name} ({theirs}) to those of {own.name} ({ours})"
        )
    here = np.flatnonzero(np.isin(own.gestures, list(shared)))
    there = np.flatnonzero(np.isin(called, list(shared)))
    own, source = own[here], source[there]
    about = own.captures.assign(skin=OWN)
    other = pd.DataFrame({name: source.captures.get(name, "") for name in own.captures}, index=source.captures.index)
    who = "other " + source.captures["subject"].astype(str)
    other = other.assign(subject=who, gesture=called[there], skin=SOURCE)
    rate_hz = min(own.rate_hz, source.rate_hz)
    rows, cols = (min(sides) for sides in zip(own.grid, source.grid, strict=True))
    arrays = [frames for part in (own, source) for frames in brought(part, rate_hz, (rows, cols), own.full_scale)]
    info = {
        "source": f"{own.name} and {source.name}, brought to one rate and grid",
        "licence": "; ".join(dict.fromkeys(str(c.info.get("licence", "")) for c in (own, source))),
        "synthetic": own.synthetic or source.synthetic,
        "warnings": [*own.info.get("warnings", []), *(f"{source.name}: {w}" for w in source.info.get("warnings", []))],
        "format": "transfer",
        "source_name": source.name,
    }
    return Corpus.from_captures(
        arrays,
        pd.concat([about, other], ignore_index=True).astype({name: "str" for name in about}),
        rate_hz,
        full_scale=own.full_scale,
        name=own.name,
        info=info,
    )
