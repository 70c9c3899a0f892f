"""Recordings as a sensor with noise, vibration or drift shows them, to learn from.

A kind of disturbance is a function of a recording, float32 shares of full scale [frames, rows, cols], its rate in Hz
and a random generator. Amounts differ from recording to recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.faults import as_readings, as_shares, noise, seeded

AMOUNT = (0.005, 0.015)  # of full scale, from slight to more than the 1 % that a detector must bear
SHAKING_HZ = (1.0, 10.0)  # from a step to a motor
FAR, FAR_S = (
    0.05,
    5.0,
)  # of full scale that all taxels drift at most, and seconds from one level to the next


def noisy(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """White noise on every reading."""
    return noise(shares, 100 * float(_between(AMOUNT, rng)), rng)


def shaken(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """All taxels swing together, at a frequency of this recording."""
    turns = _between(SHAKING_HZ, rng) * np.arange(len(shares)) / rate_hz + rng.random()
    return (
        shares + _between(AMOUNT, rng) * np.sin(2 * np.pi * turns).astype(np.float32)[:, None, None]
    )


def drifting(shares: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """All taxels drift together, from one level to the next."""
    times = np.arange(len(shares)) / (FAR_S * rate_hz)
    levels = rng.uniform(0, FAR, int(times[-1]) + 2)
    return (
        shares + np.interp(times, np.arange(len(levels)), levels).astype(np.float32)[:, None, None]
    )


Kind = Callable[[np.ndarray, float, np.random.Generator], np.ndarray]
KINDS: tuple[Kind, ...] = (shaken, noisy)  # that touches are found in
NAMING_KINDS: tuple[Kind, ...] = (shaken, noisy, drifting)  # that they are named in


def disturbed(corpus: Corpus, kind: Kind, some: Sequence[int] | None = None) -> Corpus:
    """Recordings, all or those at some positions, as a disturbed sensor shows them; the same at each call."""
    some, streams = range(len(corpus)) if some is None else some, []
    for i in some:
        shares = kind(
            as_shares(corpus, np.array([i]))[0],
            corpus.rate_hz,
            seeded(f"{kind.__name__} in recording {i}"),
        )
        streams.append(as_readings(corpus, shares))
    return Corpus.from_captures(
        streams, corpus.captures.iloc[some], corpus.rate_hz, full_scale=corpus.full_scale
    )


def _between(bounds: tuple[float, float], rng: np.random.Generator) -> np.float32:
    """A number whose logarithm is drawn evenly."""
    return np.float32(np.exp(rng.uniform(*np.log(bounds))))
