"""Faults of a sensor, its readings and its place, at five severities each.

A fault is a function ``(frames, amount, rng) -> frames``. ``frames`` are those of one capture or
recording as shares of full scale, float32 [frames, rows, cols]; ``amount`` is in the fault's unit;
``rng`` is a random generator. A fault that depends on time has a fourth argument ``rate_hz``. It
returns shares of full scale on the same grid, at least one frame, and its input for an amount of 0.
`fault` above a function registers it, with its unit and the amounts of severities 1 to 5.

The generator is the same at every severity: what is broken at one is broken at all higher ones. It
depends on the fault and the capture alone, or on the fault and the subject for a fault of the
sensor. So each subject has another damaged sensor, and intervals over subjects include the luck of
the sensor. All systems and protocols get the same damage, which makes comparisons paired.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.fault_names import ALL_FAULTS
from bench.corpora.fault_names import SEVERITIES as SEVERITIES
from bench.corpora.sensor import rest_noise
from bench.errors import InputError, suggest_names

Damage = Callable[..., Any]  # of the arguments above; gives frames
VIBRATION_HZ = 3.0  # of a motor or a step
NOISY = np.float32(0.02)  # SD of the readings of a noisy region, as a share of full scale


@dataclass(frozen=True)
class Fault:
    """A fault by name.

    Attributes:
        name: name of the function.
        damage: the function.
        unit: text after an amount in a table, such as ``% of the taxels``.
        amounts: amounts at severities 1 to 5.
        sensor: True for one draw per subject (a fault of the sensor), False for one per capture.
        shortens: True if an end is missing, so that labels of frames have no place.
        moves: True if frames are lost or come twice, so that later ones come at other times.
        later: True if ``all`` leaves it out on captures, so that means over all stay as they are.
    """

    name: str
    damage: Damage
    unit: str
    amounts: tuple[float, ...]
    sensor: bool
    shortens: bool = False
    moves: bool = False
    later: bool = False

    def describe(self, severity: int) -> str:
        """The amount of a severity with its unit; empty for severity 0."""
        return f"{self.amounts[severity - 1]:g} {self.unit}" if severity else ""

    def make_generator(self, subject: str, capture: int) -> np.random.Generator:
        """Random generator of a subject's sensor, or of a capture by its position in the corpus."""
        source = f"sensor of {subject}" if self.sensor else f"capture {capture}"
        return seeded_generator(f"{self.name}, {source}")

    def apply(
        self, frames: np.ndarray, severity: int, subject: str, capture: int, rate_hz: float
    ) -> np.ndarray:
        """Damage a capture.

        Args:
            frames: shares of full scale, float32 [frames, rows, cols].
            severity: 0 to 5; 0 changes nothing.
            subject: subject of the capture.
            capture: position in the whole corpus.
            rate_hz: frames per second.
        """
        if not severity:
            return frames
        return self.apply_with(frames, severity, self.make_generator(subject, capture), rate_hz)

    def apply_with(
        self, frames: np.ndarray, severity: int, rng: np.random.Generator, rate_hz: float
    ) -> np.ndarray:
        """Damage a capture as `apply` does, at a severity from 1, with a random generator."""
        is_timed = "rate_hz" in inspect.signature(self.damage).parameters
        timing = {"rate_hz": rate_hz} if is_timed else {}
        return self.damage(frames, self.amounts[severity - 1], rng, **timing)


FAULTS: dict[str, Fault] = {}


def seeded_generator(text: str) -> np.random.Generator:
    """A random generator seeded by a text."""
    seed = hashlib.sha256(text.encode()).digest()[:16]
    return np.random.default_rng(int.from_bytes(seed, "little"))


def fault(
    unit: str,
    *amounts: float,
    sensor: bool = False,
    shortens: bool = False,
    moves: bool = False,
    later: bool = False,
) -> Callable[[Damage], Damage]:
    """Register a function as a fault by its name; arguments are attributes of `Fault`.

    Raises:
        ValueError: it does not have five amounts.
    """
    if len(amounts) != SEVERITIES:
        raise ValueError(f"a fault has {SEVERITIES} amounts, here are {len(amounts)}")

    def register(damage: Damage) -> Damage:
        name = damage.__name__
        FAULTS[name] = Fault(name, damage, unit, amounts, sensor, shortens, moves, later)
        return damage

    return register


def usual_faults() -> tuple[str, ...]:
    """Names of the faults that ``all`` stands for on captures."""
    return tuple(name for name, one in FAULTS.items() if not one.later)


