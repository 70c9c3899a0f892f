"""Statistics of how a touch moves: rates, shares and spectra that are defined for every grid, rate and length."""

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
SORTED_POINTS = 16  # places of a sorted list of taxels
SEGMENT_S = 1.2  # of a spectrum
SPECTRUM_POINTS = 64  # least of a spectrum, padded
BANDS = np.array([0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32]) / 32  # of half the rate
POINT_SPREAD = 1e-3  # of a side: a spread below is that of a point
STILL_SHARE = 1e-5  # what moves less, rounding moves, and another precision elsewhere
LAGS_S = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
SIGNALS = (
    *(
        "total",
        "peak",
        "change",
        "rise",
        "relative_change",
        "net_change",
        "one_way",
        "row",
        "col",
        "spread",
    ),
    *(
        "elongation",
        "half_area",
        "concentration",
        "speed",
        "flow",
        "explained",
        "flow_row",
        "flow_col",
        "likeness",
    ),
)
STEPWISE = (
    "change",
    "rise",
    "relative_change",
    "net_change",
    "one_way",
    "speed",
    "flow",
    "explained",
)
STEP_SIGNALS = tuple(map(SIGNALS.index, (*STEPWISE, "flow_row", "flow_col", "likeness")))
SPECTRAL_SIGNALS = tuple(
    map(
        SIGNALS.index,
        (
            "total",
            "change",
            "row",
            "col",
            "relative_change",
            "net_change",
            "flow_row",
            "flow_col",
            "half_area",
        ),
    )
)
LAGGED_SIGNALS = tuple(map(SIGNALS.index, ("total", "row", "col")))
CENTRE_SIGNALS = [SIGNALS.index("row"), SIGNALS.index("col")]
STATISTICS = (
    *(f"q{q}" for q in QUANTILES),
    *("mean", "sd", "step", "step_sd", "crossings", "turns", "skewness", "kurtosis"),
)
TAXEL_FEATURES = tuple(
    f"{name}_{i}" for name in ("mean", "sd", "most") for i in (*range(SORTED_POINTS), "entropy")
)
BATCH_VALUES = 1 << 21  # sensor values of the captures whose statistics are taken at once
RUN_VALUES = 1 << 18  # sensor values whose signals are taken at once


