"""The 208 features of Balli Altuglu and Altun 2015 (ICMI), and SFFS.

As described in Hughes et al. 2017, section II.
"""

from __future__ import annotations

from itertools import combinations, pairwise, product

import numpy as np
import pandas as pd
from sklearn.utils.validation import check_is_fitted

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.base import FeatureSet
from bench.features.selection import select_columns
from bench.features.signals import Touch, feature_table, row_sums

SIGNALS = (
    *("mean_pressure", "centroid_row", "centroid_column", "max_pressure", "max_row", "max_column"),
    *("polar_moment", "area", "convex_area", "major_axis", "minor_axis", "eccentricity"),
    *("orientation", "equivalent_diameter", "euler_number", "solidity"),
)
STATISTICS = (
    *("mean", "median", "variance", "minimum", "maximum", "energy"),
    *("hurst", "mobility", "complexity"),
    *("ar1", "ar2", "ar3", "ar4"),
)
NAMES = pd.Index([f"{signal}_{statistic}" for signal, statistic in product(SIGNALS, STATISTICS)])
STILL_SHARE = 1e-9  # of the largest magnitude: a signal that varies by less is constant
ORDER = 4
SHORTEST_CHUNK = 8  # frames
AR_RIDGE = 1e-9  # share of the variance


class Balli(FeatureSet):
    """13 statistics over time of 16 signals, or the columns of these that SFFS keeps.

    SFFS is sequential forward floating selection.

    ================ ===============================================================================
    signal           one value per frame
    ================ ===============================================================================
    mean_pressure    over the taxels, sensor value
    centroid_row     and ``centroid_column``: centre of mass, counted from 1; the middle where
                     nothing is pressed
    max_pressure     sensor value
    max_row          and ``max_column``: where it is, counted from 1; the first in reading order
    polar_moment     sum over the taxels of value times squared distance from the centre of mass
    area             taxels of the contact region: all above half of the frame's maximum, whether
                     connected or not
    convex_area      of the convex hull of the region, whose taxels are unit squares
    major_axis       and ``minor_axis``: 4 standard deviations of the region along its principal
                     axes, taxels; each taxel's own extent adds 1/12 to the variances
    eccentricity     of the ellipse with these axes
    orientation      angle from the direction in which rows are counted to the major axis, above
                     -pi/2 and up to pi/2, positive where columns grow with rows; 0 where the axes
                     are equal
    equivalent_diam. of the circle with this area, taxels
    euler_number     8-connected parts of the region minus its holes
    solidity         area / convex area
    ================ ===============================================================================

    Signals of the region are 0 in a frame in which nothing is pressed.

    ============ ===================================================================================
    statistic    one value per signal and capture
    ============ ===================================================================================
    mean, median and ``variance`` (population), ``minimum``, ``maximum``
    energy       mean square
    hurst        slope of log R/S over log n; R/S, the rescaled range, is a mean over the whole
                 chunks of n = 8, 16, 32, ... frames that are not constant; 0.5 if fewer than two n
                 have such chunks
    mobility     and ``complexity``: of Hjorth, from differences between frames; 0 where a variance
                 to divide by is 0
    ar1 ... ar4  autoregressive coefficients, Yule-Walker with the biased autocovariance, 0 beyond
                 the capture; 0 for a constant signal. 1e-9 of the variance is added to the variance
                 when solving
    ============ ===================================================================================

    A signal (or its differences) is constant if it varies by no more than rounding. Columns are
    named after signal and statistic, such as ``centroid_row_ar1``.

    Our reading: the text counts 16 signals but names 15; solidity is our sixteenth. It does not
    give the threshold of the region, the definitions of the shape signals and the estimators of
    Hurst exponent and autoregression. The authors' criterion for SFFS was a random forest, which
    would have to be fitted tens of thousands of times per fold. Here the criterion is the number of
    training captures that linear discriminant analysis classifies correctly when they are left out
    in 5 groups of subjects (fewer if there are fewer subjects; captures in turn for one subject).
    Columns are standardised without them; the covariance is pooled, plus a ridge of 1e-3, and
    priors are the classes' shares. Of equal sets, the one with the earlier column wins. Floating
    ends after 3 x ``selected`` steps; forward steps then add the missing columns.

    Args:
        selected: number of columns to keep; all that vary if there are fewer, and all 208 if the
            training captures have one class or cannot be split. 0 keeps all 208 and learns nothing.
    """

    learns = True

    def __init__(self, selected: int = 42) -> None:
        self.selected = selected

    def check(self) -> None:
        """Raise an InputError for wrong parameters, before anything is run."""
        if self.selected < 0:
            raise InputError(f"features.selected={self.selected}: give 1 or more, or 0 for all 208")

    def keeps(self, frames: int, taxels: int) -> int:
        """Count the signals of the capture and one frame."""
        return len(SIGNALS) * frames + taxels

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the 208 features of every capture."""
        self.check()
        return feature_table(corpus, NAMES, _statistic_columns)

    def fit(self, X: Corpus, y: object = None) -> Balli:
        """Select the columns on the training captures; without ``y``, classes are the gestures."""
        self.check()
        self.names_ = NAMES
        if self.selected:
            self.names_ = select_columns(Balli(0).transform(X), X, y, self.selected)
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Selected features of each capture [captures, n_features]."""
        self.check()
        if not self.selected:
            return super().transform(X)
        check_is_fitted(self, "names_")
        return Balli(0).transform(X)[self.names_]  # one stored table for every ``selected``

    def __sklearn_is_fitted__(self) -> bool:
        return not self.selected or "names_" in vars(self)


