"""The 208 features of Balli Altuglu and Altun 2015 (ICMI), after Hughes et al. 2017 (section II), and SFFS."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pandas as pd
from sklearn.utils.validation import check_is_fitted

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.base import RELATIVE_ROUNDING, FeatureSet
from bench.features.selection import select_columns
from bench.features.signals import Touch, feature_table, row_sums

SIGNALS = (
    *(
        "mean_pressure",
        "centroid_row",
        "centroid_column",
        "max_pressure",
        "max_row",
        "max_column",
        "polar_moment",
    ),
    *(
        "area",
        "convex_area",
        "major_axis",
        "minor_axis",
        "eccentricity",
        "orientation",
        "equivalent_diameter",
    ),
    *("euler_number", "solidity"),
)
STATISTICS = (
    *(
        "mean",
        "median",
        "variance",
        "minimum",
        "maximum",
        "energy",
        "hurst",
        "mobility",
        "complexity",
    ),
    *("ar1", "ar2", "ar3", "ar4"),
)
NAMES = pd.Index([f"{signal}_{statistic}" for signal, statistic in product(SIGNALS, STATISTICS)])
ORDER = 4
SHORTEST_CHUNK = 8  # frames
AR_RIDGE = 1e-9  # share of the variance


class Balli(FeatureSet):
    """13 statistics over time of 16 signals, of which sequential forward floating selection (SFFS) keeps some.

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

    A signal (or its differences) counts as constant where only rounding moves it. A column is named
    after signal and statistic, such as ``centroid_row_ar1``.

    What is our reading: the text names 15 signals where it counts 16, solidity is our sixteenth;
    the threshold of the region, the definitions of all shape signals and the estimators of Hurst
    exponent and autoregression are not given there. The authors' criterion for SFFS was a random
    forest. It would have to be fitted tens of thousands of times per fold, so here it is linear
    discriminant analysis: the number of training captures that it gets right when they are left out
    in 5 groups of subjects (fewer where there are fewer subjects; captures in turn where there is
    one subject), on columns standardised without them, with the pooled covariance plus a ridge of
    1e-3 and the classes' shares as priors. Of equal sets the one with the earlier column wins.
    Floating ends after 3 x ``selected`` steps; what is missing then is added by forward steps.

    Args:
        selected: number of columns to keep; all that vary if there are fewer, and all 208 if the
            training captures have one class or cannot be split. 0 keeps all 208 and learns nothing.
    """

    learns = True

    def __init__(self, selected: int = 42) -> None:
        self.selected = selected

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run."""
        if self.selected < 0:
            raise InputError(
                f"features.selected={self.selected}: give at least 1, or 0 for all 208"
            )

    def keeps(self, frames: int, taxels: int) -> int:
        """Signals of the capture and one frame."""
        return len(SIGNALS) * frames + taxels

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the 208 features of every capture."""
        self.check()
        return feature_table(corpus, NAMES, _statistic_columns)

    def fit(self, X: Corpus, y: object = None) -> Balli:
        """Select the columns on the training captures alone; labels are the captures' gestures if none are given."""
        self.check()
        self.names_ = NAMES
        if self.selected:
            self.names_ = select_columns(Balli(0).transform(X), X, y, self.selected)
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """The columns that were kept, of each capture [captures, n_features]."""
        self.check()
        if not self.selected:
            return super().transform(X)
        check_is_fitted(self, "names_")
        return Balli(0).transform(X)[self.names_]  # one stored table for every ``selected``

    def __sklearn_is_fitted__(self) -> bool:
        return not self.selected or "names_" in vars(self)


def _statistic_columns(touch: Touch) -> list[np.ndarray]:
    values = np.stack(signal_statistics(touch, np.column_stack(frame_signals(touch))), axis=2)
    return [values.reshape(len(values), -1)]


def frame_signals(touch: Touch) -> list[np.ndarray]:
    """The 16 signals in the order of `SIGNALS`, each float64 [frames]."""
    highest = touch.values.argmax(axis=1)
    squares = [
        row_sums((np.arange(1, side.shape[1] + 1) - middle[:, None]) ** 2 * side)
        for side, middle in zip((touch.rows, touch.cols), touch.centre.T, strict=True)
    ]
    return [
        touch.total / touch.taxels,
        *touch.centre.T,
        touch.peak,
        highest // touch.grid[1] + 1,
        highest % touch.grid[1] + 1,
        squares[0] + squares[1],
        *_region_signals(touch.values > touch.as_threshold(touch.peak * 0.5)[:, None], touch.grid),
    ]


