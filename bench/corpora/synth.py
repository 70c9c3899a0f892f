"""Generated touch, plausible enough to develop and test on, and never a result about people.

Every gesture is a point in a common space of movements: how long, large and hard the contact is,
whether the hand lifts between beats, travels, circles or jitters. Each subject has habits, and
pairs of gestures that people confuse (grab and squeeze, pat and tap, ...) shade into each other.
Durations, contact areas and the order of pressures follow Jung et al. 2017, Tables 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import product

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.machine import check_memory

VARIANTS, FULL_SCALE = ("gentle", "normal", "rough"), 1023  # of the Corpus of Social Touch, too
PAD_MM = 160.0  # side of the sensitive area
SHORTEST_S, LONGEST_S = 10 / 135, 1747 / 135
BYTES_PER_VALUE = 40  # while one capture is computed: a few arrays of 64 bits
BYTES_PER_CAPTURE = 500  # its row of the table, besides its frames
RAW_PER_GCM2 = 0.36  # sensor value per g/cm2 of the tables, whose scale was calibrated


@dataclass(frozen=True)
class Movement:
    """A gesture as the average person does it: mm, s, g/cm2, and shares of 1."""

    duration: float
    duration_sd: float
    area: float  # share of the pad that the patches cover, fitted to the published contact area
    area_sd: float
    pressure: float  # at the peak
    patches: float  # fingertips or parts of the palm in contact
    spacing: float  # between patches
    flat: float  # 0 a fingertip's bell, 1 a palm's plateau
    lift: float  # how far the hand leaves the skin between beats
    pulse: float  # how far the force swings with the beat
    tempo: float  # beats per second
    sweep: float  # travel of the hand
    one_way: float  # 1 travels once across, 0 back and forth
    circle: float  # 1 turns in circles
    jitter: float  # erratic movement of each patch


GESTURES = {
    "grab": Movement(1.373, 0.715, 0.47, 0.17, 1774, 1, 0, 1.0, 0, 0.15, 1.0, 3, 0, 0, 2),
    "hit": Movement(0.29, 0.36, 0.23, 0.05, 1643, 2, 25, 0.7, 0.95, 0, 2.6, 4, 1, 0, 3),
    "massage": Movement(3.538, 1.898, 0.62, 0.20, 1621, 2, 50, 0.8, 0, 0.55, 1.3, 25, 0, 0.7, 5),
    "pat": Movement(0.709, 0.753, 0.2, 0.07, 1057, 2, 25, 0.7, 0.9, 0, 3.6, 3, 0, 0, 4),
    "pinch": Movement(1.132, 0.597, 0.12, 0.08, 1701, 2, 35, 0.1, 0, 0.2, 1.0, 3, 0, 0, 2),
    "poke": Movement(0.650, 0.502, 0.052, 0.06, 1258, 1, 0, 0, 0.1, 0.1, 1.5, 2, 0, 0, 2),
    "press": Movement(1.181, 0.608, 0.185, 0.16, 1660, 1, 0, 0.6, 0, 0.1, 1.0, 3, 0, 0, 2),
    "rub": Movement(2.170, 1.142, 0.33, 0.10, 1282, 2, 25, 0.7, 0, 0.2, 1.6, 60, 0.1, 0.2, 4),
    "scratch": Movement(2.205, 1.268, 0.23, 0.08, 1064, 4, 25, 0, 0.2, 0.35, 3.0, 40, 0, 0, 6),
    "slap": Movement(0.321, 0.462, 0.25, 0.06, 1165, 3, 25, 0.6, 0.95, 0, 2.8, 18, 1, 0, 3),
    "squeeze": Movement(1.502, 0.813, 0.37, 0.22, 1980, 1, 0, 0.9, 0, 0.4, 1.3, 3, 0, 0, 3),
    "stroke": Movement(1.722, 0.829, 0.32, 0.08, 1135, 2, 25, 0.6, 0, 0.1, 0.9, 85, 0.9, 0, 4),
    "tap": Movement(0.564, 0.486, 0.12, 0.07, 1055, 1.4, 20, 0.2, 0.9, 0, 3.8, 2, 0, 0, 3),
    "tickle": Movement(2.491, 1.446, 0.25, 0.09, 911, 4, 25, 0, 0.4, 0.5, 4.0, 18, 0, 0.1, 14),
}
LOOKALIKES = """
grab:squeeze squeeze:grab pat:tap tap:pat rub:stroke stroke:rub scratch:tickle tickle:scratch
hit:slap slap:hit poke:tap press:pinch pinch:poke massage:rub
"""
LOOKALIKE = dict(pair.split(":") for pair in LOOKALIKES.split())
# Durations and contact areas are known for each gesture, so a lookalike lends everything but these.
PUBLISHED = ("duration", "duration_sd", "area", "area_sd", "pressure")
LEAST = {"subjects": 1, "repetitions": 1, "rows": 1, "cols": 1, "seed": 0, "noise": 0}  # else > 0
VARIANT_FORCE = {"gentle": 0.72, "normal": 1.0, "rough": 1.55}
VARIANT_AREA = {"gentle": 0.97, "normal": 1.0, "rough": 1.15}
VARIANT_DURATION = {"gentle": 0.98, "normal": 0.97, "rough": 1.05}


def generate(
    subjects: int = 10,
    repetitions: int = 1,
    variants: tuple[str, ...] = VARIANTS,
    rows: int = 8,
    cols: int = 8,
    rate_hz: float = 135.0,
    gain: float = 1.0,
    noise: float = 1.5,
    seed: int = 0,
) -> Corpus:
    """Generate captures of the 14 gestures of CoST.

    The same arguments give the same bytes, and more subjects leave the earlier ones as they were.
    31 subjects, three variants and 6 repetitions are 7812 captures, CoST before seven were removed.

    Args:
        subjects: number of subjects.
        repetitions: captures of each subject, variant and gesture.
        variants: any of gentle, normal, rough.
        rows: rows of the grid, on a pad of 160 x 160 mm.
        cols: columns of the grid.
        rate_hz: frames per second.
        gain: gain of the sensor before it saturates; CoST has 1.
        noise: SD of a reading, in sensor values.
        seed: random seed of all draws.

    Returns:
        uint16 frames 0..1023; subject, variant, gesture, repetition.

    Raises:
        InputError: a count below 1, a seed or noise below 0, a rate or gain that is not above 0, an
            unknown variant, or more captures than there is memory for.
    """
    counts = {"subjects": subjects, "repetitions": repetitions, "rows": rows, "cols": cols}
    check_parameters(variants, **counts, seed=seed, rate_hz=rate_hz, gain=gain, noise=noise)
    _check_memory_for(
        float(subjects) * repetitions * len(variants) * len(GESTURES), counts, rate_hz
    )
    arrays, labels = [], []
    for subject in range(1, subjects + 1):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(subject,)))
        habits = Habits(rng, rows, cols)
        for names in product(variants, GESTURES, range(1, repetitions + 1)):
            variant, gesture, _ = names
            pressure = generate_pressure(rng, habits, gesture, variant, (rows, cols), rate_hz)
            arrays.append(simulate_sensor(rng, gain * pressure, habits.offset, rate_hz, noise))
            labels.append((str(subject), *names))
    captures = pd.DataFrame(labels, columns=["subject", "variant", "gesture", "repetition"])
    fields = {"full_scale": float(FULL_SCALE), "name": "synth", "info": synthetic_info(seed)}
    return Corpus.from_captures(arrays, captures, float(rate_hz), **fields)


def _check_memory_for(captures: float, counts: dict[str, int], rate_hz: float) -> None:
    """Refuse more captures than there is memory for."""
    seconds = captures * sum(movement.duration for movement in GESTURES.values()) / len(GESTURES)
    taxels = float(counts["rows"]) * counts["cols"]
    longest = max(1.0, LONGEST_S * rate_hz) * taxels * BYTES_PER_VALUE
    frames = max(captures, seconds * rate_hz) * taxels * np.dtype(np.uint16).itemsize
    keys = " ".join(f"data.{name}={count}" for name, count in counts.items())
    needed = longest + 2 * frames + captures * BYTES_PER_CAPTURE  # frames apart, and put together
    check_memory(f"{keys} data.rate_hz={rate_hz:g}", needed)


def synthetic_info(seed: int) -> dict[str, object]:
    """The ``info`` of a generated corpus."""
    source = f"generated by touchbench, seed {seed}"
    return {"source": source, "licence": "none needed", "synthetic": True, "warnings": []}


def check_parameters(variants: tuple[str, ...], **numbers: float) -> None:
    """Refuse parameters of `generate` that cannot be."""
    for name, value in numbers.items():
        least = LEAST.get(name)
        if not (value > 0 if least is None else value >= least) or value == float("inf"):
            hint = "a finite number above 0" if least is None else f"at least {least}"
            raise InputError(f"data.{name}={value:.12g}: give {hint}")
    if unknown := [v for v in variants if v not in VARIANTS] or (not variants and ["nothing"]):
        raise InputError(f"data.variants={unknown[0]}: give some of {'+'.join(VARIANTS)}")


class Habits:
    """Personal traits of a subject's touch; factors are log-normal around 1.

    ``style`` is how far a gesture leans to its lookalike; the other tables have a factor for each
    gesture.
    """

    def __init__(self, rng: np.random.Generator, rows: int, cols: int) -> None:
        names = list(GESTURES)

        def draw_factors(spread: float, common: float) -> dict[str, float]:
            shared = rng.normal(0, common)
            return dict(zip(names, np.exp(rng.normal(0, spread, len(names)) + shared), strict=True))

        self.force = draw_factors(0.15, 0.25)
        self.area = draw_factors(0.10, 0.10)
        self.tempo = draw_factors(0.15, 0.18)
        self.pace = draw_factors(0.22, 0.22)
        self.reach = draw_factors(0.15, 0.15)
        self.style = dict(zip(names, np.abs(rng.normal(0, 0.20, len(names))), strict=True))
        self.centre = rng.normal(0, 14, 2)  # mm from the middle of the pad
        self.heading = rng.normal(0, 0.5)  # radians; along the arm
        # Sensor value of an untouched taxel.
        self.offset = rng.gamma(3, 8, (rows, cols)).astype(np.float32)


def generate_pressure(
    rng: np.random.Generator,
    habits: Habits,
    gesture: str,
    variant: str,
    grid: tuple[int, int],
    rate_hz: float,
) -> np.ndarray:
    """Pressure of a gesture in sensor values without saturation, float64 [frames, rows, cols]."""
    movement = GESTURES[gesture]
    lean = float(np.clip(habits.style[gesture] + rng.normal(0, 0.12), 0, 1))
    way = _blend(movement, GESTURES[LOOKALIKE[gesture]], lean)
    seconds = _draw_duration(rng, movement, habits.pace[gesture]) * VARIANT_DURATION[variant]
    seconds = float(np.clip(seconds, SHORTEST_S, LONGEST_S))
    time = np.arange(max(1, round(seconds * rate_hz))) / rate_hz
    beat = way.tempo * habits.tempo[gesture] * np.exp(rng.normal(0, 0.15)) * time
    area = movement.area * habits.area[gesture] * VARIANT_AREA[variant]
    area = float(np.clip(area + rng.normal(0, 0.7 * movement.area_sd), 0.025, 0.95))
    peak = RAW_PER_GCM2 * movement.pressure * habits.force[gesture] * VARIANT_FORCE[variant]
    peak *= np.exp(rng.normal(0, 0.25))
    count = max(1, int(way.patches + rng.random()))
    force = peak * _contact_envelope(seconds, time)[:, None]
    force = force * _beat_shares(rng, way, beat, count)
    path = _patch_centres(rng, way, habits, habits.reach[gesture], beat, time / seconds, count)
    return _taxel_pressure(force, path, area, way, *grid)


def _blend(movement: Movement, other: Movement, lean: float) -> Movement:
    """A movement that leans to another one, from 0 to 1, in all that is not published."""
    names = [field.name for field in fields(Movement) if field.name not in PUBLISHED]
    own = {name: getattr(movement, name) for name in names}
    blend = {name: a + lean * (getattr(other, name) - a) for name, a in own.items()}
    return replace(movement, **blend)


def _draw_duration(rng: np.random.Generator, way: Movement, pace: float) -> float:
    """Seconds, log-normal with the published mean and SD, which include the subject's pace."""
    variance = np.log1p((way.duration_sd / way.duration) ** 2)
    rest = max(variance - 2 * 0.22**2, 0.02)
    return float(np.exp(np.log(way.duration) - variance / 2 + rng.normal(0, np.sqrt(rest))) * pace)


