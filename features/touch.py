"""Statistics of how a touch moves, defined for every grid, rate and length."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, shared_frames
from bench.features.base import FeatureSet
from bench.features.signals import row_dot_products, row_sums

EPS = 1e-4  # of full scale, inside logarithms
QUANTILES = (5, 25, 50, 75, 95)
SORTED_POINTS = 16  # values that are read from sorted taxels
SEGMENT_S = 1.2  # of a spectrum
SPECTRUM_POINTS = 64  # shorter segments are padded
BANDS = np.array([0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32]) / 32  # of half the rate
POINT_SPREAD = 1e-3  # of a side: a smaller spread is that of a point
STILL_SHARE = 1e-5  # smaller variations are rounding, which differs on other machines
LAGS_S = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
SIGNALS = (
    *("total", "peak", "change", "rise", "relative_change", "net_change", "one_way"),
    *("row", "col", "spread", "elongation", "half_area", "concentration", "speed"),
    *("flow", "explained", "flow_row", "flow_col", "likeness"),
)


def _positions(*names: str) -> tuple[int, ...]:
    """Positions of some signals in `SIGNALS`."""
    return tuple(SIGNALS.index(name) for name in names)


STEP_SIGNALS = _positions(
    *("change", "rise", "relative_change", "net_change", "one_way", "speed"),
    *("flow", "explained", "flow_row", "flow_col", "likeness"),
)
SPECTRAL_SIGNALS = _positions(
    *("total", "change", "row", "col", "relative_change", "net_change"),
    *("flow_row", "flow_col", "half_area"),
)
LAGGED_SIGNALS = _positions("total", "row", "col")
CENTRE_SIGNALS = list(_positions("row", "col"))
STATISTICS = (
    *(f"q{q}" for q in QUANTILES),
    *("mean", "sd", "step", "step_sd", "crossings", "turns", "skewness", "kurtosis"),
)
TAXEL_FEATURES = tuple(
    f"{name}_{i}" for name in ("mean", "sd", "most") for i in (*range(SORTED_POINTS), "entropy")
)
BATCH_VALUES = 1 << 21  # readings of the captures whose statistics are computed at once
RUN_VALUES = 1 << 18  # readings whose signals are computed at once


class TouchFeatures(FeatureSet):
    """427 statistics of 19 signals, and of sorted taxels; nothing grows with the duration.

    =============== ================================================================================
    signal          one value per frame, from pressures as shares of full scale
    =============== ================================================================================
    total, peak     log of the mean and of the largest pressure; 1e-4 is added inside logs
    change, rise    log of the mean absolute step and of the mean rise of the taxels
    relative_change absolute step relative to the pressure of both frames
    net_change      net step relative to the pressure of both frames
    one_way         absolute net step relative to the absolute step
    row, col        centre of pressure, as shares of the grid's sides
    spread          SD of the pressure about the centre, as a share of the sides
    elongation      0 if the pressure spreads equally in all directions, 1 on a line
    half_area       share of taxels above half of the largest pressure
    concentration   squared mean by mean square of the taxels
    speed           log of the speed of the centre
    flow            log of the size, in taxels, of the shift between two frames that explains the
                    step best: least squares on the gradient of pressure
    explained       share of the step that this shift explains
    flow_row        and ``flow_col``: the shift in rows and columns, taxels
    likeness        cosine between two frames
    =============== ================================================================================

    Signals of steps have in the first frame the value of the second.

    ================ ===============================================================================
    statistic        of each signal, unless others are named
    ================ ===============================================================================
    q5 ... q95       quantiles 5, 25, 50, 75, 95
    mean, sd         over time
    step, step_sd    mean absolute step of the signal, and SD of its steps
    crossings        rate of crossings of the mean
    turns            rate of turning points
    skewness         and ``kurtosis``
    band1 ... band10 of nine signals: log share of the power in ten bands from 0 to half the rate,
                     from Hann windows of 1.2 s that overlap by half
    power, centroid  of nine signals: log power, and centroid of the spectrum
    after_..._ms     of total, row and col: autocorrelation at six lags from 50 to 400 ms
    row_range        and ``col_range``, ``row_col_correlation``: range and correlation of the centre
    taxels_...       mean, SD and largest value over time of each taxel, sorted: logs at 16 equally
                     spaced positions, and entropy
    ================ ===============================================================================

    No threshold is in sensor units, and nothing counts taxels, frames or hertz. Steps and spectrum
    of a single frame are 0.
    """

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture [captures, 427], float32."""
        table = np.zeros((len(corpus), len(feature_names())), dtype=np.float32)
        if len(corpus):
            values, first = _signals_of_corpus(corpus)
            stored, starts = shared_frames(corpus)
            for rows in equal_length_batches(corpus):
                length = corpus.lengths[rows[0]]
                frames = np.arange(length)
                raw = stored[starts[rows][:, None] + frames].reshape(len(rows), length, -1)
                shares = raw.astype(np.float32) / np.float32(corpus.full_scale)
                signals = values[first[rows][:, None] + frames]
                table[rows] = capture_statistics(signals, shares, corpus.rate_hz)
        return pd.DataFrame(table, columns=feature_names(), copy=False)

    def keeps(self, frames: int, taxels: int) -> int:
        """Count a ring of signals, two frames, and statistics of each taxel in two halves.

        Statistics of a taxel are mean, squares about it, and the largest value. That is enough for
        windows that overlap by half. Sorting, the signals of the centre and spectra need more room.
        """
        return frames * (len(SIGNALS) + 3) + 9 * taxels + 5 * SPECTRUM_POINTS // 2


