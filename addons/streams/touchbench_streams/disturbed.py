"""Recordings as a sensor with noise, vibration or drift shows them, to learn from.

A kind of disturbance is a function of a recording, float32 shares of full scale [frames, rows, cols], its rate in Hz
and a random generator. Amounts differ from recording to recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.faults import as_readings, as_shares, noise, seeded_generator

AMOUNT = (0.005, 0.015)  # of full scale, from slight to more than the 1 % that a detector must bear
SHAKING_HZ = (1.0, 10.0)  # from a step to a motor
FAR, FAR_S = (
    0.05,
    5.0,
)  # of full scale that all taxels drift at most, and seconds from one level to the next


def add_noise(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """White noise on every reading."""
    return noise(shares, 100 * float(_draw_log_uniform(AMOUNT, rng)), rng)


def add_vibration(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """All taxels swing together, at a frequency of this recording."""
    turns = _draw_log_uniform(SHAKING_HZ, rng) * np.arange(len(shares)) / rate_hz + rng.random()
    return (
        shares
        + _draw_log_uniform(AMOUNT, rng)
        * np.sin(2 * np.pi * turns).astype(np.float32)[:, None, None]
    )


def add_drift(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """All taxels drift together, from one level to the next."""
    times = np.arange(len(shares)) / (FAR_S * rate_hz)
    levels = rng.uniform(0, FAR, int(times[-1]) + 2)
    return (
        shares + np.interp(times, np.arange(len(levels)), levels).astype(np.float32)[:, None, None]
    )


Kind = Callable[[np.ndarray, float, np.random.Generator], np.ndarray]
KINDS: tuple[Kind, ...] = (add_vibration, add_noise)  # that touches are found in
NAMING_KINDS: tuple[Kind, ...] = (add_vibration, add_noise, add_drift)  # that they are named in

SEED_WORDS = {add_vibration: "shaken", add_noise: "noisy", add_drift: "drifting"}  # of seeds


def disturb_recordings(corpus: Corpus, kind: Kind, some: Sequence[int] | None = None) -> Corpus:
    """Return recordings, all or those at some positions, as a disturbed sensor shows them.

    The disturbance of a recording is the same at each call.
    """
    positions = range(len(corpus)) if some is None else some
    streams = []
    for i in positions:
        rng = seeded_generator(f"{SEED_WORDS[kind]} in recording {i}")
        shares = kind(as_shares(corpus, np.array([i]))[0], corpus.rate_hz, rng)
        streams.append(as_readings(corpus, shares))
    captures = corpus.captures.iloc[positions]
    return Corpus.from_captures(streams, captures, corpus.rate_hz, full_scale=corpus.full_scale)


def _draw_log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> np.float32:
    """A number whose logarithm is drawn evenly."""
    return np.float32(np.exp(rng.uniform(*np.log(bounds))))