class TouchFeatures(FeatureSet):
    """427 statistics of 19 signals, and of the taxels in order of size; none counts anything that grows with duration.

    Signals, one number per frame, of pressure p as shares of full scale: logarithms of mean,
    largest, mean absolute step and mean rise (1e-4 added); step and net step relative to the
    pressure of both frames, net step relative to the absolute one; row and column of the centre of
    pressure, spread about it and elongation, in shares of the grid's sides; share of taxels above
    half of the largest; concentration (squared mean by mean square); log speed of the centre; the
    shift of the pressure between two frames that explains the step best (least squares on the
    gradient of pressure, in taxels; its log size, rows, columns, and how much of the step it
    explains); and the cosine between two frames. What belongs to a step has in the first frame the
    value of the second.

    Of each signal: quantiles 5, 25, 50, 75, 95, mean, SD, mean and SD of its steps, rates of
    crossings of the mean and of turning points, skewness, kurtosis. Of nine signals the log power,
    its shares in ten bands between 0 and half the rate, and the centroid (Hann windows of 1.2 s,
    half overlapping). Of total and centre the autocorrelation at six lags between 0.05 and 0.4 s.
    Range of the centre and correlation of its row and column. Mean, SD and largest value over time
    of each taxel, sorted, read at 16 places from the first to the last, logarithms; and their
    entropies.

    No threshold is in sensor units, and nothing counts taxels, frames or hertz. One frame has no
    steps and no spectrum: they are 0.
    """

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Features [captures, 427], float32."""
        table = np.zeros((len(corpus), len(feature_names())), dtype=np.float32)
        if len(corpus):
            values, first = _signals_of_corpus(corpus)
            stored, starts = shared_frames(corpus)
            for rows in _equal_length_batches(corpus):
                length = corpus.lengths[rows[0]]
                frames = np.arange(length)
                raw = stored[starts[rows][:, None] + frames].reshape(len(rows), length, -1)
                shares = raw.astype(np.float32) / np.float32(corpus.full_scale)
                table[rows] = capture_statistics(
                    values[first[rows][:, None] + frames], shares, corpus.rate_hz
                )
        return pd.DataFrame(table, columns=feature_names(), copy=False)

    def keeps(self, frames: int, taxels: int) -> int:
        """A ring of signals, two frames, and of each taxel mean, squares about it and largest of two halves.

        That is enough for windows of which each begins in the middle of the one before. Sorting a
        signal, keeping that of the centre, spectra and sorting the taxels take room besides.
        """
        return frames * (len(SIGNALS) + 3) + 9 * taxels + 5 * SPECTRUM_POINTS // 2


@cache
def feature_names() -> pd.Index:
    """Names of the features."""
    spectral = (*(f"band{i}" for i in range(1, len(BANDS))), "power", "centroid")
    return pd.Index(
        [
            *(f"{s}_{k}" for k in STATISTICS for s in SIGNALS),
            *(f"{SIGNALS[i]}_{k}" for k in spectral for i in SPECTRAL_SIGNALS),
            *(
                f"{SIGNALS[i]}_after_{round(1000 * lag)}_ms"
                for lag in LAGS_S
                for i in LAGGED_SIGNALS
            ),
            *("row_range", "col_range", "row_col_correlation"),
            *(f"taxels_{name}" for name in TAXEL_FEATURES),
        ]
    )


def _signals_of_corpus(corpus: Corpus) -> tuple[np.ndarray, np.ndarray]:
    """Signals of all frames that captures have, each frame once, and where those of each capture begin."""
    starts = shared_frames(corpus)[1]
    lowest, ends = starts.min(), starts + corpus.lengths
    opened = np.zeros(
        ends.max() - lowest + 1, dtype=np.int64
    )  # captures that begin less those that end
    np.add.at(opened, starts - lowest, 1)
    np.add.at(opened, ends - lowest, -1)
    covered = opened.cumsum() > 0
    runs = lowest + np.flatnonzero(np.diff(covered, prepend=False)).reshape(-1, 2)
    values = np.concatenate([_signals_between(corpus, begin, end) for begin, end in runs.tolist()])
    return values, (covered.cumsum() - 1)[starts - lowest]


def _signals_between(corpus: Corpus, begin: int, end: int) -> np.ndarray:
    stored = shared_frames(corpus)[0]
    size = max(1, RUN_VALUES // max(1, corpus.grid[0] * corpus.grid[1]))
    values = np.empty((end - begin, len(SIGNALS)))
    for first in range(begin, end, size):
        before = max(first - 1, begin)
        frames = stored[before : min(first + size, end)].astype(np.float32) / np.float32(
            corpus.full_scale
        )
        values[first - begin : first - begin + size] = frame_signals(frames)[first - before :]
    return values


def _equal_length_batches(corpus: Corpus) -> Iterator[np.ndarray]:
    """Captures of one length, not too many at a time."""
    order = np.argsort(corpus.lengths, kind="stable")
    taxels = corpus.grid[0] * corpus.grid[1]
    for rows in np.split(order, np.flatnonzero(np.diff(corpus.lengths[order])) + 1):
        most = max(1, BATCH_VALUES // int(corpus.lengths[rows[0]] * max(taxels, len(SIGNALS))))
        for i in range(0, len(rows), most):
            yield rows[i : i + most]


def frame_signals(shares: np.ndarray) -> np.ndarray:
    """Signals [frames, 19] of consecutive frames; signals of a step are 0 in the first.

    Args:
        p: shares of full scale, float32 [frames, rows, cols].
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
    moved = step.reshape(n, -1)
    change = np.abs(moved).sum(axis=1).astype(np.float64)
    net = np.diff(total, prepend=total[:1])
    both = total + np.concatenate([total[:1], total[:-1]])

    r, c = (np.arange(rows) + 0.5) / rows, (np.arange(cols) + 0.5) / cols
    row, col = (
        np.where(total > 0, _divide_or_zero(row_dot_products(m, w), total), 0.5)
        for m, w in ((by_row, r), (by_col, c))
    )
    down, right = r - row[:, None], c - col[:, None]
    high = _divide_or_zero(np.einsum("ij,ij,ij->i", by_row, down, down), total)
    wide = _divide_or_zero(np.einsum("ij,ij,ij->i", by_col, right, right), total)
    askew = _divide_or_zero(
        row_dot_products(np.einsum("ijk,k->ij", shares, c.astype(np.float32)), r), total
    ) - row * col * (total > 0)
    spread = np.sqrt(np.maximum(high + wide, 0))
    # Of pressure on one taxel, what is left of both is rounding.
    elongation = _divide_or_zero(
        np.sqrt((high - wide) ** 2 + 4 * askew**2), np.where(spread > POINT_SPREAD, high + wide, 0)
    ).clip(0, 1)
    travel = np.hypot(np.diff(row, prepend=row[:1]), np.diff(col, prepend=col[:1]))

    flow_row, flow_col, explained = _shift_between_frames(shares, step)
    alike = np.ones(n)
    alike[1:] = np.einsum("ij,ij->i", flat[1:], flat[:-1])
    size = np.sqrt(square * np.concatenate([square[:1], square[:-1]]))
    return np.column_stack(
        [
            *(np.log(x / taxels + EPS) for x in (total, peak * taxels, change, (change + net) / 2)),
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
            np.where(size > 0, alike / np.where(size > 0, size, 1), 1),
        ]
    )