def _region_signals(mask: np.ndarray, grid: tuple[int, int]) -> list[np.ndarray]:
    """Area to solidity of the region that a mask [frames, taxels] marks in each frame."""
    row, col = np.indices(grid).reshape(2, -1).astype(np.float64)
    moments = mask @ np.stack(
        [row**0, row, col, row * row, col * col, row * col], axis=1
    )  # whole numbers, exact
    area, r, c, rr, cc, rc = moments.T
    touched = area > 0
    square = np.where(touched, area * area, 1)
    across, down, both = (
        (area * cc - c * c) / square,
        (area * rr - r * r) / square,
        (area * rc - r * c) / square,
    )
    apart = np.hypot(down - across, 2 * both)  # difference of the eigenvalues
    middle = down + across + 1 / 6
    major, minor = (middle + apart) / 2, (middle - apart) / 2
    by_row = np.ascontiguousarray(mask.T).reshape(*grid, -1)
    convex = convex_area(by_row)
    return [
        area,
        convex,
        touched * 4 * np.sqrt(major),
        touched * 4 * np.sqrt(minor),
        np.sqrt(apart / major),
        np.arctan2(2 * both, down - across) / 2,
        np.sqrt(area * (4 / np.pi)),
        euler_number(by_row, area),
        area / np.where(touched, convex, 1),
    ]


def convex_area(mask: np.ndarray) -> np.ndarray:
    """Area of the convex hull of the marked unit squares of each frame; ``mask`` is bool [rows, cols, frames].

    The corners of the hull lie on the lines between rows, so between two lines its width is linear.
    On a line, each side of the hull is as far out as any straight line between two corners of
    squares reaches there.
    """
    if mask.shape[0] > mask.shape[1]:  # the cost grows with the third power of the rows
        mask = mask.swapaxes(0, 1)
    rows, cols, frames = mask.shape
    reach = np.full(
        (2, rows, frames), -np.inf
    )  # to the right, and to the left as a negative number
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
    # One row after the other: numpy's sum adds in another order where there is one frame.
    return sum(np.maximum((width[:-1] + width[1:]) / 2, 0), start=np.zeros(frames))


