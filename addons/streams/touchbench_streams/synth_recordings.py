"""Generated recordings: the touches of the generated corpus one after another, with idle time between them.

A recording has the sensor of `bench.corpora.synth` all along, so its creep goes on after a touch. Offsets drift slowly,
each taxel on its own and all together.
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

    `bench.corpora.synth.generate` has the same subjects for the same seed, but other touches. The same
    arguments give the same bytes, and more subjects leave the earlier ones as they were. With three variants a
    recording lasts about six minutes.

    Args as of `bench.corpora.synth.generate`; ``repetitions`` counts touches of each variant and gesture.

    Returns:
        uint16 frames 0..1023. An event lasts as long as the pressure is above 2 % of its largest value in the touch.

    Raises:
        InputError: a parameter is out of range, or there is not enough memory.
    """
    counts = {
        "subjects": subjects,
        "repetitions": repetitions,
        "rows": rows,
        "cols": cols,
        "seed": seed,
    }
    check_parameters(variants, **counts, rate_hz=rate_hz, gain=gain, noise=noise)
    seconds = (
        sum(way.duration + sum(GAP_S) / 2 for way in GESTURES.values())
        * len(variants)
        * float(repetitions)
    )
    values = max(1.0, seconds * rate_hz) * rows * cols
    asked = (
        f"data.subjects={subjects} data.repetitions={repetitions} data.rows={rows} data.cols={cols}"
    )
    check_memory(
        f"{asked} data.rate_hz={rate_hz:g}", values * (BYTES_PER_VALUE + 4.0 * subjects)
    )  # frames are put together
    kinds = [(variant, gesture) for variant in variants for gesture in GESTURES] * repetitions
    arrays, events = [], []
    for subject in range(1, subjects + 1):
        habits = Habits(
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(subject,))), rows, cols
        )
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(subject, 1)))
        parts, length = [_draw_idle(rng, rows, cols, rate_hz)], 0
        for i in rng.permutation(len(kinds)):
            variant, gesture = kinds[i]
            pressure = _ramp_in_and_out(
                rng,
                generate_pressure(rng, habits, gesture, variant, (rows, cols), rate_hz),
                rate_hz,
            )
            length += len(parts[-1])
            peaks = pressure.max(axis=(1, 2))
            felt = np.flatnonzero(peaks >= CONTACT * peaks.max())
            events.append((subject - 1, length + felt[0], length + felt[-1] + 1, gesture))
            length += len(pressure)
            parts += [pressure.astype(np.float32), _draw_idle(rng, rows, cols, rate_hz)]
        whole = np.concatenate(parts)
        offset = habits.offset + _draw_drift(rng, len(whole), rows, cols, rate_hz)
        arrays.append(simulate_sensor(rng, gain * whole, offset, rate_hz, noise))
    captures = pd.DataFrame({"subject": [str(s + 1) for s in range(subjects)], "gesture": ""})
    scale, info = float(FULL_SCALE), synthetic_info(seed)
    corpus = Corpus.from_captures(
        arrays, captures, float(rate_hz), full_scale=scale, name="synth", info=info
    )
    return Recordings(corpus, event_table(events))


def _draw_idle(rng: np.random.Generator, rows: int, cols: int, rate_hz: float) -> np.ndarray:
    """Time without touch [frames, rows, cols]."""
    return np.zeros((max(1, round(rng.uniform(*GAP_S) * rate_hz)), rows, cols), dtype=np.float32)


def _ramp_in_and_out(rng: np.random.Generator, pressure: np.ndarray, rate_hz: float) -> np.ndarray:
    """A touch with its approach and release: its first and last frame, ramped in and out."""
    before, after = (
        np.linspace(0, 1, round(rng.uniform(*RAMP_S) * rate_hz), endpoint=False) for _ in range(2)
    )
    return np.concatenate(
        [before[:, None, None] * pressure[:1], pressure, after[::-1, None, None] * pressure[-1:]]
    )


def _draw_drift(
    rng: np.random.Generator, frames: int, rows: int, cols: int, rate_hz: float
) -> np.ndarray:
    """Change of each taxel's offset over time, float32 [frames, rows, cols]: half of it is common to all taxels."""
    position = np.arange(frames) / (KNOT_S * rate_hz)
    before = position.astype(np.int64)
    steps = rng.normal(0, DRIFT, (before[-1] + 2, rows, cols)) + rng.normal(
        0, DRIFT, (before[-1] + 2, 1, 1)
    )
    knots = (steps.cumsum(axis=0) / np.sqrt(2)).astype(np.float32)
    share = (position - before).astype(np.float32)[:, None, None]
    return (1 - share) * knots[before] + share * knots[before + 1]
