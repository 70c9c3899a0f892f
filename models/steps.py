"""Steps before a system that change its captures: damage for training, repair, scaling.

`Repair` and `Scale` are causal: a frame depends on earlier frames only, so that a robot can do the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bench.corpora.corpus import COPY, Corpus, corpus_origin, shared_frames
from bench.corpora.faults import SEVERITIES, all_faults, as_readings, as_shares, seeded_generator
from bench.corpora.windows import Step
from bench.errors import InputError, suggest_names

REPAIRS = ("stuck", "dead", "offset")
SCALES = ("none", "peak", "log")
LOG_FACTOR = 1000.0  # a reading of a thousandth of full scale is at a tenth of the logarithmic one
MAX_COPIES = (
    2**20 - 1
)  # of a capture, damaged; the number of a turned one comes above that in its piece
MOUNTINGS = 8  # of a square grid: mirrored or not, turned by quarters
SETTLED_S = 0.25  # what has not moved for so long is not touched, or broken
FILL_PASSES = 3  # broken taxels without a sound neighbour are filled from filled ones


class _CopyingStep(Step):
    """Captures, each followed by as many copies."""

    copies: int

    def source_rows(self, corpus: Corpus) -> np.ndarray:
        """Each capture once and once for each copy."""
        return np.repeat(np.arange(len(corpus)), self.copies + 1)

    def _with_copies(self, corpus: Corpus, arrays: list[np.ndarray], stride: int) -> Corpus:
        """The captures and their copies, whose pieces are ``stride`` apart."""
        row = self.source_rows(corpus)
        copies = np.tile(np.arange(self.copies + 1, dtype=np.int64), len(corpus))
        return _with_frames(
            corpus[row], arrays, self, piece=corpus_origin(corpus).piece[row] + copies * stride
        )


@dataclass(frozen=True)
class DamagedCopies(_CopyingStep):
    """Captures, each followed by damaged copies: one of the faults each, at a random severity.

    The draws are of their own: no test capture, whose damage depends on the fault and the capture or subject alone
    (`bench.corpora.faults`), ever gets one of them.
    """

    faults: tuple[str, ...]
    copies: int = 3

    def __post_init__(self) -> None:
        for name in self.faults:
            if name not in all_faults():
                names = "+".join(self.faults)
                raise InputError(
                    f"model.faults={names}: {name!r} is no fault; {suggest_names(name, all_faults())}"
                )
        if not 1 <= self.copies <= MAX_COPIES:
            raise InputError(f"model.copies={self.copies}: give 1 to {MAX_COPIES}")

    def code_objects(self) -> list[Callable]:
        """The faults as well, which may come from other packages."""
        return [DamagedCopies, *(all_faults()[name].damage for name in self.faults)]

    def copy_generator(self, capture: int, copy: int) -> np.random.Generator:
        """The random numbers of one copy of one stored capture."""
        return seeded_generator(f"training copy {copy} of capture {capture}")

    def __call__(self, corpus: Corpus) -> Corpus:
        """The captures as they are, each followed by its copies."""
        faults = [all_faults()[name] for name in self.faults]
        index = corpus_origin(corpus).index
        arrays: list[np.ndarray] = []
        for i, shares in enumerate(as_shares(corpus, np.arange(len(corpus)))):
            arrays.append(corpus[i])
            for copy in range(self.copies):
                rng = self.copy_generator(int(index[i]), copy)
                fault, severity = faults[rng.integers(len(faults))], rng.integers(SEVERITIES)
                arrays.append(
                    as_readings(corpus, fault.apply_with(shares, severity + 1, rng, corpus.rate_hz))
                )
        return self._with_copies(corpus, arrays, COPY)


@dataclass(frozen=True)
class TurnedCopies(_CopyingStep):
    """Captures, each followed by copies as on a skin that was mounted otherwise: mirrored, or turned by quarters.

    A grid that is not square is mirrored, or turned by half. What the copies of a capture become is drawn, each
    something else as long as there is something else, and on more than one taxel never the capture as it is; it is the
    same in all frames.
    """

    copies: int

    def __post_init__(self) -> None:
        if not 1 <= self.copies < MOUNTINGS:
            raise InputError(f"model.turns={self.copies}: give 1 to {MOUNTINGS - 1}, or 0 for none")

    def __call__(self, corpus: Corpus) -> Corpus:
        """The captures as they are, each followed by its copies."""
        ways = _list_mountings(corpus.grid)
        source = corpus_origin(corpus)
        arrays: list[np.ndarray] = []
        for i, frames in enumerate(corpus):
            arrays.append(frames)
            rng = seeded_generator(f"turned copies of capture {source.index[i]}.{source.piece[i]}")
            order = rng.permutation(len(ways))
            arrays += [ways[order[copy % len(ways)]](frames) for copy in range(self.copies)]
        return self._with_copies(corpus, arrays, (MAX_COPIES + 1) * COPY)


def _list_mountings(grid: tuple[int, int]) -> list[Callable[[np.ndarray], np.ndarray]]:
    """What turns and mirrors frames, every way that moves a taxel of this grid; of one taxel, what does nothing."""
    quarters = range(4) if grid[0] == grid[1] else (0, 2)
    ways = [
        partial(_mount_frames, quarters=turns, mirrored=mirrored)
        for mirrored in (False, True)
        for turns in quarters
    ]
    taxels = np.arange(grid[0] * grid[1]).reshape(1, *grid)
    unmoved, *others = {way(taxels).tobytes(): way for way in ways}.values()
    return others or [unmoved]


def _mount_frames(frames: np.ndarray, quarters: int, mirrored: bool) -> np.ndarray:
    turned = np.rot90(frames, quarters, axes=(1, 2))
    return turned[:, :, ::-1] if mirrored else turned


@dataclass(frozen=True)
class Repair(Step):
    """Repair broken taxels, found in a capture's own past, by the mean of their sound neighbours.

    ``stuck``: a taxel has read full scale in every frame so far; or nothing but one value for a quarter of a second,
    above all taxels that have varied. ``dead``: nothing but one value for a quarter of a second, while more than half
    of its neighbours have varied. ``offset``: the least value so far of each taxel is taken away, a touch that never
    lets go with it.
    """

    kinds: tuple[str, ...]

    def __post_init__(self) -> None:
        for kind in self.kinds:
            if kind not in REPAIRS:
                raise InputError(
                    f"model.repair={'+'.join(self.kinds)}: give {' or '.join(REPAIRS)}, joined by +"
                )

    def kept_numbers(self, taxels: int) -> int:
        """Numbers per taxel: the least and largest value, moved and sound flags, the mean around it, an offset."""
        return (5 * bool({"stuck", "dead"} & set(self.kinds)) + ("offset" in self.kinds)) * taxels

    def __call__(self, corpus: Corpus) -> Corpus:
        """The captures repaired, float32."""
        settled = max(2, int(np.ceil(SETTLED_S * corpus.rate_hz)))
        frames = np.empty((int(corpus.lengths.sum()), *corpus.grid), dtype=np.float32)
        for end, given in zip(np.cumsum(corpus.lengths), corpus, strict=True):
            mine = frames[end - len(given) : end]
            mine[:] = given
            self._repair(mine, corpus.full_scale, settled)
        steps = (*corpus_origin(corpus).steps, self)
        return corpus.with_fields(
            frames=frames, lengths=corpus.lengths.astype(np.int64), steps=steps
        )

    def _repair(self, frames: np.ndarray, full_scale: float, settled: int) -> None:
        still = _running_extreme(np.logical_and, frames == frames[:1])
        long = still & (np.arange(len(frames)) >= settled - 1)[:, None, None]
        broken = np.zeros_like(still)
        if "stuck" in self.kinds:
            varied = np.where(still, -1, frames).max(axis=(1, 2))
            broken |= _running_extreme(np.logical_and, frames >= full_scale)
            broken |= long & (frames > varied[:, None, None]) & (varied >= 0)[:, None, None]
        if "dead" in self.kinds and long.any():
            sides = sum_neighbours(np.ones_like(frames[:1]))
            broken |= long & (2 * sum_neighbours((~still).astype(np.float32)) > sides)
        if broken.any():
            damaged = np.flatnonzero(broken.any(axis=(1, 2)))
            frames[damaged] = _fill_broken(frames[damaged], broken[damaged])
        if "offset" in self.kinds:
            frames -= _running_extreme(np.minimum, frames)


def _running_extreme(extreme: np.ufunc, frames: np.ndarray) -> np.ndarray:
    """The least value of each taxel up to each frame, or whether all are true: over twice as many frames each round.

    numpy's accumulate walks through each taxel by itself, which takes 17 times as long on 32 x 32 taxels.
    """
    found, span = frames.copy(), 1
    while span < len(found):
        found[span:] = extreme(found[span:], found[:-span])
        span *= 2
    return found


def sum_neighbours(frames: np.ndarray) -> np.ndarray:
    """Sum over the up to 8 neighbours of each taxel [frames, rows, cols]."""
    wide = np.pad(frames, ((0, 0), (1, 1), (1, 1)))
    rows = wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]
    return rows[:, :, :-2] + rows[:, :, 1:-1] + rows[:, :, 2:] - frames


def _fill_broken(frames: np.ndarray, broken: np.ndarray) -> np.ndarray:
    """Broken taxels as the mean of their sound neighbours; 0 where none is near."""
    sound = (~broken).astype(np.float32)
    values = frames * sound
    for _ in range(FILL_PASSES):
        count = sum_neighbours(sound)
        new = (sound == 0) & (count > 0)
        if not new.any():
            break
        mean = sum_neighbours(values) / np.maximum(count, 1)
        values[new] = mean[new]
        sound[new] = 1
    return values


@dataclass(frozen=True)
class Scale(Step):
    """Captures on another scale, for systems whose inputs must not be tiny: many sensors are hardly ever pressed fully.

    ``peak``: divided by the largest reading of their own past, so that a sensor's gain tells nothing. ``log``: the
    logarithm of 1 + 1000 times the share of full scale, and full scale stays where it is.
    """

    kind: str

    def __post_init__(self) -> None:
        if self.kind not in SCALES[1:]:
            raise InputError(f"model.scale={self.kind}: give {' or '.join(SCALES)}")

    def __call__(self, corpus: Corpus) -> Corpus:
        """The captures scaled to 0..full_scale, float32; readings of nothing stay 0."""
        scaled = self._scale_logarithm if self.kind == "log" else self._scale_peak
        return _with_frames(
            corpus,
            [scaled(frames.astype(np.float32), corpus.full_scale) for frames in corpus],
            self,
        )

    def _scale_logarithm(self, frames: np.ndarray, full_scale: float) -> np.ndarray:
        shares = (frames / np.float32(full_scale)).clip(0, 1)
        scaled = np.log1p(shares * np.float32(LOG_FACTOR)) * np.float32(
            full_scale / np.log1p(LOG_FACTOR)
        )
        return np.minimum(scaled, np.float32(full_scale))  # rounding may leave it above

    def _scale_peak(self, frames: np.ndarray, full_scale: float) -> np.ndarray:
        most = np.maximum.accumulate(frames.max(axis=(1, 2)))
        gain = (full_scale / np.where(most > 0, most, 1)).astype(np.float32)
        return np.minimum(frames * gain[:, None, None], np.float32(full_scale))


def _with_frames(
    corpus: Corpus, arrays: list[np.ndarray], step: object, **fields: object
) -> Corpus:
    """The same captures with other frames, one array [frames, rows, cols] each."""
    return corpus.with_fields(
        frames=np.concatenate(arrays) if arrays else shared_frames(corpus)[0][:0],
        lengths=np.array([len(frames) for frames in arrays], dtype=np.int64),
        steps=(*corpus_origin(corpus).steps, step),
        **fields,
    )