def _shift_between_frames(
    p: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shift between two frames in rows and columns, at most 2 taxels, and the share of the step that it explains."""
    n = len(p)
    down, right = (_spatial_gradient(p, axis).reshape(n, -1) for axis in (1, 2))
    for gradient in (down, right):
        gradient[1:] += gradient[:-1].copy()
        gradient *= np.float32(0.5)
    moved = step.reshape(n, -1)

    def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ij->i", a, b).astype(np.float64)

    rr, cc, rc = product(down, down), product(right, right), product(down, right)
    rt, ct = -product(down, moved), -product(right, moved)
    ridge = 1e-5 + 0.01 * (rr + cc)
    determinant = (rr + ridge) * (cc + ridge) - rc**2
    v = ((cc + ridge) * rt - rc * ct) / determinant
    u = ((rr + ridge) * ct - rc * rt) / determinant
    explained = _divide_or_zero(v * rt + u * ct, product(moved, moved)).clip(0, 1)
    return v.clip(-2, 2), u.clip(-2, 2), explained


def _spatial_gradient(p: np.ndarray, axis: int) -> np.ndarray:
    """Half the difference of the neighbours along a side, 0 at the edges; of two taxels, their difference."""
    q = np.moveaxis(p, axis, 1)
    gradient = np.zeros_like(p)
    out = np.moveaxis(gradient, axis, 1)
    if q.shape[1] == 2:
        out[:] = (q[:, 1] - q[:, 0])[:, None]
    elif q.shape[1] > 2:
        out[:, 1:-1] = (q[:, 2:] - q[:, :-2]) * np.float32(0.5)
    return gradient


def _divide_or_zero(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A / b, and 0 where b is not above 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast(a, b).shape), where=b > 0)


def capture_statistics(x: np.ndarray, shares: np.ndarray, rate_hz: float) -> np.ndarray:
    """Features of captures of one length [captures, 427].

    Args:
        x: their signals [captures, frames, 19].
        shares: their readings, shares of full scale [captures, frames, taxels].
        rate_hz: frames per second.
    """
    w, n, _ = x.shape
    x = x.copy()
    x[:, 0, STEP_SIGNALS] = x[:, 1, STEP_SIGNALS] if n > 1 else 0
    still = np.ptp(x, axis=1) <= STILL_SHARE * np.maximum(np.abs(x[:, 0]), 1)
    np.copyto(
        x, x[:, :1].copy(), where=still[:, None]
    )  # in place: sums depend on how numbers lie in memory
    mean = x.sum(axis=1) / n
    centred = x - mean[:, None]
    square = centred * centred
    variance = square.sum(axis=1) / n
    sd = np.sqrt(variance)
    varies = sd > 1e-9 * np.abs(mean) + 1e-12
    scale = np.where(varies, sd, 1)
    skewness = np.where(varies, np.einsum("wfs,wfs->ws", square, centred) / n / scale**3, 0)
    kurtosis = np.where(varies, np.einsum("wfs,wfs->ws", square, square) / n / scale**4, 3)
    of_steps = [np.zeros_like(mean)] * 4  # of one frame
    if n > 1:
        step = x[:, 1:] - x[:, :-1]
        size, side = np.abs(step), centred > 0
        crossings = (side[:, 1:] != side[:, :-1]).sum(axis=1) / (n - 1)
        turns = (step[:, 1:] * step[:, :-1] < 0).sum(axis=1) / max(n - 2, 1)
        of_steps = [size.sum(axis=1) / (n - 1), step.std(axis=1), crossings, turns]
    of_signals = [*_signal_quantiles(x), mean, sd, *of_steps, skewness, kurtosis.clip(0, 30)]
    centre = centred[:, :, CENTRE_SIGNALS]
    product = variance[:, CENTRE_SIGNALS[0]] * variance[:, CENTRE_SIGNALS[1]]
    together = (centre[:, :, 0] * centre[:, :, 1]).sum(axis=1) / n / np.sqrt(product + 1e-9)
    return np.concatenate(
        [
            *of_signals,
            *_spectrum_features(centred[:, :, SPECTRAL_SIGNALS], rate_hz),
            *_autocorrelations(centred[:, :, LAGGED_SIGNALS], rate_hz),
            np.ptp(x[:, :, CENTRE_SIGNALS], axis=1),
            together[:, None],
            *_sorted_taxel_features(shares),
        ],
        axis=1,
    )


def _signal_quantiles(x: np.ndarray) -> list[np.ndarray]:
    """Linear between the two values next to each."""
    ordered = np.sort(x, axis=1)
    quantiles = []
    for q in QUANTILES:
        at = (x.shape[1] - 1) * q / 100
        low = int(at)
        high = min(low + 1, x.shape[1] - 1)
        quantiles.append(ordered[:, low] * (1 - (at - low)) + ordered[:, high] * (at - low))
    return quantiles


def _spectrum_features(x: np.ndarray, rate_hz: float) -> list[np.ndarray]:
    """Log shares of the power in bands, log power, centroid as a share of the rate; 0 for one frame."""
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
    bands = np.log(
        (np.add.reduceat(power, first, axis=1) + 1e-6 * total[:, None] + 1e-12)
        / (total[:, None] + 1e-12)
    )
    share = np.arange(1, power.shape[1] + 1) / points
    return [
        bands.reshape(w, -1),
        np.log(total + 1e-8),
        _divide_or_zero(np.einsum("wfs,f->ws", power, share), total),
    ]


def _autocorrelations(x: np.ndarray, rate_hz: float) -> list[np.ndarray]:
    """Autocorrelation of centred signals; 0 where the capture is not longer than the lag, or nothing varies."""
    n = x.shape[1]
    variance = (x * x).mean(axis=1)
    varies = variance > 1e-12
    lags = [
        max(1, round(seconds * rate_hz)) for seconds in LAGS_S
    ]  # of a lag beyond the capture the sum is empty
    sums = [(x[:, lag:] * x[:, : max(n - lag, 0)]).sum(axis=1) for lag in lags]
    return [np.where(varies, each / n / np.where(varies, variance, 1), 0) for each in sums]


def _sorted_taxel_features(shares: np.ndarray) -> list[np.ndarray]:
    """Sorted mean, SD and largest of the taxels, read at equally spaced places, and the entropy of each."""
    mean = shares.mean(axis=1, dtype=np.float64)
    away = shares - mean[:, None].astype(
        np.float32
    )  # squares of the shares themselves would hide a small SD
    variance = np.einsum("ijk,ijk->ik", away, away).astype(np.float64) / shares.shape[1]
    taxels = mean.shape[1]
    at = np.linspace(0, taxels - 1, SORTED_POINTS)
    low = at.astype(int)
    high, part = np.minimum(low + 1, taxels - 1), at - low
    columns = []
    for values in (mean, np.sqrt(variance), shares.max(axis=1).astype(np.float64)):
        ordered = -np.sort(-values, axis=1)
        columns.append(np.log(ordered[:, low] * (1 - part) + ordered[:, high] * part + EPS))
        share = values / np.maximum(values.sum(axis=1, keepdims=True), 1e-9)
        entropy = -(share * np.log(share + 1e-9)).sum(axis=1, keepdims=True)
        columns.append(entropy / max(np.log(taxels), 1e-9) if taxels > 1 else 0 * entropy)
    return columns
