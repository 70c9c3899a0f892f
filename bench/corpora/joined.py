"""Several corpora as one: captures of one sensor converted to another, full scale, rate and grid each by a function.

Nothing is learnt, and what becomes of a capture depends on that capture alone. What the other sensor cannot hold is
lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.duplicates import describe_capture, shared_captures
from bench.errors import InputError

STUDIES = (
    "cost",
    "cuddlebot",
    "haart",
)  # formats of one study each: two corpora of a format are of the same people


def resampling_weights(count: int, wanted: int) -> np.ndarray:
    """Weights to resample values along an axis, with rows that sum to 1 [wanted, count].

    Both lie evenly over the same length. Where there are to be fewer, each is the mean over its share of that length;
    where there are to be more, each lies on the line between the two values whose middles are next to its own.
    """
    if wanted < count:
        edges = np.arange(wanted + 1) * count / wanted
        inside = np.clip(edges[1:, None], np.arange(count), np.arange(1, count + 1))
        return (
            (inside - np.clip(edges[:-1, None], np.arange(count), np.arange(1, count + 1)))
            * wanted
            / count
        )
    middles = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
    return np.clip(1 - np.abs(middles[:, None] - np.arange(count)), 0, 1)


def rescale(frames: np.ndarray, full_scale: float, wanted: float) -> np.ndarray:
    """Frames as the same shares of another full scale, float32."""
    return frames.astype(np.float32) * np.float32(wanted / full_scale)


def resample(frames: np.ndarray, rate_hz: float, wanted_hz: float) -> np.ndarray:
    """Frames [frames, rows, cols] at another rate, float32; their number is rounded, at least one stays.

    As `resampling_weights` says, without a weight for each pair of frames, of which a long capture has too many.
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
        return (values[low] * (1 - part) + values[np.minimum(low + 1, n - 1)] * part).astype(
            np.float32
        )
    edges = np.arange(count + 1) * n / count
    full = np.minimum(edges.astype(int), n - 1)
    until = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    sums = until[full] + (edges - full)[:, None, None] * values[full]
    return (np.diff(sums, axis=0) * count / n).astype(np.float32)


def regrid(frames: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Frames [frames, rows, cols] on another grid over the same area, float32."""
    if frames.shape[1:] == (rows, cols):
        return frames.astype(np.float32)
    down, across = (
        resampling_weights(n, w).astype(np.float32)
        for n, w in zip(frames.shape[1:], (rows, cols), strict=True)
    )
    return down @ frames.astype(np.float32) @ across.T


def convert_captures(
    corpus: Corpus, rate_hz: float, grid: tuple[int, int], full_scale: float
) -> list[np.ndarray]:
    """Captures of a corpus converted to the rate, grid and full scale of another sensor, float32."""
    shares = (rescale(frames, corpus.full_scale, full_scale) for frames in corpus)
    return [regrid(resample(values, corpus.rate_hz, rate_hz), *grid) for values in shares]


def refuse_same_recordings(target: Corpus, source: Corpus, what: str) -> None:
    """Refuse two corpora with the same captures or people; ``what`` is the key that names them, for the error."""
    if pairs := shared_captures(target, source):
        first, same = pairs[0]
        raise InputError(
            f"{what}: {target.name} and {source.name} have the same captures: {len(pairs)}, such as "
            f"{describe_capture(target, first)} and {describe_capture(source, same)}; name another corpus"
        )
    for one, other in product(_origins(target), _origins(source)):
        study = one["format"] == other["format"] and one["format"] in STUDIES
        if study or {*one["digests"]} & {*other["digests"]}:
            raise InputError(
                f"{what}: {one['name']} and {other['name']} are imports of the same recordings; name another corpus"
            )
    if target.synthetic and target.info.get("source") == source.info.get("source"):
        raise InputError(
            f"{what}: generated captures of one seed are of the same people; give another seed, such as seed=1"
        )


def _origins(corpus: Corpus) -> list[dict[str, Any]]:
    """Format, name and digests (as stored, and before changes at import) of the corpora that captures come from."""
    if parts := corpus.info.get("parts"):
        return parts
    kind = "" if corpus.synthetic else str(corpus.info.get("format", ""))
    digests = [digest for digest in (corpus.digest, corpus.info.get("unchanged")) if digest]
    return [{"format": kind, "name": corpus.name, "digests": digests}]


def join_corpora(corpora: Sequence[Corpus]) -> Corpus:
    """Captures of several corpora as one corpus in memory, of the classes that all have.

    All are brought to the lowest of their rates and, each way, to the fewest of their taxels; the full scale is that of
    the first. The column ``corpus`` says where a capture comes from. Subjects are named
    after their corpus: ``haart 1``. Conditions that only some corpora have are left out, and so is ``split``.
    """
    name = "+".join(corpus.name for corpus in corpora)
    for one, other in combinations(corpora, 2):
        refuse_same_recordings(one, other, f"data={name}")
    classes = sorted(set.intersection(*(set(corpus.gestures) for corpus in corpora)))
    if len(classes) < 2:
        those = "; ".join(f"{corpus.name}: {class_names(corpus)}" for corpus in corpora)
        raise InputError(
            f"data={name}: {len(classes)} classes are in all of them; two are needed ({those})"
        )
    parts = [corpus[np.flatnonzero(np.isin(corpus.gestures, classes))] for corpus in corpora]
    columns = [
        c for c in parts[0].captures if c != "split" and all(c in part.captures for part in parts)
    ]
    tables = [
        part.captures[columns].assign(
            subject=part.name + " " + part.captures["subject"].astype(str), corpus=part.name
        )
        for part in parts
    ]
    frames, fields = convert_to_common(parts)
    info = joint_info(parts) | {
        "format": "joined",
        "parts": [origin for part in parts for origin in _origins(part)],
    }
    return Corpus.from_captures(
        frames, pd.concat(tables).astype("str"), name=name, info=info, **fields
    )


def convert_to_common(parts: Sequence[Corpus]) -> tuple[list[np.ndarray], dict[str, float]]:
    """Captures brought to what all sensors can give, and their rate and full scale."""
    rate_hz, full_scale = min(part.rate_hz for part in parts), parts[0].full_scale
    grid = min(part.grid[0] for part in parts), min(part.grid[1] for part in parts)
    frames = [f for part in parts for f in convert_captures(part, rate_hz, grid, full_scale)]
    return frames, {"rate_hz": rate_hz, "full_scale": full_scale}


def joint_info(parts: Sequence[Corpus]) -> dict[str, object]:
    """Origin, licences and warnings of several corpora; a warning of the first one does not name it."""
    names = " and ".join(part.name for part in parts)
    synthetic = any(part.synthetic for part in parts)
    first, *others = parts
    twice = f"whether a person is in more than one of {names} is unknown; each counts as another"
    warnings = [] if synthetic else [twice]
    warnings += first.info.get("warnings", [])
    warnings += [
        f"{part.name}: {text}" for part in others for text in part.info.get("warnings", [])
    ]
    return {
        "source": f"{names}, brought to one rate and grid",
        "licence": "; ".join(dict.fromkeys(str(part.info.get("licence", "")) for part in parts)),
        "synthetic": synthetic,
        "warnings": warnings,
    }


def class_names(corpus: Corpus) -> str:
    """Its class names, sorted."""
    return ", ".join(sorted(set(corpus.gestures)))