def parse_fault_names(key: str, names: Sequence[object], every: Sequence[str]) -> tuple[str, ...]:
    """Names of faults in the order of `FAULTS`.

    Args:
        key: key with which they were typed, for messages.
        names: typed names, or ``all``.
        every: faults that ``all`` stands for.
    """
    typed = [str(name) for name in names]
    for name in typed:
        if name not in (*FAULTS, ALL_FAULTS):
            raise InputError(f"{key}={name}: unknown; {suggest_names(name, FAULTS)}")
    wanted = {*typed, *(every if ALL_FAULTS in typed else ())}
    return tuple(name for name in FAULTS if name in wanted)


def fault_identity(names: Sequence[str]) -> list[tuple]:
    """Names, units, amounts and draws of faults, for keys of stored results."""
    faults = [FAULTS[name] for name in names]
    return [(fault.name, fault.unit, fault.amounts, fault.sensor) for fault in faults]


def as_shares(corpus: Corpus, captures: np.ndarray) -> list[np.ndarray]:
    """Frames of captures, given by position, as shares of full scale, float32."""
    return [corpus[i].astype(np.float32) / np.float32(corpus.full_scale) for i in captures]


def as_readings(corpus: Corpus, shares: np.ndarray) -> np.ndarray:
    """Shares of full scale as readings of the corpus's sensor: rounded if those are whole."""
    frames = shares * np.float32(corpus.full_scale)
    if shared_frames(corpus)[0].dtype.kind in "iu":
        np.rint(frames, out=frames)
    np.clip(frames, 0, corpus.full_scale, out=frames)
    return frames.astype(shared_frames(corpus)[0].dtype)


def damage_captures(
    corpus: Corpus, test: np.ndarray, shares: list[np.ndarray], fault: Fault, severity: int
) -> Corpus:
    """A corpus in memory whose test captures went through a fault.

    It has no digest and no folder, so no cache takes it for the corpus. The other captures keep
    their places and columns, but have no frames.

    Args:
        corpus: the undamaged corpus.
        test: positions of the test captures.
        shares: their frames as of `as_shares`.
        fault: the fault.
        severity: 0 to 5.
    """
    subjects, rate_hz = corpus.subjects, corpus.rate_hz
    arrays = [
        fault.apply(capture, severity, subjects[i], int(corpus.index[i]), rate_hz)
        for i, capture in zip(test, shares, strict=True)
    ]
    frames = as_readings(corpus, np.concatenate(arrays))
    lengths = np.zeros_like(corpus.lengths)
    starts = np.zeros_like(lengths)
    lengths[test] = [len(a) for a in arrays]
    starts[test] = np.cumsum(lengths[test]) - lengths[test]
    return corpus.with_fields(frames=frames, starts=starts, lengths=lengths, digest="", path=None)


def percent_rounded_up(percent: float, count: int) -> int:
    """Percent of a count, rounded up: a sensor of few taxels loses at least one of them."""
    return int(np.ceil(percent * count / 100))


