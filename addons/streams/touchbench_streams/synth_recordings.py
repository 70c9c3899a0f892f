"""Generated recordings: touches of the generated corpus, with idle time between them.

The sensor of `bench.corpora.synth` is simulated over the whole recording, so its creep goes on
after a touch. Offsets drift slowly, each taxel on its own and all together.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.cost import FULL_SCALE, VARIANTS
from bench.corpora.synth import (
    BYTES_PER_VALUE,
    GESTURES,
    Habits,
    check_parameters,
    generate_pressure,
    simulate_sensor,
    synthetic_info,
)
from bench.ground.machine import check_memory
from touchbench_streams.recordings import Recordings, event_table

GAP_S = (3.0, 10.0)  # between touches
RAMP_S = (0.05, 0.3)  # light contact while the hand approaches, and while it leaves
CONTACT = 0.02  # share of a touch's largest pressure above which it is an event
KNOT_S = 20.0  # between the points of the drift, which is linear between them
DRIFT = 2.0  # SD of a step of the drift, in sensor values


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
) -> Recordings:
    """Generate one recording per subject, with every gesture in random order.

    `bench.corpora.synth.generate` has the same subjects for the same seed, but other touches. The
    same arguments give the same bytes, and more subjects do not change the earlier ones. With three
    variants a recording lasts about six minutes.

    The parameters are those of `bench.corpora.synth.generate`; ``repetitions`` counts touches of
    each variant and gesture.

    Returns:
        uint16 frames 0..1023. An event lasts as long as the pressure is above 2 % of its largest
        value in the touch.

    Raises:
        InputError: a parameter is out of range, or there is not enough memory.
    """
    sizes = {"subjects": subjects, "repetitions": repetitions, "rows": rows, "cols": cols}
    check_parameters(variants, **sizes, seed=seed, rate_hz=rate_hz, gain=gain, noise=noise)
    once_s = sum(gesture.duration + sum(GAP_S) / 2 for gesture in GESTURES.values())
    seconds = once_s * len(variants) * float(repetitions)
    values = max(1.0, seconds * rate_hz) * rows * cols
    keys = " ".join(f"data.{name}={value}" for name, value in sizes.items())
    # besides what a recording takes, the frames of all are concatenated
    check_memory(f"{keys} data.rate_hz={rate_hz:g}", values * (BYTES_PER_VALUE + 4.0 * subjects))
    kinds = [(variant, gesture) for variant in variants for gesture in GESTURES] * repetitions
    arrays, events = [], []
    for subject in range(1, subjects + 1):
        habits_seed = np.random.SeedSequence(seed, spawn_key=(subject,))
        habits = Habits(np.random.default_rng(habits_seed), rows, cols)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(subject, 1)))
        parts, length = [_draw_idle(rng, rows, cols, rate_hz)], 0
        for i in rng.permutation(len(kinds)):
            variant, gesture = kinds[i]
            pressure = generate_pressure(rng, habits, gesture, variant, (rows, cols), rate_hz)
            pressure = _ramp_in_and_out(rng, pressure, rate_hz)
            length += len(parts[-1])
            peaks = pressure.max(axis=(1, 2))
            contact = np.flatnonzero(peaks >= CONTACT * peaks.max())
            events.append((subject - 1, length + contact[0], length + contact[-1] + 1, gesture))
            length += len(pressure)
            parts += [pressure.astype(np.float32), _draw_idle(rng, rows, cols, rate_hz)]
        pressure = np.concatenate(parts)
        offset = habits.offset + _draw_drift(rng, len(pressure), rows, cols, rate_hz)
        arrays.append(simulate_sensor(rng, gain * pressure, offset, rate_hz, noise))
    captures = pd.DataFrame({"subject": [str(s + 1) for s in range(subjects)], "gesture": ""})
    scale, info = float(FULL_SCALE), synthetic_info(seed)
    corpus = Corpus.from_captures(
        arrays, captures, float(rate_hz), full_scale=scale, name="synth", info=info
    )
    return Recordings(corpus, event_table(events))


def _draw_idle(rng: np.random.Generator, rows: int, cols: int, rate_hz: float) -> np.ndarray:
    """Draw time without touch [frames, rows, cols]."""
    return np.zeros((max(1, round(rng.uniform(*GAP_S) * rate_hz)), rows, cols), dtype=np.float32)


def _ramp_in_and_out(rng: np.random.Generator, pressure: np.ndarray, rate_hz: float) -> np.ndarray:
    """Add approach and release to a touch: its first and last frame, ramped in and out."""
    before, after = (
        np.linspace(0, 1, round(rng.uniform(*RAMP_S) * rate_hz), endpoint=False) for _ in range(2)
    )
    approach = before[:, None, None] * pressure[:1]
    release = after[::-1, None, None] * pressure[-1:]
    return np.concatenate([approach, pressure, release])


def _draw_drift(
    rng: np.random.Generator, frames: int, rows: int, cols: int, rate_hz: float
) -> np.ndarray:
    """Draw the change of each taxel's offset over time, half of which is common to all taxels."""
    position = np.arange(frames) / (KNOT_S * rate_hz)
    before = position.astype(np.int64)
    steps = rng.normal(0, DRIFT, (before[-1] + 2, rows, cols))
    steps += rng.normal(0, DRIFT, (before[-1] + 2, 1, 1))
    knots = (steps.cumsum(axis=0) / np.sqrt(2)).astype(np.float32)
    share = (position - before).astype(np.float32)[:, None, None]
    return (1 - share) * knots[before] + share * knots[before + 1]
