"""Duplicate captures: one recording twice in a corpus, or in two corpora."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from hashlib import blake2b

import numpy as np

from bench.corpora.corpus import Corpus

LEAST_CHANGES = 8  # readings that change in a capture; with fewer, two can be equal by chance


def identical_groups(
    captures: Sequence[np.ndarray] | Corpus, full_scales: Sequence[float] | None = None
) -> list[list[int]]:
    """Groups of captures with the same frames: equal in number, grid and every reading.

    Only captures with equal middle frames are read as a whole, so it costs little if nothing is
    the same.

    Args:
        captures: frames of each capture.
        full_scales: a full scale for each capture, to compare readings as shares of it.

    Returns:
        Positions, which rise within groups and in their first captures.
    """

    def group_equal(positions: Iterable[int], whole: bool) -> list[list[int]]:
        groups: dict[Hashable, list[int]] = {}
        for i in positions:
            frames = captures[i] if whole else captures[i][len(captures[i]) // 2 :][:1]
            full_scale = full_scales[i] if full_scales else 1.0
            key = captures[i].shape, frames_digest(frames, full_scale)
            groups.setdefault(key, []).append(i)
        return [group for group in groups.values() if len(group) > 1]

    likely = group_equal(range(len(captures)), whole=False)
    return sorted(group for part in likely for group in group_equal(part, whole=True))


def frames_digest(frames: np.ndarray, full_scale: float = 1.0) -> str:
    """Digest of readings as shares of full scale, whatever their type."""
    values = (frames / full_scale + 0).astype(np.float32)  # a zero has no sign
    return blake2b(values.tobytes(), digest_size=16).hexdigest()


def capture_digests(corpus: Corpus) -> list[str]:
    """A digest of the frames of each capture; "" for a quiet one, which another can equal."""
    return ["" if is_quiet(frames) else frames_digest(frames) for frames in corpus]


def is_quiet(frames: np.ndarray) -> bool:
    """True for a capture that varies so little that another can be equal by chance, as no touch.

    Fewer than `LEAST_CHANGES` readings differ from that of the same taxel one frame before; in a
    capture of a single frame, from that of the taxel before.
    """
    readings = frames.reshape(len(frames), -1)
    changes = np.diff(readings, axis=0 if len(readings) > 1 else 1)
    return bool(np.count_nonzero(changes) < LEAST_CHANGES)


def repeated_groups(corpus: Corpus) -> list[list[int]]:
    """Groups of captures that are one recording: identical ones that are not quiet."""
    return [group for group in identical_groups(corpus) if not is_quiet(corpus[group[0]])]


def shared_captures(target: Corpus, source: Corpus) -> list[tuple[int, int]]:
    """Captures in both of two corpora: equal in their readings or in shares of full scale.

    Quiet captures do not count.

    Returns:
        Positions in ``target`` and in ``source``, a pair for each such capture of ``target``.
    """
    captures, count = [*target, *source], len(target)
    scales = [target.full_scale] * count + [source.full_scale] * len(source)
    pairs: dict[int, int] = {}
    for group in [*identical_groups(captures), *identical_groups(captures, scales)]:
        in_source = [i - count for i in group if i >= count]
        if in_source and not is_quiet(captures[group[0]]):
            pairs |= {i: in_source[0] for i in group if i < count}
    return sorted(pairs.items())


def leaked_captures(
    groups: list[list[int]], sides: Iterable[tuple[np.ndarray, np.ndarray]], count: int
) -> list[tuple[int, int]]:
    """Test captures whose frames a system was trained on.

    Args:
        groups: positions of captures with equal frames.
        sides: positions of training and test captures of each fold.
        count: number of captures.

    Returns:
        Positions of the test capture and of a training capture with the same frames.
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
    excluded, parts = np.ones(len(corpus), bool), []
    for column in filter(str.isidentifier, map(str, corpus.captures)):
        values = corpus.captures[column].tolist()
        value = values[position]
        fewer = excluded & [other == value for other in values]
        if isinstance(value, str | int) and fewer.sum() < excluded.sum():
            parts.append(f"{column} != {value!r}")
            excluded = fewer
    return " or ".join(parts)