@fault("% of the taxels", 2, 5, 10, 20, 40, sensor=True)
def dead_taxels(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Taxels without contact always read 0."""
    return _set_taxels(frames, amount, rng, 0)


@fault("% of the taxels", 1, 2, 5, 10, 20, sensor=True)
def stuck_taxels(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Short-circuited taxels always read full scale."""
    return _set_taxels(frames, amount, rng, 1)


def _set_taxels(
    frames: np.ndarray, percent: float, rng: np.random.Generator, value: float
) -> np.ndarray:
    taxels = frames[0].size
    broken = rng.permutation(taxels)[: percent_rounded_up(percent, taxels)]
    changed = frames.copy()
    changed.reshape(len(frames), -1)[:, broken] = value
    return changed


@fault("% of the rows and columns", 5, 10, 20, 30, 50, sensor=True)
def dead_lines(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Broken lines of the grid: all taxels of a row or column read 0."""
    _, rows, cols = frames.shape
    broken = rng.permutation(rows + cols)[: percent_rounded_up(amount, rows + cols)]
    changed = frames.copy()
    changed[:, broken[broken < rows]] = 0
    changed[:, :, broken[broken >= rows] - rows] = 0
    return changed


@fault("% SD of the taxels' gains", 5, 10, 20, 40, 80, sensor=True)
def gain_drift(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Sensitivity has drifted since training: each taxel has another, log-normal gain.

    Half of the variance is shared by all taxels (wear, temperature), half is each one's own.
    """
    return np.clip(frames * np.exp(amount / 100 * _draw_spread(frames, rng)), 0, 1)


@fault("% of full scale, SD", 0.2, 0.5, 1, 2, 5, sensor=True)
def offset_drift(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Untouched taxels' readings have drifted since training; half of the variance is shared."""
    return np.clip(frames + np.float32(amount / 100) * _draw_spread(frames, rng), 0, 1)


def _draw_spread(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Normal with SD 1 for each taxel [rows, cols], half of the variance common to all."""
    common = rng.standard_normal()
    return ((common + rng.standard_normal(frames.shape[1:])) / np.sqrt(2)).astype(np.float32)


@fault("% of full scale cut off", 50, 75, 90, 95, 98, sensor=True)
def saturation(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """The amplifier saturates early: readings above the reduced range are clipped to its end."""
    return np.minimum(frames, np.float32(1 - amount / 100))


@fault("% of full scale, SD", 0.2, 0.5, 1, 2, 5)
def noise(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """White noise on every reading."""
    change = rng.standard_normal(frames.shape, dtype=np.float32)
    return np.clip(frames + np.float32(amount / 100) * change, 0, 1)


@fault("bits", 8, 7, 6, 5, 4, sensor=True)
def fewer_bits(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """A coarser converter: readings go to the nearest of 2^bits values; 0 bits change nothing."""
    if amount == 0:
        return frames
    steps = np.float32(2**amount - 1)
    return np.rint(frames * steps) / steps


@fault("% of the frames", 5, 10, 20, 40, 60, moves=True)
def dropped_frames(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Frames are lost at random: the capture becomes shorter. The luckiest frame always arrives."""
    luck = rng.random(len(frames))
    return frames[(luck >= amount / 100) | (luck == luck.max())]


@fault("times slower", 2, 3, 4, 8, 16)
def lower_rate(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """The sensor is read less often and its last reading repeated: most frames are old ones."""
    factor = max(int(amount), 1)
    return frames[np.arange(len(frames)) // factor * factor]


@fault("frames, SD", 0.5, 1, 2, 4, 8)
def time_jitter(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Readings are taken too early or too late, in the right order, interpolated between frames."""
    moment = np.arange(len(frames)) + amount * rng.standard_normal(len(frames))
    moment = np.sort(moment.clip(0, len(frames) - 1))
    before = moment.astype(np.int64)
    after = np.minimum(before + 1, len(frames) - 1)
    weight = (moment - before).astype(np.float32)[:, None, None]
    return frames[before] * (1 - weight) + frames[after] * weight


@fault("% of the capture", 10, 20, 40, 60, 80, shortens=True)
def late_start(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """The touch is noticed late: the first frames are missing."""
    return frames[int(amount * len(frames) / 100) :]


@fault("% of the capture", 10, 20, 40, 60, 80, shortens=True)
def early_end(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """The label is needed early: the last frames are missing."""
    return frames[: len(frames) - int(amount * len(frames) / 100)]


@fault("taxels", 0.5, 1, 1.5, 2, 3, sensor=True)
def shift(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """The sensor sits elsewhere: touch moves in a random direction; beyond the edge it is lost."""
    direction = rng.uniform(0, 2 * np.pi)
    row, col = np.indices(frames.shape[1:])
    return _read_at(frames, row - amount * np.sin(direction), col - amount * np.cos(direction))


@fault("degrees", 5, 10, 20, 45, 90, sensor=True)
def rotation(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """The sensor sits turned about its middle, to a random side; taxels beyond the edge read 0."""
    angle = np.radians(amount) * rng.choice([-1, 1])
    row, col = np.indices(frames.shape[1:])
    down, right = (frames.shape[1] - 1) / 2, (frames.shape[2] - 1) / 2
    sin, cos = np.sin(angle), np.cos(angle)
    return _read_at(
        frames,
        (row - down) * cos - (col - right) * sin + down,
        (row - down) * sin + (col - right) * cos + right,
    )


def _read_at(frames: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Pressure at places between the taxels [rows, cols], bilinear, 0 beyond the edge."""
    _, rows, cols = frames.shape
    # A turn by 90 degrees must meet the taxels, not miss the edge by a rounding error.
    row, col = np.round(row, 9), np.round(col, 9)
    top, left = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    flat = frames.reshape(len(frames), -1)
    readings = np.zeros_like(flat)
    for r, down in ((top, 1 - (row - top)), (top + 1, row - top)):
        for c, right in ((left, 1 - (col - left)), (left + 1, col - left)):
            is_inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
            weight = np.where(is_inside, down * right, 0).astype(np.float32).ravel()
            if weight.any():
                taxel = (r.clip(0, rows - 1) * cols + c.clip(0, cols - 1)).ravel()
                readings += flat[:, taxel] * weight
    return np.minimum(readings, 1, out=readings).reshape(frames.shape)


@fault("% of each side", 10, 25, 40, 50, 75, sensor=True)
def smaller_grid(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Only the taxels in the middle exist, the others read 0; of each side at least one is left."""
    changed = np.zeros_like(frames)
    left = [max(round(side * (1 - amount / 100)), 1) for side in frames.shape[1:]]
    rows, cols = (
        slice((s - n) // 2, (s - n) // 2 + n) for s, n in zip(frames.shape[1:], left, strict=True)
    )
    changed[:, rows, cols] = frames[:, rows, cols]
    return changed


@fault("taxels, SD", 0.5, 0.75, 1, 1.5, 2, sensor=True)
def cover(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """A thick cover spreads the pressure like a Gaussian; pressure beyond the edge is lost."""
    if amount == 0:
        return frames
    rows, cols = (_gaussian_weights(side, amount) for side in frames.shape[1:])
    spread = np.einsum("nrc,qr->nqc", frames, rows)
    return np.minimum(np.einsum("nrc,dc->nrd", spread, cols), 1)


def _gaussian_weights(side: int, sd: float) -> np.ndarray:
    """Shares of the pressure on a row of taxels that each of them reads, float32 [side, side]."""
    reach = np.arange(-int(10 * sd) - 1, int(10 * sd) + 2)
    apart = np.arange(side)[:, None] - np.arange(side)
    total = np.exp(-((reach / sd) ** 2) / 2).sum()
    return (np.exp(-((apart / sd) ** 2) / 2) / total).astype(np.float32)


@fault("% of full scale, at 3 Hz", 0.2, 0.5, 1, 2, 5, later=True)
def vibration(
    frames: np.ndarray, amount: float, rng: np.random.Generator, rate_hz: float
) -> np.ndarray:
    """All taxels swing together, as of a motor or of steps; the amount is the amplitude."""
    phase = 2 * np.pi * (VIBRATION_HZ * np.arange(len(frames)) / rate_hz + rng.random())
    return _raise_frames(frames, amount / 100 * np.sin(phase))


@fault("% of full scale an hour", 2, 10, 30, 120, 600, later=True)
def drift(
    frames: np.ndarray, amount: float, rng: np.random.Generator, rate_hz: float
) -> np.ndarray:
    """All taxels rise together, as of temperature; the first frame is as in training."""
    return _raise_frames(frames, amount / 100 * np.arange(len(frames)) / (3600 * rate_hz))


def _raise_frames(frames: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Add a number to all taxels of each frame; ``change`` is [frames]."""
    return np.clip(frames + change.astype(np.float32)[:, None, None], 0, 1)


@fault("% of the taxels", 2, 5, 10, 20, 40, sensor=True, later=True)
def noisy_region(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """One region has bad contact: noise, SD 2 % of full scale, on a rectangle like the grid."""
    if amount == 0:
        return frames
    _, rows, cols = frames.shape
    change = NOISY * rng.standard_normal(frames.shape, dtype=np.float32)
    sides = [max(1, round(side * np.sqrt(amount / 100))) for side in (rows, cols)]
    free = [side - n + 1 for side, n in zip((rows, cols), sides, strict=True)]
    firsts = [int(luck * places) for luck, places in zip(rng.random(2), free, strict=True)]
    row, col = (slice(first, first + n) for first, n in zip(firsts, sides, strict=True))
    changed = frames.copy()
    changed[:, row, col] = np.clip(frames[:, row, col] + change[:, row, col], 0, 1)
    return changed


@fault("% of the frames twice", 10, 20, 40, 70, 100, moves=True, later=True)
def doubled_frames(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """Frames come twice at random, as from a sensor of a higher rate: the capture gets longer."""
    return np.repeat(frames, 1 + (rng.random(len(frames)) < amount / 100), axis=0)


@fault("times its own noise", 2, 4, 8, 16, 32, later=True)
def own_noise(frames: np.ndarray, amount: float, rng: np.random.Generator) -> np.ndarray:
    """White noise as a multiple of the sensor's own, which the capture shows at rest.

    A sensor whose noise is less than the rounding of its readings has that.
    """
    steps = np.diff(np.unique(frames))
    rounding = steps.min(initial=1.0) / np.sqrt(12) * len(steps[:1])
    deviation = amount * max(rest_noise(frames), rounding)
    change = rng.standard_normal(frames.shape, dtype=np.float32)
    return np.clip(frames + np.float32(deviation) * change, 0, 1)