def _contact_envelope(seconds: float, time: np.ndarray) -> np.ndarray:
    """The hand arrives and leaves, each within 0.15 s or a fifth of the capture."""
    ramp = min(0.15, seconds / 5)
    return np.clip(np.minimum(time + ramp / 4, seconds - time) / ramp, 0, 1)


def _beat_shares(
    rng: np.random.Generator, way: Movement, beat: np.ndarray, count: int
) -> np.ndarray:
    """Share of the peak force of each patch over time [frames, patches]."""
    phase = beat[:, None] + (rng.normal(0, 0.25, count) * way.jitter / 8)[None]
    swing = 1 - way.pulse * (0.5 + 0.5 * np.cos(2 * np.pi * phase))
    since = phase - np.floor(phase)
    struck = np.minimum(since / 0.06, np.exp(-np.maximum(since - 0.06, 0) / 0.12))
    weight = np.exp(rng.normal(0, 0.12, count))
    return ((1 - way.lift) * swing + way.lift * struck) * weight / weight.max()


def _patch_centres(
    rng: np.random.Generator,
    way: Movement,
    habits: Habits,
    reach: float,
    beat: np.ndarray,
    progress: np.ndarray,
    count: int,
) -> np.ndarray:
    """Centre of each patch over time in mm from the middle of the pad [frames, patches, 2]."""
    heading = habits.heading + rng.normal(0, 0.35)
    along = np.array([np.cos(heading), np.sin(heading)])
    across = np.array([-along[1], along[0]])
    turn = np.pi * beat
    to_and_fro = 0.5 * np.sin(turn)
    travel = way.one_way * (progress - 0.5) * rng.choice([-1, 1]) + (1 - way.one_way) * to_and_fro
    sweep = way.sweep * reach
    circle = 0.5 * way.circle * sweep * np.cos(turn)
    hand = (travel * sweep)[:, None] * along + circle[:, None] * across
    fingers = (np.arange(count) - (count - 1) / 2)[:, None] * way.spacing * across
    tempo, phase = rng.uniform(0.5, 1.2, (count, 2)), rng.random((count, 2))
    wander = np.sin(2 * np.pi * (beat[:, None, None] * tempo + phase))
    centre = habits.centre + rng.normal(0, 12, 2)
    return centre + hand[:, None] + fingers + way.jitter * wander


