"""The features of Gaus et al. 2015 (ICMI), as described in Hughes et al. 2017, section II."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.base import FeatureSet
from bench.features.signals import Touch, feature_table, taxel_names

FAMILIES = ("sd", "bmh", "msd", "smmhh", "lbptop")
RANGES = ("none", "touch", "high")
STATISTICS = (
    *("mean", "median", "min", "max", "area", "q1", "q3", "iqr"),
    *("variance", "skewness", "kurtosis"),
)
LONGEST_RUN = 5
PLANES = {"xy": (0, 1), "xt": (2, 1), "yt": (2, 0)}  # axes of an array [rows, cols, frames]
# Neighbours, once round the centre.
RING = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))
# A pattern is uniform if it changes at most twice on its way round.
UNIFORM = [p for p in range(256) if (p ^ (p >> 1 | p % 2 << 7)).bit_count() <= 2]


class Gaus(FeatureSet):
    """Ranges of readings, statistics of taxels, bursts of motion, patterns in space and time.

    ====== === =====================================================================================
    sd     12  shares of the taxels of a frame that are in each of three ranges: not touched,
               touched, high; mean, SD and maximum over time of each; then the shares of the taxels
               whose highest range in the capture is each of the three
    bmh    64  1 if the taxel is ever high, else 0
    msd    704 mean, median, minimum, maximum, area (integral over time, sensor value seconds),
               first and third quartile, inter-quartile range, variance, skewness and excess
               kurtosis of each taxel over time
    smmhh  425 85 cells of a pyramid of averaged frames (8x8, 4x4, 2x2, 1x1): numbers of runs of
               exactly 1 to 5 consecutive steps in which the cell changes much
    lbptop 177 shares of the 58 uniform local binary patterns and of all others on the planes XY
               (row, column), XT (time, column) and YT (time, row)
    ====== === =====================================================================================

    Sizes are for 8 x 8 taxels and follow the grid. Hughes et al. give neither thresholds nor
    neighbourhoods; these are our readings:

    - A taxel is touched while it is more than 5 % of full scale above its minimum in the capture,
      and high while it is above 50 % of the capture's maximum. High comes first: a taxel that is
      pressed all the time is high although it never leaves its minimum, so every value lies in one
      range.
    - Variance, skewness and kurtosis are those of the population, 0 where a taxel is constant;
      quartiles interpolate linearly.
    - Each level of the pyramid halves the rows and columns of the one below, rounded up, down to
      one cell. A cell is the average of the taxels in it; on odd sides the last one has fewer.
    - A cell changes much in the steps (absolute change since the frame before) that are greater
      than the 75th percentile of all its steps in the capture. A longer run than 5 is not counted.
    - A pattern compares the 8 square neighbours at distance 1 with the centre (1 if not less),
      wherever all of them exist; bit 0 is the neighbour before on both axes, the others follow
      towards the next on the second axis. Uniform patterns are numbered by their value, the others
      are ``58``. A plane without such a place, as in captures of one or two frames, has zeros.

    Args:
        families: families to compute, from ``sd``, ``bmh``, ``msd``, ``smmhh`` and ``lbptop``;
            their order has no effect.
    """

    def __init__(self, families: tuple[str, ...] = FAMILIES) -> None:
        self.families = families

    def check(self) -> None:
        """Raise an InputError for wrong parameters, before anything is run."""
        families = self.families if isinstance(self.families, (tuple, list)) else ()
        if families and set(families) <= set(FAMILIES) and len(set(families)) == len(families):
            return
        text = "+".join(map(str, families)) or self.families
        raise InputError(f"features.families={text}: give some of {'+'.join(FAMILIES)}, each once")

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the features of every capture."""
        self.check()
        names = feature_names(*corpus.grid, frozenset(self.families))
        return feature_table(corpus, names, self._family_columns)

    def _family_columns(self, touch: Touch) -> list[np.ndarray]:
        values = np.ascontiguousarray(touch.values.T)
        families = [family for family in FAMILIES if family in self.families]
        return [_FAMILY_FUNCTIONS[family](touch, values) for family in families]