@cache
def feature_names() -> pd.Index:
    """Names of the features."""
    spectral = (*(f"band{i}" for i in range(1, len(BANDS))), "power", "centroid")
    lags = [f"after_{round(1000 * lag)}_ms" for lag in LAGS_S]
    return pd.Index(
        [
            *(f"{signal}_{name}" for name in STATISTICS for signal in SIGNALS),
            *(f"{SIGNALS[i]}_{name}" for name in spectral for i in SPECTRAL_SIGNALS),
            *(f"{SIGNALS[i]}_{lag}" for lag in lags for i in LAGGED_SIGNALS),
            *("row_range", "col_range", "row_col_correlation"),
            *(f"taxels_{name}" for name in TAXEL_FEATURES),
        ]
    )


def _signals_of_corpus(corpus: Corpus) -> tuple[np.ndarray, np.ndarray]:
    """Signals of all frames of captures, each frame once, and the first position of each capture.

    Windows of a capture overlap, so captures may share frames.
    """
    starts = shared_frames(corpus)[1]
    lowest, ends = starts.min(), starts + corpus.lengths
    # Number of captures that begin minus those that end at each frame.
    changes = np.zeros(ends.max() - lowest + 1, dtype=np.int64)
    np.add.at(changes, starts - lowest, 1)
    np.add.at(changes, ends - lowest, -1)
    covered = changes.cumsum() > 0
    runs = lowest + np.flatnonzero(np.diff(covered, prepend=False)).reshape(-1, 2)
    values = np.concatenate([_signals_between(corpus, begin, end) for begin, end in runs.tolist()])
    return values, (covered.cumsum() - 1)[starts - lowest]