def _statistic_columns(touch: Touch) -> list[np.ndarray]:
    signals = np.column_stack(frame_signals(touch))
    values = np.stack(signal_statistics(touch, signals), axis=2)
    return [values.reshape(len(values), -1)]


def frame_signals(touch: Touch) -> list[np.ndarray]:
    """The 16 signals in the order of `SIGNALS`, each float64 [frames]."""
    max_taxel = touch.values.argmax(axis=1)
    squares = [
        row_sums((np.arange(1, side.shape[1] + 1) - middle[:, None]) ** 2 * side)
        for side, middle in zip((touch.rows, touch.cols), touch.centre.T, strict=True)
    ]
    region = touch.values > touch.as_threshold(touch.peak * 0.5)[:, None]
    return [
        touch.total / touch.taxels,
        *touch.centre.T,
        touch.peak,
        max_taxel // touch.grid[1] + 1,
        max_taxel % touch.grid[1] + 1,
        squares[0] + squares[1],
        *_region_signals(region, touch.grid),
    ]


def _region_signals(mask: np.ndarray, grid: tuple[int, int]) -> list[np.ndarray]:
    """Area to solidity of the region that a mask [frames, taxels] marks in each frame."""
    row, col = np.indices(grid).reshape(2, -1).astype(np.float64)
    powers = np.stack([row**0, row, col, row * row, col * col, row * col], axis=1)
    area, r, c, rr, cc, rc = (mask @ powers).T  # whole numbers, exact
    touched = area > 0
    square = np.where(touched, area * area, 1)
    across = (area * cc - c * c) / square
    down = (area * rr - r * r) / square
    covariance = (area * rc - r * c) / square
    difference = np.hypot(down - across, 2 * covariance)  # of the eigenvalues
    total = down + across + 1 / 6
    major, minor = (total + difference) / 2, (total - difference) / 2
    by_row = np.ascontiguousarray(mask.T).reshape(*grid, -1)
    convex = convex_area(by_row)
    return [
        area,
        convex,
        touched * 4 * np.sqrt(major),
        touched * 4 * np.sqrt(minor),
        np.sqrt(difference / major),
        np.arctan2(2 * covariance, down - across) / 2,
        np.sqrt(area * (4 / np.pi)),
        euler_number(by_row, area),
        area / np.where(touched, convex, 1),
    ]