def euler_number(mask: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Corners minus edges plus squares of the marked taxels of each frame; ``mask`` is bool [rows, cols, frames].

    Corners and edges are those of unit squares, shared ones count once. It is the number of
    8-connected parts minus that of holes, as the usual count of 2 x 2 patterns gives it.
    """
    upright, level = _either_neighbour(mask, 1), _either_neighbour(mask, 0)
    corners = _either_neighbour(upright, 0)
    edges = upright.sum(axis=(0, 1), dtype=np.float64) + level.sum(axis=(0, 1), dtype=np.float64)
    return corners.sum(axis=(0, 1), dtype=np.float64) - edges + area


def _either_neighbour(mask: np.ndarray, axis: int) -> np.ndarray:
    """Whether either neighbour of each boundary between places along an axis is marked, outer boundaries included."""
    before, after = [(0, 0)] * mask.ndim, [(0, 0)] * mask.ndim
    before[axis], after[axis] = (1, 0), (0, 1)
    return np.pad(mask, before) | np.pad(mask, after)


def signal_statistics(touch: Touch, signal: np.ndarray) -> list[np.ndarray]:
    """The 13 statistics in the order of `STATISTICS` of signals [frames, n], each [captures, n]."""
    mean = touch.mean(signal)
    low, high = np.minimum.reduceat(signal, touch.starts), np.maximum.reduceat(signal, touch.starts)
    still = RELATIVE_ROUNDING * np.maximum(np.abs(low), np.abs(high))
    centred = signal - mean[touch.capture_of_frame]
    variance = touch.mean(centred**2)
    flat = np.sqrt(variance) <= still
    return [
        mean,
        _capture_medians(touch, signal),
        variance,
        low,
        high,
        touch.mean(signal**2),
        _hurst_exponents(touch, signal, still),
        *_hjorth_parameters(touch, signal, np.where(flat, 0, variance), still),
        *np.moveaxis(_autoregressive_coefficients(touch, centred, flat), 2, 0),
    ]


def _capture_medians(touch: Touch, signal: np.ndarray) -> np.ndarray:
    ordered = touch.sorted_within_captures(np.ascontiguousarray(signal.T)).T
    return (
        ordered[touch.starts + (touch.lengths - 1) // 2] + ordered[touch.starts + touch.lengths // 2]
    ) / 2


def _hurst_exponents(touch: Touch, signal: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Slope of log2 R/S over log2 n; of a chunk that deviates no more than ``still`` there is no R/S."""
    sums = np.zeros((5, *still.shape))  # of 1, x, y, x * x, x * y over the points of the line
    n = SHORTEST_CHUNK
    for x in range(int(touch.lengths.max()).bit_length()):
        chunks = touch.lengths // n
        long = np.flatnonzero(chunks)  # captures of at least n frames
        if not len(long):
            break
        offset = np.cumsum(chunks) - chunks
        owner = np.repeat(np.arange(len(chunks)), chunks)
        begin = touch.starts[owner] + n * (np.arange(len(owner)) - offset[owner])
        chunk = signal[begin[:, None] + np.arange(n)]
        chunk -= chunk.mean(axis=1, keepdims=True)
        deviation = np.sqrt(np.mean(chunk**2, axis=1))
        np.cumsum(chunk, axis=1, out=chunk)
        moves = deviation > still[owner]
        ratio = (chunk.max(axis=1) - chunk.min(axis=1)) * moves / np.where(moves, deviation, 1)
        count = np.add.reduceat(moves, offset[long], axis=0, dtype=np.float64)
        defined = count > 0
        y = np.log2(
            np.where(defined, np.add.reduceat(ratio, offset[long], axis=0), 1)
            / np.maximum(count, 1)
        )
        sums[:, long] += defined * np.stack(
            [np.ones_like(y), np.full_like(y, x), y, np.full_like(y, x * x), x * y]
        )
        n *= 2
    points, x, y, xx, xy = sums
    line = points > 1
    return np.where(line, (points * xy - x * y) / np.where(line, points * xx - x * x, 1), 0.5)


def _hjorth_parameters(
    touch: Touch, signal: np.ndarray, variance: np.ndarray, still: np.ndarray
) -> list[np.ndarray]:
    """Mobility and complexity; ``variance`` is 0 where the signal is constant."""
    variances = [variance]
    for order in (1, 2):
        signal = touch.frame_differences(signal)
        late = _has_frames_before(touch, order)
        signal *= late  # the difference to a first frame's 0 is none
        count = np.maximum(touch.lengths - order, 1)[:, None]
        mean = touch.sum(signal) / count
        spread = touch.sum(((signal - mean[touch.capture_of_frame]) * late) ** 2) / count
        variances.append(np.where(np.sqrt(spread) <= still, 0, spread))
    ratios = [
        np.sqrt(b / np.where(a > 0, a, np.inf))
        for a, b in zip(variances[:-1], variances[1:], strict=True)
    ]
    return [ratios[0], ratios[1] / np.where(ratios[0] > 0, ratios[0], np.inf)]


def _autoregressive_coefficients(touch: Touch, centred: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Coefficients of the last `ORDER` frames [captures, n, ORDER], the last frame's first."""
    covariance = np.zeros((*flat.shape, ORDER + 1))
    for lag in range(ORDER + 1):
        together = np.zeros_like(centred)
        together[lag:] = centred[lag:] * centred[: max(len(centred) - lag, 0)]
        covariance[..., lag] = touch.mean(together * _has_frames_before(touch, lag))
    covariance /= np.where(flat, 1, covariance[..., 0])[..., None]
    covariance[flat] = np.eye(ORDER + 1)[0]
    lags = np.arange(ORDER)
    system = covariance[..., np.abs(lags[:, None] - lags)] + AR_RIDGE * np.eye(ORDER)
    return np.linalg.solve(system, covariance[..., 1:, None])[..., 0]


def _has_frames_before(touch: Touch, number: int) -> np.ndarray:
    """Whether each frame has at least this many frames of its capture before it, [frames, 1]."""
    return (np.arange(len(touch.capture_of_frame)) - touch.starts[touch.capture_of_frame] >= number)[
        :, None
    ]
