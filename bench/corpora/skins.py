"""Captures of one skin converted to another: full scale, rate and grid, each by a function of its own.

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
    """Weights to resample values along an axis, with rows that sum to 1 [wanted, count].

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
    middles = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
    return np.clip(1 - np.abs(middles[:, None] - np.arange(count)), 0, 1)


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
        middles = np.clip((np.arange(count) + 0.5) * n / count - 0.5, 0, n - 1)
        low = middles.astype(int)
        part = (middles - low)[:, None, None]
        return (values[low] * (1 - part) + values[np.minimum(low + 1, n - 1)] * part).astype(np.float32)
    edges = np.arange(count + 1) * n / count
    full = np.minimum(edges.astype(int), n - 1)
    until = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    sums = until[full] + (edges - full)[:, None, None] * values[full]
    return (np.diff(sums, axis=0) * count / n).astype(np.float32)


def regridded(frames: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Frames [frames, rows, cols] on another grid over the same area, float32."""
    if frames.shape[1:] == (rows, cols):
        return frames.astype(np.float32)
    down, across = (weights(n, w).astype(np.float32) for n, w in zip(frames.shape[1:], (rows, cols), strict=True))
    return down @ frames.astype(np.float32) @ across.T


def brought(corpus: Corpus, rate_hz: float, grid: tuple[int, int], full_scale: float) -> list[np.ndarray]:
    """Captures of a corpus converted to the rate, grid and full scale of another skin, float32."""
    shares = (scaled(frames, corpus.full_scale, full_scale) for frames in corpus)
    return [regridded(resampled(values, corpus.rate_hz, rate_hz), *grid) for values in shares]


def _refuse_the_same(target: Corpus, source: Corpus) -> None:
    """Nobody is trained on who is tested.

    Raises:
        InputError: a capture is in both, or both are generated from one seed, and so of the same people.
    """
    if pairs := shared(target, source):
        first, same = pairs[0]
        raise InputError(
            f"protocol=transfer: {target.name} and {source.name} have the same captures: {len(pairs)}, such as "
            f"{named(target, first)} and {named(source, same)}; name another source"
        )
    if target.synthetic and target.info.get("source") == source.info.get("source"):
        raise InputError(
            "protocol=transfer: generated captures of one seed are of the same people; add +seed=1 to protocol.source="
        )


def joined(target: Corpus, source: Corpus, names: dict[str, str]) -> Corpus:
    """Captures of one skin, and behind them those of another, of the classes that both have.

    Both are brought to the lower of their rates, and each way to the fewer of their taxels; the full scale is that of
    the first. What is the same already stays as it is.

    Args:
        target: captures.
        source: captures of the other skin.
        names: names in ``target`` of classes of ``source``, where they differ.

    Returns:
        A corpus in memory, float32, whose column ``skin`` says which is which. People of the other skin are others,
        whatever they are called.

    Raises:
        InputError: a class that is not there is given a name, less than two are left, or a capture is in both.
    """
    for old, new in names.items():
        for name, corpus in ((old, source), (new, target)):
            if name not in set(corpus.gestures):
                raise InputError(
                    f"protocol.classes={old}:{new}: {corpus.name} has no {name!r}; it has {_classes_of(corpus)}"
                )
    _refuse_the_same(target, source)
    renamed = np.array([names.get(name, name) for name in source.gestures], dtype=object)
    classes = sorted(set(target.gestures) & set(renamed))
    if len(classes) < 2:
        raise InputError(
            f"protocol=transfer: {target.name} and {source.name} share {len(classes)} classes; name more with "
            f"protocol.classes=, which maps those of {source.name} ({_classes_of(source)}) to those of {target.name} "
            f"({_classes_of(target)})"
        )
    kept = np.flatnonzero(np.isin(renamed, classes))
    target, source = target[np.flatnonzero(np.isin(target.gestures, classes))], source[kept]
    columns = list(target.captures)
    rows = source.captures.reindex(columns=columns, fill_value="").assign(
        subject="other " + source.captures["subject"].astype(str), gesture=renamed[kept], skin=SOURCE
    )
    captures = pd.concat([target.captures.assign(skin=OWN), rows], ignore_index=True)
    rate_hz = min(target.rate_hz, source.rate_hz)
    grid = min(target.grid[0], source.grid[0]), min(target.grid[1], source.grid[1])
    info = {
        "source": f"{target.name} and {source.name}, brought to one rate and grid",
        "licence": "; ".join(dict.fromkeys(str(c.info.get("licence", "")) for c in (target, source))),
        "synthetic": target.synthetic or source.synthetic,
        "warnings": [
            *target.info.get("warnings", []),
            *(f"{source.name}: {text}" for text in source.info.get("warnings", [])),
        ],
        "format": "transfer",
        "source_name": source.name,
    }
    return Corpus.from_captures(
        [frames for part in (target, source) for frames in brought(part, rate_hz, grid, target.full_scale)],
        captures.astype("str"),
        rate_hz,
        full_scale=target.full_scale,
        name=target.name,
        info=info,
    )


def _classes_of(corpus: Corpus) -> str:
    return ", ".join(sorted(set(corpus.gestures)))