def convex_area(mask: np.ndarray) -> np.ndarray:
    """Area of the convex hull of the marked unit squares of each frame.

    The corners of the hull lie on the lines between rows, so its width is linear between two lines.
    On a line, each side of the hull is as far out as any straight line between two corners of
    squares reaches there.

    Args:
        mask: bool [rows, cols, frames].
    """
    if mask.shape[0] > mask.shape[1]:  # the cost grows with the third power of the rows
        mask = mask.swapaxes(0, 1)
    rows, cols, frames = mask.shape
    reach = np.full((2, rows, frames), -np.inf)  # right and, as a negative number, left
    for c in range(cols):
        np.copyto(reach[0], c + 1, where=mask[:, c])
        np.copyto(reach[1], c + 1 - cols, where=mask[:, cols - 1 - c])
    corner = np.full((2, rows + 1, frames), -np.inf)
    corner[:, :-1] = reach
    np.maximum(corner[:, 1:], reach, out=corner[:, 1:])
    hull = corner.copy()
    for a, b in combinations(range(rows + 1), 2):
        if b - a > 1:
            share = np.arange(1, b - a)[:, None]
            line = corner[:, a, None] * (b - a - share) + corner[:, b, None] * share
            np.maximum(hull[:, a + 1 : b], line / (b - a), out=hull[:, a + 1 : b])
    width = hull[0] + hull[1]
    # Row after row: numpy's sum adds in another order if there is one frame.
    return sum(np.maximum((width[:-1] + width[1:]) / 2, 0), start=np.zeros(frames))


