"""Signals of ticks for the detector `frames`, and the features of its classifier."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, rank_filter, uniform_filter

COMMON = 0.4  # quantile over taxels that estimates a change of all taxels
HIGHEST = 25  # one in so many taxels is among the highest
MINIMA, MAXIMA, MEDIAN = (1, 2, 4, 10, 40), (2, 5, 15, 60), 30  # ticks that features look back
RISES = 8  # ticks of which the largest rise counts
LEVELS = 5  # signals that are levels: mean, excess, highest, movement, highest movement
MOVEMENT, COMMON_LEVEL = 3, 9  # signals that measure disturbance
CHANGED = 10  # the first of the signals from slow means
# Seconds of slow means, the slowest last; chosen on HAART with noise and CuddleBot.
PACES = (0.25, 0.5, 1.0, 7.5)
SLOW = 2  # slow means that readings are compared with: the last ones
CHANGES = 3 * SLOW  # signals from them: mean over taxels, highest less mean, SD
# Signals of each other mean less the slowest one: mean over taxels, highest and lowest mean of nine
# taxels, SD. They show touches that are fainter than the noise of a tick.
SUMMED = 4 * (len(PACES) - 1)
CALM, CALMEST = 60, 0.25  # ticks, and the share of them with the least common movement


class Levels:
    """Signals of a frame: levels, touched area and its centre, and changes.

    In a tick the baseline of a taxel goes shares ``up`` or ``down`` of the way to a higher or a
    lower reading, and slow means go shares ``paces``.
    """

    def __init__(self, up: float, down: float, paces: Sequence[float]) -> None:
        self.up, self.down = np.float32(up), np.float32(down)
        self.paces = np.array(paces, np.float32)[:, None]
        self.baseline = self.before = self.slow = np.zeros((0, 0), np.float32)

    def step(self, frame: np.ndarray) -> np.ndarray:
        """Signals of the next frame."""
        return self.step_many(frame[None])[0]

    def step_many(self, frames: np.ndarray) -> np.ndarray:
        """Signals of the next frames [ticks, rows, cols], as if they came one by one.

        They are levels (mean, excess, its highest, the same two of its change), area, cosine to
        the tick before, centroid, the common level of taxels, `CHANGES` and `SUMMED`.
        """
        raw = flat = frames.reshape(len(frames), -1).astype(np.float32)
        size, taxels = max(frames.shape[1:]), flat.shape[1]
        rank = int(COMMON * taxels)
        common = np.partition(flat, rank, axis=1)[:, rank]
        if taxels > 1:
            flat = np.maximum(flat - common[:, None], 0)
        if not len(self.before):
            self.baseline, self.before = flat[0].copy(), np.zeros((1, taxels), np.float32)
            self.slow = np.repeat(raw[:1], len(self.paces), axis=0)
        excess = np.concatenate([self.before, np.maximum(self._subtract_baseline(flat), 0)])
        above, before, self.before = excess[1:], excess[:-1], excess[-1:].copy()
        moved = np.abs(above - before)
        total, squares = above.sum(axis=1), (excess * excess).sum(axis=1)
        area = _divide(total * total, squares[1:], 0) / taxels
        cosine = _divide((above * before).sum(axis=1), np.sqrt(squares[1:] * squares[:-1]), 1)
        rows, cols = np.divmod(np.arange(taxels), frames.shape[2])
        y, x = (_divide((above * part).sum(axis=1), total, 0) / size for part in (rows, cols))
        mean, mean_excess, movement = (v.sum(axis=1) / taxels for v in (flat, above, moved))
        levels = mean, mean_excess, _mean_of_highest(above), movement, _mean_of_highest(moved)
        means, changes, summed = self._follow_slow_means(raw), [], []
        for slow in means[-SLOW:]:
            change = raw - slow
            mean_change = change.mean(axis=1)
            changes += [mean_change, _mean_of_highest(change) - mean_change, change.std(axis=1)]
        for smooth in means[:-1]:
            change = smooth - means[-1]
            images = change.reshape(frames.shape)
            around = uniform_filter(images, (1, 3, 3), mode="constant").reshape(change.shape)
            extremes = _mean_of_highest(around), -_mean_of_highest(-around)
            summed += [change.mean(axis=1), *extremes, change.std(axis=1)]
        columns = [*levels, area, cosine, y, x, common, *changes, *summed]
        return np.stack(columns, axis=1).astype(np.float32)

    def _follow_slow_means(self, raw: np.ndarray) -> np.ndarray:
        """Slow means after each of the readings, which they follow [paces, ticks, taxels]."""
        means = np.empty((len(raw), *self.slow.shape), np.float32)
        for tick, now in zip(means, raw, strict=True):
            self.slow += self.paces * (now - self.slow)
            tick[:] = self.slow
        return means.swapaxes(0, 1)

    def _subtract_baseline(self, flat: np.ndarray) -> np.ndarray:
        """Subtract the baseline, which follows the frames."""
        above = np.empty_like(flat)
        for tick, now in zip(above, flat, strict=True):
            np.subtract(now, self.baseline, out=tick)
            self.baseline += np.where(tick > 0, self.up, self.down) * tick
        return above


def _divide(numerator: np.ndarray, denominator: np.ndarray, default: float) -> np.ndarray:
    """Divide [ticks]; the default where the denominator is not above 0."""
    quotient = np.full_like(numerator, default)
    return np.divide(numerator, denominator, out=quotient, where=denominator > 0)


def _mean_of_highest(values: np.ndarray) -> np.ndarray:
    """The mean of the highest values of each tick [ticks]."""
    few = max(1, values.shape[1] // HIGHEST)
    return np.partition(values, values.shape[1] - few, axis=1)[:, -few:].sum(axis=1) / few


def tick_features(
    signals: np.ndarray, offsets: np.ndarray, idle: np.ndarray, slight: float
) -> np.ndarray:
    """Features of each tick, from its signals and earlier ones [ticks, features].

    The first tick of a stream is its own baseline, and nothing has moved yet. Its levels, except
    the mean, are set to those of an idle sensor; otherwise the next ticks would look like a rise.
    Logarithms are taken after offsets are added to each level and to the size of each change.
    Summed signals count in units of the sensor's noise, which is at least ``slight``.
    """
    levels = signals[:, :LEVELS].copy()
    levels[0, 1:] = idle[1:]
    logs = np.log(levels + offsets[:LEVELS])
    looks = [logs]
    looks += [logs - _past_extreme(minimum_filter1d, logs, back + 1) for back in MINIMA]
    looks += [logs - _past_extreme(maximum_filter1d, logs, back + 1) for back in MAXIMA]
    looks.append(logs - _running_median(logs, MEDIAN))
    columns = [*np.stack(looks).transpose(2, 0, 1).reshape(-1, len(logs))]
    change = np.diff(logs[:, 1], prepend=logs[:1, 1])
    rise, fall = np.maximum(change, 0), np.maximum(-change, 0)
    columns += [rise, fall]
    columns += [change - _running_median(change, MEDIAN) for change in (rise, fall)]
    columns.append(_past_extreme(maximum_filter1d, rise, RISES))
    area, cosine = signals[:, LEVELS : LEVELS + 2].T
    columns += [area, np.diff(area, prepend=area[:1]), cosine]
    centre = signals[:, LEVELS + 2 : LEVELS + 4]
    speed = np.abs(np.diff(centre, axis=0, prepend=centre[:1])).sum(axis=1)
    changes = signals[:, CHANGED : CHANGED + CHANGES].copy()
    changes[:, ::3] -= _running_median(changes[:, ::3], MEDIAN)  # a drift of all taxels cancels out
    columns += [speed, *(np.sign(changes) * np.log1p(np.abs(changes) / offsets[LEVELS:])).T]
    noise = np.maximum(_measure_noise(signals), slight)
    columns += [np.log(noise), *np.arcsinh(2 * signals[:, -SUMMED:].T / noise)]
    return np.stack(columns, axis=1).astype(np.float32)


def measure_disturbance(signals: np.ndarray) -> np.ndarray:
    """How disturbed the sensor is in each tick by vibration and by noise [ticks, 2].

    Vibration: the lower quartile of the changes of the common level. Noise: the least movement in
    the last ticks, as some are without touch. The first tick has no change, so that a stream counts
    as calm until it has left the window.
    """
    change = np.abs(np.diff(signals[:, COMMON_LEVEL], prepend=signals[:1, COMMON_LEVEL]))
    rank = int(CALMEST * CALM)
    vibration = rank_filter(change, rank, CALM, origin=(CALM - 1) // 2, mode="nearest")
    return np.stack([vibration, _measure_noise(signals)], axis=1)


def _measure_noise(signals: np.ndarray) -> np.ndarray:
    """The least movement in the last ticks [ticks]."""
    return _past_extreme(minimum_filter1d, signals[:, MOVEMENT], CALM)


def _past_extreme(extreme: Callable[..., np.ndarray], series: np.ndarray, size: int) -> np.ndarray:
    """The lowest or highest of the last ``size`` ticks [ticks, ...]."""
    return extreme(series, size, axis=0, origin=(size - 1) // 2, mode="nearest")


def _running_median(series: np.ndarray, size: int) -> np.ndarray:
    """The median of the last ``size`` ticks [ticks, ...]."""
    if series.ndim > 1:
        return np.stack([_running_median(column, size) for column in series.T], axis=1)
    place = {"origin": (size - 1) // 2, "mode": "nearest"}
    low, high = (rank_filter(series, rank, size, **place) for rank in ((size - 1) // 2, size // 2))
    return (low + high) / 2
