"""Steps before a system that change its captures: damage for training, repair, scaling.

`Repair` and `Scale` are causal: a frame depends on earlier frames only, so that a robot can do the
same.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bench.corpora.corpus import COPY, Corpus, shared_frames, unblind
from bench.corpora.faults import FAULTS, SEVERITIES, as_readings, as_shares, seeded_generator
from bench.corpora.windows import Step
from bench.errors import InputError, check_value, suggest_names

REPAIRS = ("stuck", "dead", "offset", "noise")
SCALES = ("none", "peak", "log")
LOG_FACTOR = 1000.0  # a reading of 1/1000 of full scale becomes a tenth of it
MAX_COPIES = 2**20 - 1  # damaged ones of a capture; numbers of turned ones lie above in the piece
MOUNTINGS = 8  # of a square grid: mirrored or not, turned by quarters
SETTLED_S = 0.25  # a taxel that has not changed for this long is not touched, or broken
FILL_PASSES = 3  # broken taxels without a sound neighbour are filled from filled ones
DENOISED_FRAMES = 5  # of which the mean is taken; the middle one is denoised
NOISE_STEPS = 32  # from frame to frame, in which noise is measured
STEP_MEMORY = NOISE_STEPS + DENOISED_FRAMES  # frames that a repaired one depends on, with extremes
QUIET_PART = 4  # noise is the level below which a quarter of the rows and columns are
DENOISED_VALUES = 1 << 20  # readings that are denoised at once


class _CopyingStep(Step):
    """Captures, each followed by a number of copies."""

    copies: int

    def source_rows(self, corpus: Corpus) -> np.ndarray:
        """Position of the original of each capture and copy."""
        return np.repeat(np.arange(len(corpus)), self.copies + 1)

    def _with_copies(self, corpus: Corpus, arrays: list[np.ndarray], stride: int) -> Corpus:
        """Captures and their copies, whose pieces are ``stride`` apart."""
        source = self.source_rows(corpus)
        copy = np.tile(np.arange(self.copies + 1, dtype=np.int64), len(corpus))
        piece = unblind(corpus).piece[source] + copy * stride
        return _with_frames(corpus[source], arrays, self, piece=piece)


@dataclass(frozen=True)
class DamagedCopies(_CopyingStep):
    """Captures, each followed by damaged copies, each with a random fault and severity.

    The random numbers are not those of test captures, whose damage depends on the fault and the
    capture or subject alone (`bench.corpora.faults`).
    """

    faults: tuple[str, ...]
    copies: int = 3

    def __post_init__(self) -> None:
        for name in self.faults:
            if name not in FAULTS:
                hint = suggest_names(name, FAULTS)
                names = "+".join(self.faults)
                raise InputError(f"model.faults={names}: {name!r} is no fault; {hint}")
        is_valid = 1 <= self.copies <= MAX_COPIES
        check_value("model.copies", self.copies, is_valid, f"1 to {MAX_COPIES}")

    def code_objects(self) -> list[Callable]:
        """This class, and the faults, which may come from other packages."""
        return [DamagedCopies, *(FAULTS[name].damage for name in self.faults)]

    def copy_generator(self, capture: int, copy: int) -> np.random.Generator:
        """Random numbers of one copy of one stored capture."""
        return seeded_generator(f"training copy {copy} of capture {capture}")

    def __call__(self, corpus: Corpus) -> Corpus:
        """Captures, each followed by its copies."""
        faults = [FAULTS[name] for name in self.faults]
        index = unblind(corpus).index
        arrays: list[np.ndarray] = []
        for i, shares in enumerate(as_shares(corpus, np.arange(len(corpus)))):
            arrays.append(corpus[i])
            for copy in range(self.copies):
                rng = self.copy_generator(int(index[i]), copy)
                fault, severity = faults[rng.integers(len(faults))], rng.integers(SEVERITIES)
                damaged = fault.apply_with(shares, severity + 1, rng, corpus.rate_hz)
                arrays.append(as_readings(corpus, damaged))
        return self._with_copies(corpus, arrays, COPY)


@dataclass(frozen=True)
class TurnedCopies(_CopyingStep):
    """Captures, each followed by copies as on a skin in another mounting.

    A square grid is mirrored or turned by quarters, another one mirrored or turned by half. The
    mountings of a capture's copies are drawn without repetition as long as there are others, never
    its own on more than one taxel, and are the same in all frames.
    """

    copies: int

    def __post_init__(self) -> None:
        advice = f"1 to {MOUNTINGS - 1}, or 0 for none"
        check_value("model.turns", self.copies, 1 <= self.copies < MOUNTINGS, advice)

    def __call__(self, corpus: Corpus) -> Corpus:
        """Captures, each followed by its copies."""
        mountings = _list_mountings(corpus.grid)
        origin = unblind(corpus)
        arrays: list[np.ndarray] = []
        for i, frames in enumerate(corpus):
            arrays.append(frames)
            rng = seeded_generator(f"turned copies of capture {origin.index[i]}.{origin.piece[i]}")
            order = rng.permutation(len(mountings))
            for copy in range(self.copies):
                mount = mountings[order[copy % len(mountings)]]
                arrays.append(mount(frames))
        return self._with_copies(corpus, arrays, (MAX_COPIES + 1) * COPY)


def _list_mountings(grid: tuple[int, int]) -> list[Callable[[np.ndarray], np.ndarray]]:
    """Make functions that turn or mirror frames, one for each other arrangement of the taxels.

    Of one taxel it is the one that changes nothing.
    """
    quarters = range(4) if grid[0] == grid[1] else (0, 2)
    options = itertools.product((False, True), quarters)
    mountings = [partial(_mount_frames, mirrored=flip, quarters=turns) for flip, turns in options]
    taxels = np.arange(grid[0] * grid[1]).reshape(1, *grid)
    unmoved, *others = {mount(taxels).tobytes(): mount for mount in mountings}.values()
    return others or [unmoved]


def _mount_frames(frames: np.ndarray, quarters: int, mirrored: bool) -> np.ndarray:
    """Turn frames by quarters, then mirror them."""
    turned = np.rot90(frames, quarters, axes=(1, 2))
    return turned[:, :, ::-1] if mirrored else turned


@dataclass(frozen=True)
class Repair(Step):
    """Detect broken taxels in a capture's own past and fill them with the mean of sound neighbours.

    ``stuck``: a taxel has read full scale in every frame so far; or one single value for a quarter
    of a second, above all taxels that have varied. ``dead``: one single value for a quarter of a
    second, while more than half of its neighbours have varied. ``offset``: the lowest value so far
    of each taxel is subtracted, and with it a touch that lasts from the start. ``noise``: readings
    go to the mean of the five frames and nine taxels about them, as far as these vary no more than
    the sensor's noise, which is measured in the quieter rows and columns of the last 32 steps; the
    result comes two frames late.
    """

    kinds: tuple[str, ...]

    def __post_init__(self) -> None:
        is_valid = set(self.kinds) <= {*REPAIRS}
        advice = f"{' or '.join(REPAIRS)}, joined by +"
        check_value("model.repair", "+".join(self.kinds), is_valid, advice)

    def kept_numbers(self, taxels: int) -> int:
        """Per taxel: extreme values, flags (varied, sound), mean of neighbours; its offset.

        To denoise: frames, their mean and variance; steps of rows and columns, of which there are
        at most one more than taxels.
        """
        is_filled = bool({"stuck", "dead"} & set(self.kinds))
        numbers = (5 * is_filled + ("offset" in self.kinds)) * taxels
        if "noise" in self.kinds:
            numbers += (DENOISED_FRAMES + 2) * taxels + NOISE_STEPS * (taxels + 1)
        return numbers

    def __call__(self, corpus: Corpus) -> Corpus:
        """Repaired captures, float32."""
        settled = max(2, int(np.ceil(SETTLED_S * corpus.rate_hz)))
        repaired = np.empty((int(corpus.lengths.sum()), *corpus.grid), dtype=np.float32)
        for end, capture in zip(np.cumsum(corpus.lengths), corpus, strict=True):
            frames = repaired[end - len(capture) : end]
            frames[:] = capture
            self._repair_frames(frames, corpus.full_scale, settled)
        steps, lengths = (*unblind(corpus).steps, self), corpus.lengths.astype(np.int64)
        return corpus.with_fields(frames=repaired, lengths=lengths, steps=steps)

    def _repair_frames(self, frames: np.ndarray, full_scale: float, settled: int) -> None:
        """Repair the frames of a capture in place; ``settled`` is `SETTLED_S` in frames."""
        is_constant = _running_extreme(np.logical_and, frames == frames[:1])
        is_settled = is_constant & (np.arange(len(frames)) >= settled - 1)[:, None, None]
        is_broken = np.zeros_like(is_constant)
        if "stuck" in self.kinds:
            highest = np.where(is_constant, -1, frames).max(axis=(1, 2))[:, None, None]
            is_broken |= _running_extreme(np.logical_and, frames >= full_scale)
            is_broken |= is_settled & (frames > highest) & (highest >= 0)
        if "dead" in self.kinds and is_settled.any():
            neighbours = sum_neighbours(np.ones_like(frames[:1]))
            varied = sum_neighbours((~is_constant).astype(np.float32))
            is_broken |= is_settled & (2 * varied > neighbours)
        if is_broken.any():
            rows = np.flatnonzero(is_broken.any(axis=(1, 2)))
            frames[rows] = _fill_broken(frames[rows], is_broken[rows])
        if "offset" in self.kinds:
            frames -= _running_extreme(np.minimum, frames)
        if "noise" in self.kinds:
            frames[:] = _denoise(frames)


def _running_extreme(extreme: np.ufunc, frames: np.ndarray) -> np.ndarray:
    """Minimum of each taxel up to each frame, or conjunction, with the span doubled each round.

    numpy's accumulate handles each taxel by itself, which takes 17 times as long on 32 x 32 taxels.
    """
    result, span = frames.copy(), 1
    while span < len(result):
        result[span:] = extreme(result[span:], result[:-span])
        span *= 2
    return result


def sum_neighbours(frames: np.ndarray) -> np.ndarray:
    """Sum over the up to 8 neighbours of each taxel [frames, rows, cols]."""
    wide = np.pad(frames, ((0, 0), (1, 1), (1, 1)))
    rows = wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]
    return rows[:, :, :-2] + rows[:, :, 1:-1] + rows[:, :, 2:] - frames


def _fill_broken(frames: np.ndarray, is_broken: np.ndarray) -> np.ndarray:
    """Fill broken taxels with the mean of their sound neighbours; 0 where none is near."""
    is_sound = (~is_broken).astype(np.float32)
    values = frames * is_sound
    for _ in range(FILL_PASSES):
        count = sum_neighbours(is_sound)
        is_fillable = (is_sound == 0) & (count > 0)
        if not is_fillable.any():
            break
        mean = sum_neighbours(values) / np.maximum(count, 1)
        values[is_fillable] = mean[is_fillable]
        is_sound[is_fillable] = 1
    return values


def _denoise(frames: np.ndarray) -> np.ndarray:
    """Denoise frames by a Wiener filter, each from itself and frames before, two frames late."""
    noise, denoised = _measure_noise(frames), np.empty(frames.shape, dtype=np.float32)
    size = max(1, DENOISED_VALUES // frames[0].size)
    for first in range(0, len(frames), size):
        before = min(first, DENOISED_FRAMES - 1)
        part = frames[first - before : first + size].astype(np.float64)
        age = np.arange(first - before, first - before + len(part))
        denoised[first : first + size] = _filter_frames(part, age, noise[age])[before:]
    return denoised


def _filter_frames(frames: np.ndarray, age: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Move each reading to the mean about it, by the share that noise has in the variance there.

    Args:
        frames: consecutive frames of a capture, float64 [frames, rows, cols].
        age: frames of the capture before each.
        noise: variance of the noise by each frame [frames].
    """
    count = np.minimum(age + 1, DENOISED_FRAMES)[:, None, None]
    earlier = [frames[: len(frames) - k] for k in range(min(DENOISED_FRAMES, len(frames)))]
    mean, square = np.zeros(frames.shape), np.zeros(frames.shape)
    for k, ones in enumerate(earlier):
        mean[k:] += ones
    mean /= count
    for k, ones in enumerate(earlier):
        square[k:] += (ones - mean[k:]) ** 2
    square = square / count + mean * mean
    places = sum_neighbours(np.ones(frames[:1].shape)) + 1
    mean_around = (sum_neighbours(mean) + mean) / places
    variance = (sum_neighbours(square) + square) / places - mean_around**2
    excess = np.maximum(variance - noise[:, None, None], 0)
    kept = excess / np.where(excess > 0, variance, 1)
    middle = frames[np.maximum(np.arange(len(frames)) - np.minimum(age, DENOISED_FRAMES // 2), 0)]
    return mean_around + kept * (middle - mean_around)


def _measure_noise(frames: np.ndarray) -> np.ndarray:
    """Variance of the sensor's noise by the last `NOISE_STEPS` steps to each frame [frames]."""
    squares = np.diff(frames, axis=0, prepend=frames[:1]) ** 2
    lines = np.concatenate([squares.mean(axis=2), squares.mean(axis=1)], axis=1) / 2.0
    sums = np.zeros(lines.shape)
    for k in range(min(NOISE_STEPS, len(frames))):
        sums[k:] += lines[: len(frames) - k]
    steps = np.clip(np.arange(len(frames)), 1, NOISE_STEPS)  # 0 to the first frame
    return np.sort(sums, axis=1)[:, (lines.shape[1] - 1) // QUIET_PART] / steps


@dataclass(frozen=True)
class Scale(Step):
    """Captures on another scale, as many sensors hardly ever reach full scale.

    ``peak``: divided by the largest reading of a capture's past, so that a sensor's gain does not
    matter. ``log``: the logarithm of 1 + 1000 times the share of full scale; full scale stays.
    """

    kind: str

    def __post_init__(self) -> None:
        check_value("model.scale", self.kind, self.kind in SCALES[1:], " or ".join(SCALES))

    def __call__(self, corpus: Corpus) -> Corpus:
        """Captures scaled to 0..full_scale, float32; a reading of 0 stays 0."""
        scale = self._scale_logarithm if self.kind == "log" else self._scale_peak
        scaled = [scale(frames.astype(np.float32), corpus.full_scale) for frames in corpus]
        return _with_frames(corpus, scaled, self)

    def _scale_logarithm(self, frames: np.ndarray, full_scale: float) -> np.ndarray:
        shares = (frames / np.float32(full_scale)).clip(0, 1)
        factor = np.float32(full_scale / np.log1p(LOG_FACTOR))
        scaled = np.log1p(shares * np.float32(LOG_FACTOR)) * factor
        return np.minimum(scaled, np.float32(full_scale))  # rounding may exceed it

    def _scale_peak(self, frames: np.ndarray, full_scale: float) -> np.ndarray:
        peak = np.maximum.accumulate(frames.max(axis=(1, 2)))
        gain = (full_scale / np.where(peak > 0, peak, 1)).astype(np.float32)
        return np.minimum(frames * gain[:, None, None], np.float32(full_scale))


def _with_frames(
    corpus: Corpus, arrays: list[np.ndarray], step: object, **fields: object
) -> Corpus:
    """Captures with other frames, one array [frames, rows, cols] each."""
    return corpus.with_fields(
        frames=np.concatenate(arrays) if arrays else shared_frames(corpus)[0][:0],
        lengths=np.array([len(frames) for frames in arrays], dtype=np.int64),
        steps=(*unblind(corpus).steps, step),
        **fields,
    )