@cache
def feature_names(rows: int, cols: int, families: frozenset[str] = frozenset(FAMILIES)) -> pd.Index:
    """Names of the features of some families on a grid."""
    taxels = taxel_names(rows, cols)
    cells = [f"{r}x{c}_{cell}" for r, c in _pyramid_grids(rows, cols) for cell in taxel_names(r, c)]
    parts_of_names = {
        "sd": [*product(RANGES, ("mean", "sd", "max")), *((name, "taxels") for name in RANGES)],
        "bmh": [(taxel,) for taxel in taxels],
        "msd": product(taxels, STATISTICS),
        "smmhh": product(cells, [f"run{i}" for i in range(1, LONGEST_RUN + 1)]),
        "lbptop": product(PLANES, [f"{i:02d}" for i in range(len(UNIFORM) + 1)]),
    }
    names = []
    for family in FAMILIES:
        if family in families:
            names += ["_".join((family, *parts)) for parts in parts_of_names[family]]
    return pd.Index(names)


def _pyramid_grids(rows: int, cols: int) -> list[tuple[int, int]]:
    levels = [(rows, cols)]
    while levels[-1] != (1, 1):
        levels.append(((levels[-1][0] + 1) // 2, (levels[-1][1] + 1) // 2))
    return levels


# Each family takes the values as [taxels, frames] and gives [captures, n].


def _sd_family(touch: Touch, values: np.ndarray) -> np.ndarray:
    lowest = np.minimum.reduceat(values, touch.starts, axis=1)
    rise = touch.as_threshold(np.array(touch.full_scale / 20))  # times 0.05 would be rounded twice
    high = values > np.repeat(_half_of_maximum(touch, values), touch.lengths)
    touched = values - np.repeat(lowest, touch.lengths, axis=1) > rise
    touched |= high
    count = _count_in_ranges(touched, high)
    spread = np.sqrt(touch.variance(count))
    largest = np.maximum.reduceat(count, touch.starts)
    over_time = np.stack([touch.mean(count), spread, largest], axis=2)
    ever_touched = np.logical_or.reduceat(touched, touch.starts, axis=1)
    ever_high = np.logical_or.reduceat(high, touch.starts, axis=1)
    ever = _count_in_ranges(ever_touched, ever_high)
    return np.column_stack([over_time.reshape(len(ever), -1), ever]) / touch.taxels


def _half_of_maximum(touch: Touch, values: np.ndarray) -> np.ndarray:
    """Half of the maximum of each capture, in the type of the values."""
    highest = np.maximum.reduceat(values.max(axis=0), touch.starts)
    return touch.as_threshold(highest * 0.5)


def _count_in_ranges(touched: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Number of taxels in each range [n, 3], of bool [taxels, n]; high ones are also touched."""
    ranges = (~touched, touched & ~high, high)
    return np.stack([marked.sum(axis=0) for marked in ranges], axis=1)


def _bmh_family(touch: Touch, values: np.ndarray) -> np.ndarray:
    return (np.maximum.reduceat(values, touch.starts, axis=1) > _half_of_maximum(touch, values)).T


def _msd_family(touch: Touch, values: np.ndarray) -> np.ndarray:
    ordered = touch.sorted_within_captures(values)
    lowest, highest = ordered[:, touch.starts], ordered[:, touch.starts + touch.lengths - 1]
    q1, median, q3 = (_quartile_of_captures(touch, ordered, number) for number in (1, 2, 3))
    total = np.add.reduceat(values, touch.starts, axis=1, dtype=np.float64)
    mean = total / touch.lengths
    centred = values - np.repeat(mean, touch.lengths, axis=1)
    power, moments = centred, []
    for _ in range(3):
        power = power * centred
        moments.append(np.add.reduceat(power, touch.starts, axis=1) / touch.lengths)
    variance, third, fourth = moments
    divisor = np.where(variance > 0, variance, 1)  # the variance of equal values is exactly 0
    skewness = third / divisor**1.5
    kurtosis = np.where(variance > 0, fourth / divisor**2 - 3, 0)
    columns = [
        *(mean, median, lowest, highest, total / touch.rate_hz, q1, q3, q3 - q1),
        *(variance, skewness, kurtosis),
    ]
    return np.stack(columns, axis=-1).transpose(1, 0, 2).reshape(len(touch.lengths), -1)


def _quartile_of_captures(touch: Touch, ordered: np.ndarray, number: int) -> np.ndarray:
    below, quarters = np.divmod(number * (touch.lengths - 1), 4)
    low = ordered[:, touch.starts + below].astype(np.float64)
    high = ordered[:, touch.starts + below + (quarters > 0)]
    return low + (high - low) * (quarters / 4)


def _smmhh_family(touch: Touch, values: np.ndarray) -> np.ndarray:
    cells = _pyramid_sums(touch, values)
    moved = np.zeros_like(cells)
    before, after = cells[:, :-1], cells[:, 1:]
    np.subtract(np.maximum(before, after), np.minimum(before, after), out=moved[:, 1:])  # unsigned
    moved[:, touch.starts] = 0
    # An interpolated percentile lies between two neighbours in order: a step exceeds it if it
    # exceeds the lower one, so nothing is rounded. The 0 of the first frame, which is no step, is
    # first in order.
    position = touch.starts + np.where(touch.lengths > 1, 1 + 3 * (touch.lengths - 2) // 4, 0)
    percentile = touch.sorted_within_captures(moved)[:, position]
    return _count_runs(touch, moved > np.repeat(percentile, touch.lengths, axis=1))


def _pyramid_sums(touch: Touch, values: np.ndarray) -> np.ndarray:
    """Sum of the taxels of each cell [cells, frames].

    Steps are compared within a cell, so sums serve as averages.
    """
    if touch.integer:
        values = values.astype(np.uint16 if int(values.max()) * touch.taxels < 2**16 else np.int64)
    level, levels = values.reshape(*touch.grid, -1), [values]
    while level.shape[:2] != (1, 1):
        for axis in (0, 1):
            pairs = np.arange(0, level.shape[axis], 2)
            level = np.add.reduceat(level, pairs, axis=axis, dtype=values.dtype)
        levels.append(level.reshape(-1, level.shape[2]))
    return np.concatenate(levels)


def _count_runs(touch: Touch, signals: np.ndarray) -> np.ndarray:
    """Number of runs of exactly 1 to 5 frames [captures, n * 5], of bool signals [n, frames].

    Signals are False in first frames, which separates the runs of captures and signals.
    """
    flat = signals.ravel()  # one signal after the other
    edges = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    begin, end = edges[::2], edges[1::2]
    if len(end) < len(begin):
        end = np.append(end, len(flat))
    length = end - begin
    is_short = length <= LONGEST_RUN
    signal, frame = np.divmod(begin[is_short], signals.shape[1])
    row = touch.capture_of_frame[frame] * len(signals) + signal
    kind = row * LONGEST_RUN + length[is_short] - 1
    shape = len(touch.lengths), len(signals) * LONGEST_RUN
    return np.bincount(kind, minlength=shape[0] * shape[1]).reshape(shape)


def _lbptop_family(touch: Touch, values: np.ndarray) -> np.ndarray:
    grid = values.reshape(*touch.grid, -1)
    inner = touch.capture_of_frame.copy()
    # Frames without a frame before or after them count for one more capture, which is dropped.
    inner[touch.starts] = inner[touch.starts + touch.lengths - 1] = len(touch.lengths)
    shares = []
    for axes in PLANES.values():
        capture = inner[1:-1] if 2 in axes else touch.capture_of_frame
        kind = _binary_patterns(grid, axes) + 256 * capture
        count = np.bincount(kind.ravel(), minlength=256 * (len(touch.lengths) + 1))
        uniform = count.reshape(-1, 256)[:-1] @ _pattern_bins()
        shares.append(uniform / np.maximum(uniform.sum(axis=1, keepdims=True), 1))
    return np.concatenate(shares, axis=1)


def _binary_patterns(grid: np.ndarray, axes: tuple[int, int]) -> np.ndarray:
    """Local binary patterns on one plane wherever all neighbours exist."""

    def shift_window(steps: tuple[int, int]) -> np.ndarray:
        window = [slice(None)] * 3
        for axis, step in zip(axes, steps, strict=True):
            window[axis] = slice(1 + step, max(grid.shape[axis] - 1 + step, 1 + step))
        return grid[tuple(window)]

    centre = shift_window((0, 0))
    patterns = np.zeros(centre.shape, dtype=np.uint8)
    for bit, steps in enumerate(RING):
        patterns |= (shift_window(steps) >= centre).view(np.uint8) << bit
    return patterns


@cache
def _pattern_bins() -> np.ndarray:
    """Bin of each pattern, as 0 or 1 [256, 59]."""
    bins = np.full(256, len(UNIFORM))
    bins[UNIFORM] = np.arange(len(UNIFORM))
    return np.eye(len(UNIFORM) + 1)[bins]


_FAMILY_FUNCTIONS = {
    "sd": _sd_family,
    "bmh": _bmh_family,
    "msd": _msd_family,
    "smmhh": _smmhh_family,
    "lbptop": _lbptop_family,
}