def euler_number(mask: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Number of 8-connected parts minus holes of the marked taxels of each frame.

    It is corners minus edges plus squares of the marked unit squares; shared ones count once.

    Args:
        mask: bool [rows, cols, frames].
        area: marked taxels of each frame.
    """
    upright, level = _either_neighbour(mask, 1), _either_neighbour(mask, 0)
    corners = _either_neighbour(upright, 0)
    edges = upright.sum(axis=(0, 1), dtype=np.float64) + level.sum(axis=(0, 1), dtype=np.float64)
    return corners.sum(axis=(0, 1), dtype=np.float64) - edges + area


def _either_neighbour(mask: np.ndarray, axis: int) -> np.ndarray:
    """True for boundaries along an axis with a marked neighbour, outer boundaries included."""
    before, after = [(0, 0)] * mask.ndim, [(0, 0)] * mask.ndim
    before[axis], after[axis] = (1, 0), (0, 1)
    return np.pad(mask, before) | np.pad(mask, after)


def signal_statistics(touch: Touch, signal: np.ndarray) -> list[np.ndarray]:
    """The 13 statistics in the order of `STATISTICS` of signals [frames, n], each [captures, n]."""
    mean = touch.mean(signal)
    low, high = np.minimum.reduceat(signal, touch.starts), np.maximum.reduceat(signal, touch.starts)
    still = STILL_SHARE * np.maximum(np.abs(low), np.abs(high))
    centred = signal - mean[touch.capture_of_frame]
    variance = touch.mean(centred**2)
    is_flat = np.sqrt(variance) <= still
    return [
        mean,
        _capture_medians(touch, signal),
        variance,
        low,
        high,
        touch.mean(signal**2),
        _hurst_exponents(touch, signal, still),
        *_hjorth_parameters(touch, signal, np.where(is_flat, 0, variance), still),
        *np.moveaxis(_autoregressive_coefficients(touch, centred, is_flat), 2, 0),
    ]


def _capture_medians(touch: Touch, signal: np.ndarray) -> np.ndarray:
    ordered = touch.sorted_within_captures(np.ascontiguousarray(signal.T)).T
    low = ordered[touch.starts + (touch.lengths - 1) // 2]
    high = ordered[touch.starts + touch.lengths // 2]
    return (low + high) / 2


def _hurst_exponents(touch: Touch, signal: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Slope of log2 R/S over log2 n; chunks that vary by no more than ``still`` have no R/S."""
    sums = np.zeros((5, *still.shape))  # of 1, x, y, x * x, x * y over the points of the line
    n = SHORTEST_CHUNK
    for x in range(int(touch.lengths.max()).bit_length()):
        chunks = touch.lengths // n
        captures = np.flatnonzero(chunks)  # those of at least n frames
        if not len(captures):
            break
        offset = np.cumsum(chunks) - chunks
        owner = np.repeat(np.arange(len(chunks)), chunks)
        begin = touch.starts[owner] + n * (np.arange(len(owner)) - offset[owner])
        chunk = signal[begin[:, None] + np.arange(n)]
        chunk -= chunk.mean(axis=1, keepdims=True)
        deviation = np.sqrt(np.mean(chunk**2, axis=1))
        np.cumsum(chunk, axis=1, out=chunk)
        varies = deviation > still[owner]
        chunk_range = chunk.max(axis=1) - chunk.min(axis=1)
        ratio = chunk_range * varies / np.where(varies, deviation, 1)
        count = np.add.reduceat(varies, offset[captures], axis=0, dtype=np.float64)
        is_defined = count > 0
        ratios = np.add.reduceat(ratio, offset[captures], axis=0)
        y = np.log2(np.where(is_defined, ratios, 1) / np.maximum(count, 1))
        terms = [np.ones_like(y), np.full_like(y, x), y, np.full_like(y, x * x), x * y]
        sums[:, captures] += is_defined * np.stack(terms)
        n *= 2
    points, x, y, xx, xy = sums
    has_line = points > 1
    divisor = np.where(has_line, points * xx - x * x, 1)
    return np.where(has_line, (points * xy - x * y) / divisor, 0.5)


def _hjorth_parameters(
    touch: Touch, signal: np.ndarray, variance: np.ndarray, still: np.ndarray
) -> list[np.ndarray]:
    """Mobility and complexity; ``variance`` is 0 where the signal is constant."""
    variances = [variance]
    for order in (1, 2):
        signal = touch.frame_differences(signal)
        has_difference = _has_frames_before(touch, order)
        signal *= has_difference
        count = np.maximum(touch.lengths - order, 1)[:, None]
        mean = touch.sum(signal) / count
        centred = (signal - mean[touch.capture_of_frame]) * has_difference
        spread = touch.sum(centred**2) / count
        variances.append(np.where(np.sqrt(spread) <= still, 0, spread))
    mobility, second = (np.sqrt(b / np.where(a > 0, a, np.inf)) for a, b in pairwise(variances))
    return [mobility, second / np.where(mobility > 0, mobility, np.inf)]


def _autoregressive_coefficients(
    touch: Touch, centred: np.ndarray, is_flat: np.ndarray
) -> np.ndarray:
    """Coefficients of the last `ORDER` frames [captures, n, ORDER], the last frame's first."""
    covariance = np.zeros((*is_flat.shape, ORDER + 1))
    for lag in range(ORDER + 1):
        products = np.zeros_like(centred)
        products[lag:] = centred[lag:] * centred[: max(len(centred) - lag, 0)]
        covariance[..., lag] = touch.mean(products * _has_frames_before(touch, lag))
    covariance /= np.where(is_flat, 1, covariance[..., 0])[..., None]
    covariance[is_flat] = np.eye(ORDER + 1)[0]
    lags = np.arange(ORDER)
    system = covariance[..., np.abs(lags[:, None] - lags)] + AR_RIDGE * np.eye(ORDER)
    return np.linalg.solve(system, covariance[..., 1:, None])[..., 0]


def _has_frames_before(touch: Touch, number: int) -> np.ndarray:
    """True for frames with at least so many frames of their capture before them [frames, 1]."""
    capture = touch.capture_of_frame
    return (np.arange(len(capture)) - touch.starts[capture] >= number)[:, None]
