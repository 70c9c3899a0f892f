"""Duplicate captures: one recording twice in a corpus, or in two corpora."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from hashlib import blake2b

import numpy as np

from bench.corpora.corpus import Corpus

CHANGES = 8  # readings that change in a capture, below which two captures can be equal by chance


def identical_groups(
    captures: Sequence[np.ndarray] | Corpus, full_scales: Sequence[float] | None = None
) -> list[list[int]]:
    """Groups of captures that have the same frames: equal in number, grid and every reading.

    Only captures with equal middle frames are read as a whole, so that it costs little where nothing is the same. With
    a full scale for each capture, readings are compared as shares of it. Positions rise, within groups and in their
    first captures.
    """

    def alike(positions: Iterable[int], whole: bool) -> list[list[int]]:
        groups: dict[Hashable, list[int]] = {}
        for i in positions:
            some = captures[i] if whole else captures[i][len(captures[i]) // 2 :][:1]
            values = (some / (full_scales[i] if full_scales else 1.0) + 0).astype(
                np.float32
            )  # a zero has no sign
            key = captures[i].shape, blake2b(values.tobytes(), digest_size=16).digest()
            groups.setdefault(key, []).append(i)
        return [group for group in groups.values() if len(group) > 1]

    return sorted(
        group for likely in alike(range(len(captures)), False) for group in alike(likely, True)
    )


def is_quiet(frames: np.ndarray) -> bool:
    """Return True if a capture varies so little that another one can be equal by chance, such as no touch.

    Fewer than `CHANGES` readings differ from that of the same taxel one frame before; in a capture of a single frame,
    from that of the taxel before.
    """
    readings = frames.reshape(len(frames), -1)
    return bool(np.count_nonzero(np.diff(readings, axis=0 if len(readings) > 1 else 1)) < CHANGES)


def repeated_groups(corpus: Corpus) -> list[list[int]]:
    """Groups of captures that are one recording: `identical_groups` ones, without `is_quiet` ones."""
    return [group for group in identical_groups(corpus) if not is_quiet(corpus[group[0]])]


def shared_captures(target: Corpus, source: Corpus) -> list[tuple[int, int]]:
    """Captures in both of two corpora, without `is_quiet` ones: equal in their readings or in shares of full scale.

    Pairs of positions, in ``target`` and in ``source``; one for each such capture of ``target``.
    """
    captures, count = [*target, *source], len(target)
    scales = [target.full_scale] * count + [source.full_scale] * len(source)
    pairs: dict[int, int] = {}
    for group in [*identical_groups(captures), *identical_groups(captures, scales)]:
        theirs = [i - count for i in group if i >= count]
        if theirs and not is_quiet(captures[group[0]]):
            pairs |= {i: theirs[0] for i in group if i < count}
    return sorted(pairs.items())


def leaked_captures(
    groups: list[list[int]], sides: Iterable[tuple[np.ndarray, np.ndarray]], count: int
) -> list[tuple[int, int]]:
    """Tested captures whose frames a system was trained on, with a trained one each, by position.

    Groups are of equal frames; sides are training and test captures of each fold; ``count`` is that of all captures.
    """
    group_of = np.full(count, -1)
    for number, group in enumerate(groups):
        group_of[group] = number
    pairs: dict[int, int] = {}
    for train, test in sides:
        trained = {int(group_of[i]): int(i) for i in reversed(train[group_of[train] >= 0])}
        for i in test[np.isin(group_of[test], list(trained))]:
            pairs.setdefault(int(i), trained[int(group_of[i])])
    return sorted(pairs.items())


def describe_capture(corpus: Corpus, position: int) -> str:
    """A capture in words, with its number in the whole corpus."""
    row = corpus.captures.iloc[position]
    return f"capture {corpus.index[position]} (subject {row['subject']}, gesture {row['gesture']})"


def excluding_condition(corpus: Corpus, position: int) -> str:
    """A condition (``where=``) that excludes a capture, and as few others as its columns allow."""
    like, parts = np.ones(len(corpus), bool), []
    for column in filter(str.isidentifier, map(str, corpus.captures)):
        values = corpus.captures[column].tolist()
        value = values[position]
        fewer = like & [other == value for other in values]
        if isinstance(value, str | int) and fewer.sum() < like.sum():
            parts.append(f"{column} != {value!r}")
            like = fewer
    return " or ".join(parts)