def _taxel_pressure(
    force: np.ndarray, path: np.ndarray, area: float, way: Movement, rows: int, cols: int
) -> np.ndarray:
    """Pressure on each taxel [frames, rows, cols].

    The patches cover ``area`` of the pad above half of their peak. A patch is
    exp(-(|x/s|^p + |y/s|^p) / 2), a bell for p = 2 and a plateau for p = 4; both cover about
    4.35 s^2 above half of the peak. Centres stay so far inside that patches lie on the pad.
    """
    patches = force.shape[1]
    size = max(np.sqrt(area * PAD_MM**2 / patches / 4.35), 0.6 * PAD_MM / max(rows, cols))
    power = 2 + 2 * way.flat
    overlap = min(patches - 1, 2) * np.exp(-0.5 * (way.spacing / size) ** power)  # of neighbours
    force = force / (1 + overlap)
    keep = np.clip(1 - 2 * size / PAD_MM, 0, 1)  # a large hand cannot sit at the edge
    sides = []
    for axis, taxels in ((0, rows), (1, cols)):
        middle = ((np.arange(taxels) + 0.5) / taxels - 0.5) * PAD_MM
        distance = np.abs(middle - keep * path[:, :, axis, None]) / size
        sides.append(np.exp(-0.5 * distance**power))
    return np.matmul((sides[0] * force[:, :, None]).transpose(0, 2, 1), sides[1])


def simulate_sensor(
    rng: np.random.Generator, pressure: np.ndarray, offset: np.ndarray, rate_hz: float, noise: float
) -> np.ndarray:
    """Readings of a fabric sensor, which creeps under load, saturates and rounds, uint16.

    Args:
        rng: random generator of the noise.
        pressure: pressure on the taxels [frames, rows, cols].
        offset: reading of an untouched taxel [rows, cols] or [frames, rows, cols].
        rate_hz: frames per second.
        noise: SD of a reading.
    """
    pressure = pressure.astype(np.float32)
    decay = np.exp(-1 / (0.25 * rate_hz))
    numerator, denominator = np.float32([1 - decay]), np.float32([1, -decay])
    slow = lfilter(numerator, denominator, pressure, axis=0)
    load = 0.8 * pressure + 0.2 * slow
    value = 1000 * np.tanh(load / 1000) + offset
    value += rng.standard_normal(value.shape, dtype=np.float32) * noise
    return np.clip(np.rint(value), 0, FULL_SCALE).astype(np.uint16)
