"""Recordings with noise, vibration or drift of the sensor, to learn from.

A kind of disturbance is a function of a recording, float32 shares of full scale [frames, rows,
cols], its rate in Hz and a random generator. Amounts differ from recording to recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.faults import as_readings, as_shares, noise, seeded_generator

AMOUNT = (0.005, 0.015)  # of full scale; a detector must bear 1 %
FAINT = (0.0015, 0.006)  # of full scale; from somewhat more than the noise of a good sensor
SHAKING_HZ = (1.0, 10.0)  # from a step to a motor
FARTHEST_DRIFT = 0.05  # of full scale
DRIFT_STEP_S = 5.0  # from one level of the drift to the next


def add_noise(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """White noise on every reading."""
    return noise(shares, 100 * float(_draw_log_uniform(AMOUNT, rng)), rng)


def add_faint_noise(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """Fainter white noise."""
    return noise(shares, 100 * float(_draw_log_uniform(FAINT, rng)), rng)


def add_vibration(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """A swing of all taxels together, at a random frequency."""
    turns = _draw_log_uniform(SHAKING_HZ, rng) * np.arange(len(shares)) / rate_hz + rng.random()
    swing = np.sin(2 * np.pi * turns).astype(np.float32)[:, None, None]
    return shares + _draw_log_uniform(AMOUNT, rng) * swing


def add_drift(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """A drift of all taxels together, from one random level to the next."""
    times = np.arange(len(shares)) / (DRIFT_STEP_S * rate_hz)
    levels = rng.uniform(0, FARTHEST_DRIFT, int(times[-1]) + 2)
    drift = np.interp(times, np.arange(len(levels)), levels).astype(np.float32)
    return shares + drift[:, None, None]


Kind = Callable[[np.ndarray, float, np.random.Generator], np.ndarray]
# For finding touches, each with its column of `measure_disturbance` in
# `touchbench_streams.detectors.signals`; of one column the weaker first.
KINDS: dict[Kind, int] = {add_vibration: 0, add_faint_noise: 1, add_noise: 1}
NAMING_KINDS: tuple[Kind, ...] = (add_vibration, add_noise, add_drift)  # for naming them

SEED_WORDS = {  # of seeds
    add_vibration: "shaken",
    add_faint_noise: "rustling",
    add_noise: "noisy",
    add_drift: "drifting",
}


def disturb_recordings(
    corpus: Corpus, kind: Kind, positions: Sequence[int] | None = None
) -> Corpus:
    """Disturb all recordings, or those at some positions, in the same way at each call."""
    if positions is None:
        positions = range(len(corpus))
    streams = []
    for i in positions:
        rng = seeded_generator(f"{SEED_WORDS[kind]} in recording {i}")
        shares = kind(as_shares(corpus, np.array([i]))[0], corpus.rate_hz, rng)
        streams.append(as_readings(corpus, shares))
    captures = corpus.captures.iloc[positions]
    return Corpus.from_captures(streams, captures, corpus.rate_hz, full_scale=corpus.full_scale)


def _draw_log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> np.float32:
    """Draw a number whose logarithm is uniformly distributed."""
    return np.float32(np.exp(rng.uniform(*np.log(bounds))))
