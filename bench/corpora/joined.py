"""Several corpora as one: captures of a sensor at the full scale, rate and grid of another.

Nothing is learnt, and each converted capture depends on one original capture alone. What the other
sensor cannot measure is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import SOURCE, Corpus
from bench.corpora.duplicates import describe_capture, shared_captures
from bench.corpora.spellings import unify_spellings
from bench.errors import InputError

STUDIES = ("cost", "cuddlebot", "haart")  # two corpora of one of these formats are the same people


def resampling_weights(count: int, wanted: int) -> np.ndarray:
    """Weights that resample values along an axis, with rows that sum to 1 [wanted, count].

    Both lie evenly over the same length. If there are to be fewer, each is the mean over its share
    of that length. If there are to be more, each is interpolated between the two values whose
    middles are next to its own.
    """
    if wanted < count:
        edges = np.arange(wanted + 1) * count / wanted
        first, last = np.arange(count), np.arange(1, count + 1)
        shares = np.clip(edges[1:, None], first, last) - np.clip(edges[:-1, None], first, last)
        return shares * wanted / count
    middles = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
    return np.clip(1 - np.abs(middles[:, None] - np.arange(count)), 0, 1)


def rescale(frames: np.ndarray, full_scale: float, wanted: float) -> np.ndarray:
    """Frames as the same shares of another full scale, float32."""
    return frames.astype(np.float32) * np.float32(wanted / full_scale)


def resample(frames: np.ndarray, rate_hz: float, wanted_hz: float) -> np.ndarray:
    """Frames at another rate, float32 [frames, rows, cols]; their number is rounded, at least 1.

    As by `resampling_weights`, whose table would be too large for a long capture.
    """
    count = len(frames)
    wanted = max(1, round(count * wanted_hz / rate_hz))
    if wanted == count:
        return frames.astype(np.float32)
    values = frames.astype(np.float64)
    if wanted > count:
        middles = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
        low = middles.astype(int)
        high, share = np.minimum(low + 1, count - 1), (middles - low)[:, None, None]
        return (values[low] * (1 - share) + values[high] * share).astype(np.float32)
    edges = np.arange(wanted + 1) * count / wanted
    return (sum_between(values, edges) * wanted / count).astype(np.float32)


def sum_between(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sums of float64 frames from each edge to the next, in which parts of frames count as such."""
    last = np.minimum(edges.astype(int), len(values) - 1)  # frame in which an edge lies
    before = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    return np.diff(before[last] + (edges - last)[:, None, None] * values[last], axis=0)


