"""Windows as a broken sensor shows them, from which a detector learns that this is no touch.

A kind of broken sensor is a function of windows, float32 shares of full scale [windows, frames, rows, cols], and a
random generator. Amounts differ from window to window; most are drawn evenly on a logarithmic scale, in shares of full
scale, so that no sensor's units are assumed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.faults import as_shares, seeded

NOISE = (3e-4, 0.3)  # SD of white noise, in shares of full scale
LEVEL = (1e-3, 1.0)  # reading without touch
STUCK = (0.01, 1.0)  # reading of a stuck taxel
DEAD = (0.02, 0.8)  # share of taxels
HUM = (1e-3, 0.1)  # amplitude


def tared(windows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Readings less the median of their taxel."""
    return windows - np.median(windows, axis=1, keepdims=True)


def noisy(windows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """White noise on background, of another SD in each window."""
    return windows + _amounts(windows, NOISE, rng) * rng.standard_normal(windows.shape, dtype=np.float32)


def disconnected(windows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """White noise about zero, in half of the windows about another level."""
    level = _amounts(windows, LEVEL, rng) * (rng.random(len(windows)) < 0.5)[:, None, None, None]
    return noisy(np.zeros_like(windows) + level, rng)


def stuck(windows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One taxel always reads the same, in a third of the windows full scale."""
    level = np.where((rng.random(len(windows)) < 1 / 3)[:, None, None, None], 1, _amounts(windows, STUCK, rng))
    chosen = rng.integers(0, windows[0, 0].size, len(windows))
    taxels = np.arange(windows[0, 0].size).reshape(windows.shape[2:])
    return np.where(taxels == chosen[:, None, None, None], level, windows)


def dead(windows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Some taxels read 0, of another share in each window."""
    n, _, rows, cols = windows.shape
    return windows * (rng.random((n, 1, rows, cols)) >= rng.uniform(*DEAD, (n, 1, 1, 1)))


def loose(windows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """All taxels read 0, in a fifth of the windows full scale, from a random frame on or until then."""
    n, frames = windows.shape[:2]
    late = np.arange(frames) >= rng.integers(0, frames, (n, 1))
    lost = (late ^ (rng.random((n, 1)) < 0.5))[:, :, None, None]
    return np.where(lost, (rng.random((n, 1, 1, 1)) < 0.2).astype(np.float32), windows)


def humming(windows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One wave on all taxels, from half a period in a window to half the rate."""
    n, frames = windows.shape[:2]
    periods, phase = rng.uniform(0.5, frames / 2, (n, 1)), rng.uniform(0, 1, (n, 1))
    wave = 1 + np.sin(2 * np.pi * (periods * np.arange(frames) / frames + phase))
    return windows + _amounts(windows, HUM, rng) * wave[:, :, None, None].astype(np.float32)


Kind = Callable[[np.ndarray, np.random.Generator], np.ndarray]
KINDS: tuple[Kind, ...] = (tared, noisy, disconnected, stuck, dead, loose, humming)
FEELING: tuple[Kind, ...] = (stuck, dead)  # a sensor broken like this still feels touch


def broken(windows: Corpus, kind: Kind, whole: bool, seed: str) -> Corpus:
    """Windows as a broken sensor shows them, float32, 0..full_scale.

    Args:
        windows: captures of one length, at least one.
        kind: one of `KINDS`.
        whole: True if the sensor's readings are whole numbers.
        seed: seed of the amounts, together with the name of the kind.
    """
    shares = np.stack(as_shares(windows, np.arange(len(windows))))
    values = kind(shares, seeded(f"{kind.__name__} {seed}")).astype(np.float32).clip(0, 1)
    frames = (values * np.float32(windows.full_scale)).reshape(-1, *shares.shape[2:])
    starts = np.arange(len(shares)) * shares.shape[1]
    return windows.changed(frames=np.rint(frames) if whole else frames, starts=starts, digest="", path=None)


def _amounts(windows: np.ndarray, between: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """One amount for each window, float32 [windows, 1, 1, 1]."""
    return np.exp(rng.uniform(np.log(between[0]), np.log(between[1]), (len(windows), 1, 1, 1))).astype(np.float32)