def _signals_between(corpus: Corpus, begin: int, end: int) -> np.ndarray:
    stored = shared_frames(corpus)[0]
    size = max(1, RUN_VALUES // max(1, corpus.grid[0] * corpus.grid[1]))
    values = np.empty((end - begin, len(SIGNALS)))
    for first in range(begin, end, size):
        before = max(first - 1, begin)
        frames = stored[before : min(first + size, end)].astype(np.float32)
        shares = frames / np.float32(corpus.full_scale)
        values[first - begin : first - begin + size] = frame_signals(shares)[first - before :]
    return values


def equal_length_batches(corpus: Corpus) -> Iterator[np.ndarray]:
    """Yield positions of captures of equal length, in batches of limited size."""
    order = np.argsort(corpus.lengths, kind="stable")
    taxels = corpus.grid[0] * corpus.grid[1]
    for rows in np.split(order, np.flatnonzero(np.diff(corpus.lengths[order])) + 1):
        values = int(corpus.lengths[rows[0]] * max(taxels, len(SIGNALS)))
        size = max(1, BATCH_VALUES // values)
        for i in range(0, len(rows), size):
            yield rows[i : i + size]


def frame_signals(shares: np.ndarray) -> np.ndarray:
    """Signals [frames, 19] of consecutive frames; signals of a step are 0 in the first.

    Args:
        shares: shares of full scale, float32 [frames, rows, cols].
    """
    n, rows, cols = shares.shape
    flat = shares.reshape(n, -1)
    taxels = flat.shape[1]
    by_row, by_col = shares.sum(axis=2).astype(np.float64), shares.sum(axis=1).astype(np.float64)
    total = row_sums(by_row)
    peak = flat.max(axis=1)
    square = np.einsum("ij,ij->i", flat, flat).astype(np.float64)
    step = np.zeros_like(shares)
    np.subtract(shares[1:], shares[:-1], out=step[1:])
    change = np.abs(step.reshape(n, -1)).sum(axis=1).astype(np.float64)
    net = np.diff(total, prepend=total[:1])
    both = total + np.concatenate([total[:1], total[:-1]])

    r, c = (np.arange(rows) + 0.5) / rows, (np.arange(cols) + 0.5) / cols
    row = np.where(total > 0, _divide_or_zero(row_dot_products(by_row, r), total), 0.5)
    col = np.where(total > 0, _divide_or_zero(row_dot_products(by_col, c), total), 0.5)
    down, right = r - row[:, None], c - col[:, None]
    row_variance = _divide_or_zero(np.einsum("ij,ij,ij->i", by_row, down, down), total)
    col_variance = _divide_or_zero(np.einsum("ij,ij,ij->i", by_col, right, right), total)
    moment = row_dot_products(np.einsum("ijk,k->ij", shares, c.astype(np.float32)), r)
    covariance = _divide_or_zero(moment, total) - row * col * (total > 0)
    variance = row_variance + col_variance
    spread = np.sqrt(np.maximum(variance, 0))
    difference = np.sqrt((row_variance - col_variance) ** 2 + 4 * covariance**2)
    # If one taxel is pressed, both are rounding.
    divisor = np.where(spread > POINT_SPREAD, variance, 0)
    elongation = _divide_or_zero(difference, divisor).clip(0, 1)
    travel = np.hypot(np.diff(row, prepend=row[:1]), np.diff(col, prepend=col[:1]))

    flow_row, flow_col, explained = _shift_between_frames(shares, step)
    products = np.ones(n)
    products[1:] = np.einsum("ij,ij->i", flat[1:], flat[:-1])
    size = np.sqrt(square * np.concatenate([square[:1], square[:-1]]))
    pressures = (total, peak * taxels, change, (change + net) / 2)
    return np.column_stack(
        [
            *(np.log(pressure / taxels + EPS) for pressure in pressures),
            _divide_or_zero(change, both),
            _divide_or_zero(net, both),
            _divide_or_zero(np.abs(net), change),
            *(row, col, spread, elongation),
            (flat > peak[:, None] * np.float32(0.5)).sum(axis=1) / taxels,
            _divide_or_zero(total**2, square) / taxels,
            np.log(travel + 1e-3),
            np.log(np.hypot(flow_row, flow_col) + 1e-2),
            explained,
            *(flow_row, flow_col),
            np.where(size > 0, products / np.where(size > 0, size, 1), 1),
        ]
    )


def _shift_between_frames(shares: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, ...]:
    """Shift between two frames and the share of the step that it explains.

    Returns:
        Shift in rows and in columns, at most 2 taxels, and the share, each [frames].
    """
    n = len(shares)
    down, right = (_spatial_gradient(shares, axis).reshape(n, -1) for axis in (1, 2))
    for gradient in (down, right):
        gradient[1:] += gradient[:-1].copy()
        gradient *= np.float32(0.5)
    change = step.reshape(n, -1)

    def dot_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ij->i", a, b).astype(np.float64)

    rr, cc = dot_products(down, down), dot_products(right, right)
    rc = dot_products(down, right)
    rt, ct = -dot_products(down, change), -dot_products(right, change)
    ridge = 1e-5 + 0.01 * (rr + cc)
    determinant = (rr + ridge) * (cc + ridge) - rc**2
    v = ((cc + ridge) * rt - rc * ct) / determinant
    u = ((rr + ridge) * ct - rc * rt) / determinant
    explained = _divide_or_zero(v * rt + u * ct, dot_products(change, change)).clip(0, 1)
    return v.clip(-2, 2), u.clip(-2, 2), explained


def _spatial_gradient(shares: np.ndarray, axis: int) -> np.ndarray:
    """Half the difference of the neighbours along an axis, 0 at the edges.

    Of two taxels, it is their difference.
    """
    values = np.moveaxis(shares, axis, 1)
    gradient = np.zeros_like(shares)
    out = np.moveaxis(gradient, axis, 1)
    if values.shape[1] == 2:
        out[:] = (values[:, 1] - values[:, 0])[:, None]
    elif values.shape[1] > 2:
        out[:, 1:-1] = (values[:, 2:] - values[:, :-2]) * np.float32(0.5)
    return gradient


def _divide_or_zero(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quotient a / b, or 0 where b is not above 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast(a, b).shape), where=b > 0)


def capture_statistics(x: np.ndarray, shares: np.ndarray, rate_hz: float) -> np.ndarray:
    """Features [captures, 427] of captures of equal length.

    Args:
        x: signals [captures, frames, 19].
        shares: readings as shares of full scale [captures, frames, taxels].
        rate_hz: frames per second.
    """
    w, n, _ = x.shape
    x = x.copy()
    x[:, 0, STEP_SIGNALS] = x[:, 1, STEP_SIGNALS] if n > 1 else 0
    still = np.ptp(x, axis=1) <= STILL_SHARE * np.maximum(np.abs(x[:, 0]), 1)
    # In place, as sums depend on the order of numbers in memory.
    np.copyto(x, x[:, :1].copy(), where=still[:, None])
    mean = x.sum(axis=1) / n
    centred = x - mean[:, None]
    square = centred * centred
    variance = square.sum(axis=1) / n
    sd = np.sqrt(variance)
    varies = sd > 1e-9 * np.abs(mean) + 1e-12
    scale = np.where(varies, sd, 1)
    skewness = np.where(varies, np.einsum("wfs,wfs->ws", square, centred) / n / scale**3, 0)
    kurtosis = np.where(varies, np.einsum("wfs,wfs->ws", square, square) / n / scale**4, 3)
    step_statistics = [np.zeros_like(mean)] * 4  # of one frame
    if n > 1:
        step = x[:, 1:] - x[:, :-1]
        size, side = np.abs(step), centred > 0
        crossings = (side[:, 1:] != side[:, :-1]).sum(axis=1) / (n - 1)
        turns = (step[:, 1:] * step[:, :-1] < 0).sum(axis=1) / max(n - 2, 1)
        step_statistics = [size.sum(axis=1) / (n - 1), step.std(axis=1), crossings, turns]
    centre = centred[:, :, CENTRE_SIGNALS]
    product = variance[:, CENTRE_SIGNALS[0]] * variance[:, CENTRE_SIGNALS[1]]
    covariance = (centre[:, :, 0] * centre[:, :, 1]).sum(axis=1) / n
    correlation = covariance / np.sqrt(product + 1e-9)
    return np.concatenate(
        [
            *_signal_quantiles(x),
            *(mean, sd, *step_statistics, skewness, kurtosis.clip(0, 30)),
            *_spectrum_features(centred[:, :, SPECTRAL_SIGNALS], rate_hz),
            *_autocorrelations(centred[:, :, LAGGED_SIGNALS], rate_hz),
            np.ptp(x[:, :, CENTRE_SIGNALS], axis=1),
            correlation[:, None],
            *_sorted_taxel_features(shares),
        ],
        axis=1,
    )


def _signal_quantiles(x: np.ndarray) -> list[np.ndarray]:
    """`QUANTILES` over time, by linear interpolation."""
    ordered = np.sort(x, axis=1)
    quantiles = []
    for q in QUANTILES:
        position = (x.shape[1] - 1) * q / 100
        low = int(position)
        high = min(low + 1, x.shape[1] - 1)
        weight = position - low
        quantiles.append(ordered[:, low] * (1 - weight) + ordered[:, high] * weight)
    return quantiles


def _spectrum_features(x: np.ndarray, rate_hz: float) -> list[np.ndarray]:
    """Log shares of power in bands, log power, centroid as a share of the rate; 0 for one frame."""
    w, n, s = x.shape
    length = min(n, max(2, round(SEGMENT_S * rate_hz)))
    if n < 2:
        return [np.zeros((w, s))] * (len(BANDS) + 1)
    window = np.hanning(length + 2)[1:-1, None]
    points = max(SPECTRUM_POINTS, length)
    begins = range(0, n - length + 1, max(length // 2, 1))
    power = 0
    for begin in begins:
        part = x[:, begin : begin + length]
        part = (part - part.mean(axis=1, keepdims=True)) * window
        spectrum = np.fft.rfft(part, points, axis=1)[:, 1:]
        power = power + spectrum.real**2 + spectrum.imag**2
    power = power / (len(begins) * (window**2).sum() * points)
    first = np.floor(BANDS[:-1] * points / 2 + 1e-9).astype(int)
    total = power.sum(axis=1)
    floor = 1e-6 * total[:, None]
    band_power = np.add.reduceat(power, first, axis=1) + floor + 1e-12
    bands = np.log(band_power / (total[:, None] + 1e-12))
    share = np.arange(1, power.shape[1] + 1) / points
    return [
        bands.reshape(w, -1),
        np.log(total + 1e-8),
        _divide_or_zero(np.einsum("wfs,f->ws", power, share), total),
    ]


def _autocorrelations(x: np.ndarray, rate_hz: float) -> list[np.ndarray]:
    """Autocorrelation of centred signals; 0 if a signal is constant or not longer than the lag."""
    n = x.shape[1]
    variance = (x * x).mean(axis=1)
    varies = variance > 1e-12
    divisor = np.where(varies, variance, 1)
    columns = []
    for seconds in LAGS_S:
        lag = max(1, round(seconds * rate_hz))
        products = x[:, lag:] * x[:, : max(n - lag, 0)]  # empty for a lag beyond the capture
        columns.append(np.where(varies, products.sum(axis=1) / n / divisor, 0))
    return columns


def _sorted_taxel_features(shares: np.ndarray) -> list[np.ndarray]:
    """Sorted mean, SD and largest value of taxels at equally spaced positions, and entropies."""
    mean = shares.mean(axis=1, dtype=np.float64)
    # Squares of the shares themselves would hide a small SD.
    centred = shares - mean[:, None].astype(np.float32)
    variance = np.einsum("ijk,ijk->ik", centred, centred).astype(np.float64) / shares.shape[1]
    taxels = mean.shape[1]
    position = np.linspace(0, taxels - 1, SORTED_POINTS)
    low = position.astype(int)
    high, weight = np.minimum(low + 1, taxels - 1), position - low
    columns = []
    for values in (mean, np.sqrt(variance), shares.max(axis=1).astype(np.float64)):
        ordered = -np.sort(-values, axis=1)
        columns.append(np.log(ordered[:, low] * (1 - weight) + ordered[:, high] * weight + EPS))
        share = values / np.maximum(values.sum(axis=1, keepdims=True), 1e-9)
        entropy = -(share * np.log(share + 1e-9)).sum(axis=1, keepdims=True)
        columns.append(entropy / max(np.log(taxels), 1e-9) if taxels > 1 else 0 * entropy)
    return columns