def regrid(frames: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Frames on another grid over the same area, float32 [frames, rows, cols]."""
    if frames.shape[1:] == (rows, cols):
        return frames.astype(np.float32)
    down = resampling_weights(frames.shape[1], rows).astype(np.float32)
    across = resampling_weights(frames.shape[2], cols).astype(np.float32)
    return down @ frames.astype(np.float32) @ across.T


def convert_captures(
    corpus: Corpus, rate_hz: float, grid: tuple[int, int], full_scale: float
) -> list[np.ndarray]:
    """Captures at the rate, grid and full scale of another sensor, float32."""
    shares = (rescale(frames, corpus.full_scale, full_scale) for frames in corpus)
    return [regrid(resample(values, corpus.rate_hz, rate_hz), *grid) for values in shares]


def refuse_same_recordings(target: Corpus, source: Corpus, key: str) -> None:
    """Refuse two corpora with the same captures or people; messages begin with the ``key``."""
    if pairs := shared_captures(target, source):
        first, same = pairs[0]
        raise InputError(
            f"{key}: {target.name} and {source.name} have the same captures: {len(pairs)}, such as "
            f"{describe_capture(target, first)} and {describe_capture(source, same)}; "
            "name another corpus"
        )
    for one, other in product(_list_origins(target), _list_origins(source)):
        is_same_study = one["format"] == other["format"] and one["format"] in STUDIES
        if is_same_study or {*one["digests"]} & {*other["digests"]}:
            raise InputError(
                f"{key}: {one['name']} and {other['name']} are imports of the same recordings; "
                "name another corpus"
            )
    if target.synthetic and target.info.get("source") == source.info.get("source"):
        raise InputError(
            f"{key}: generated captures of one seed are of the same people; "
            "give another seed, such as seed=1"
        )


def _list_origins(corpus: Corpus) -> list[dict[str, Any]]:
    """Format, name and digests (stored, and before changes at import) of a corpus's parts."""
    if parts := corpus.info.get("parts"):
        return parts
    kind = "" if corpus.synthetic else str(corpus.info.get("format", ""))
    digests = [digest for digest in (corpus.digest, corpus.info.get("unchanged")) if digest]
    return [{"format": kind, "name": corpus.name, "digests": digests}]


def join_corpora(corpora: Sequence[Corpus]) -> Corpus:
    """Captures of several corpora as one corpus in memory, with the classes that all have.

    All get the lowest of their rates, the fewest of their rows and columns, and the full scale of
    the first. The column ``corpus`` says where a capture comes from; subjects are named after
    their corpus: ``haart 1``. Conditions that some corpora lack are left out, and so is ``split``.

    Gestures that differ only in spelling are one, under the name of the first corpus that has it.

    Raises:
        InputError: two corpora have the same recordings, or fewer than two classes are in all.
    """
    name = "+".join(corpus.name for corpus in corpora)
    for one, other in combinations(corpora, 2):
        refuse_same_recordings(one, other, f"data={name}")
    corpora, renamed = unify_gestures(corpora)
    classes = sorted(set.intersection(*(set(corpus.gestures) for corpus in corpora)))
    if len(classes) < 2:
        lists = "; ".join(f"{corpus.name}: {class_names(corpus)}" for corpus in corpora)
        raise InputError(
            f"data={name}: {len(classes)} classes are in all of them; two are needed ({lists})"
        )
    parts = [corpus[np.isin(corpus.gestures, classes)] for corpus in corpora]
    tables = []
    for part in parts:
        subjects = part.name + " " + part.captures["subject"].astype(str)
        tables.append(part.captures.assign(subject=subjects, **{SOURCE: part.name}))
    captures = pd.concat(tables, join="inner").drop(columns="split", errors="ignore").astype(str)
    frames, fields = convert_to_common(parts)
    origins = [origin for part in parts for origin in _list_origins(part)]
    info = joint_info(parts) | {"format": "joined", "parts": origins}
    info["warnings"] = [*renamed, *info["warnings"]]
    return Corpus.from_captures(frames, captures, name=name, info=info, **fields)


def add_corpora(corpus: Corpus, others: Sequence[Corpus]) -> Corpus:
    """Captures of a corpus, followed by those of others, which are trained on and never tested.

    The others get its rate, grid and full scale; its own captures keep their values, people and
    positions. Classes that it lacks are left out. The column ``corpus`` says where a capture comes
    from, and subjects of the others are named after their corpus.

    Raises:
        InputError: two corpora have the same recordings, or another one has no class of the first.
    """
    names = [other.name for other in others]
    key = f"also={'+'.join(names)}"
    for one, other in combinations([corpus, *others], 2):
        refuse_same_recordings(one, other, key)
    (corpus, *others), sentences = unify_gestures([corpus, *others])
    own = corpus.captures if corpus.is_joined else corpus.captures.assign(**{SOURCE: corpus.name})
    tables, frames = [own.astype(str)], [each.astype(np.float32) for each in corpus]
    for other in others:
        used = other[np.isin(other.gestures, corpus.gestures)]
        sentences += _describe_mixed_gestures(corpus, other)
        if not len(used):
            raise InputError(f"{key}: {sentences[-1]}; name another corpus")
        rows = used.captures.reindex(columns=[*own], fill_value="")
        subjects = f"{other.name} " + used.captures["subject"].astype(str)
        tables.append(rows.assign(subject=subjects, **{SOURCE: other.name}).astype(str))
        frames += convert_captures(used, corpus.rate_hz, corpus.grid, corpus.full_scale)
    origins = [origin for each in (corpus, *others) for origin in _list_origins(each)]
    info = corpus.info | {"parts": origins, "also": names, "tested_digest": corpus.digest}
    info["warnings"] = [*sentences, *corpus.info.get("warnings", [])]
    captures = pd.concat(tables, ignore_index=True)
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": info}
    return Corpus.from_captures(frames, captures, corpus.rate_hz, **fields)


def _describe_mixed_gestures(corpus: Corpus, other: Corpus) -> list[str]:
    """A sentence on gestures that only one of a corpus and an added one has, if there are any."""
    lacking = sorted({*corpus.gestures} - {*other.gestures})
    unused = sorted({*other.gestures} - {*corpus.gestures})
    parts = [f"has no capture of {', '.join(lacking)}"] * bool(lacking)
    parts += [f"its captures of {', '.join(unused)} are left out"] * bool(unused)
    return [f"{other.name} {' and '.join(parts)}"] * bool(parts)


def unify_gestures(corpora: Sequence[Corpus]) -> tuple[list[Corpus], list[str]]:
    """The corpora with gestures as the first of them spells them, and a sentence on each change."""
    unified, sentences = [], []
    changes = unify_spellings([set(corpus.captures["gesture"].astype(str)) for corpus in corpora])
    for corpus, spellings in zip(corpora, changes, strict=True):
        gestures = corpus.captures["gesture"].astype(str)
        for name, other in spellings.items():
            count = int((gestures == name).sum())
            sentences.append(f"gesture {name!r} of {corpus.name} ({count}x) is read as {other!r}")
        captures = corpus.captures.assign(gesture=gestures.replace(spellings))
        unified.append(corpus.with_fields(captures=captures) if spellings else corpus)
    return unified, sentences


def convert_to_common(parts: Sequence[Corpus]) -> tuple[list[np.ndarray], dict[str, float]]:
    """Captures converted to what all sensors can measure, and their rate and full scale."""
    rate_hz, full_scale = min(part.rate_hz for part in parts), parts[0].full_scale
    grid = min(part.grid[0] for part in parts), min(part.grid[1] for part in parts)
    frames = [f for part in parts for f in convert_captures(part, rate_hz, grid, full_scale)]
    return frames, {"rate_hz": rate_hz, "full_scale": full_scale}


def joint_info(parts: Sequence[Corpus]) -> dict[str, object]:
    """The ``info`` of several corpora; a warning of the first one does not name it."""
    names = " and ".join(part.name for part in parts)
    synthetic = any(part.synthetic for part in parts)
    warnings = []
    if not synthetic:
        warnings.append(
            f"whether a person is in more than one of {names} is unknown; each counts as another"
        )
    for part in parts:
        prefix = "" if part is parts[0] else f"{part.name}: "
        warnings += [f"{prefix}{text}" for text in part.info.get("warnings", [])]
    return {
        "source": f"{names}, brought to one rate and grid",
        "licence": "; ".join(dict.fromkeys(str(part.info.get("licence", "")) for part in parts)),
        "synthetic": synthetic,
        "warnings": warnings,
    }


def class_names(corpus: Corpus) -> str:
    """Class names of a corpus, sorted."""
    return ", ".join(sorted(set(corpus.gestures)))
