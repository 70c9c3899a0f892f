"""Features against loops over the papers' definitions, on any length and grid, or by hand."""

from functools import partial
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.linalg import solve_toeplitz
from scipy.ndimage import label as components
from scipy.spatial import ConvexHull
from sklearn.base import clone

from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.features.balli import Balli
from bench.features.gaus import Gaus
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.features.ta273 import Ta273
from bench.features.touch import TouchFeatures
from bench.features.touch_profiles import TouchProfiles
from bench.features.wingerden45 import Wingerden45
from tests.features.captures import (
    GRIDS,
    LEVELS,
    assert_near,
    corpus_of,
    ragged_frames,
    row_of,
    strongest_wave,
)


def mean_or_0(values):
    return np.mean(values) if np.size(values) else 0


def centre(frame):
    """Row and column of the centre of pressure, from 1; the middle if nothing is pressed."""
    if not frame.any():
        return (np.array(frame.shape) + 1) / 2
    return ((np.indices(frame.shape) + 1) * frame).sum(axis=(1, 2)) / frame.sum()


def count_maxima(x):
    return sum(x[t - 1] < x[t] > x[t + 1] for t in range(1, len(x) - 1))


def peaks(frame, least):
    """Yield taxels above ``least`` and all earlier neighbours, and not below later ones."""
    for r, c in np.ndindex(frame.shape):
        value, around = frame[r, c], np.pad(frame, 1)[r : r + 3, c : c + 3].ravel()
        if value > least and (value > around[:4]).all() and (value >= around[5:]).all():
            yield r + 1, c + 1


def jung(frames, corpus, area="frame", crossings=False):
    """Features 1-54, or with the crossings of mean + SD as feature 22."""
    P, T, top = frames.astype(float), len(frames), float(frames.max())
    s = [frame.sum() for frame in P]
    com = np.array([centre(frame) for frame in P])
    change, path, steps = np.abs(np.diff(P, axis=0)), np.diff(com, axis=0), max(T - 1, 1)
    areas = [(frame > 0.5 * (frame.max() if area == "frame" else top)).mean() for frame in P]

    def crossed(level):
        return sum(before <= level < now for before, now in pairwise(s))

    out = [P.mean(), top, change.sum() / steps, *P.mean(axis=(0, 2)), *P.mean(axis=(0, 1))]
    out += [np.mean(areas), areas[int(np.argmax(s))]]
    out += [crossed(sum(s) / T + np.std(s)) if crossings else count_maxima(s), crossed(sum(s) / T)]
    for moved in np.abs(path).sum(axis=0):
        out += [moved / steps, moved]
    out += [T, *np.histogram(P, bins=8, range=(0, corpus.full_scale))[0] / P.size]
    distances = []
    for frame in P:
        distances.append([np.hypot(*(p - centre(frame))) for p in peaks(frame, 0.75 * top)])
    counts = list(map(len, distances))
    out += [np.mean(counts), np.var(counts), mean_or_0(sum(distances, []))]
    out += [mean_or_0([abs(np.mean(b) - np.mean(a)) for a, b in pairwise(distances) if a and b])]
    out += [mean_or_0(np.abs(np.diff(P.mean(axis=axis), axis=0))) for axis in (2, 1)]
    out += [mean_or_0(change), P.var()]
    quadrants, length = np.zeros(4), np.hypot(*path.T)
    for down, right in path[length > 1e-6]:
        for side in (-5, 5):
            angle = np.degrees(np.arctan2(-down, right)) + side
            quadrants[int(angle % 360 // 90) % 4] += 0.5 / steps
    if T > 1:
        out += [*quadrants, mean_or_0(length), np.std(length), length.sum(), np.ptp(length)]
    else:
        out += [0] * 8
    return out + [strongest_wave(x, range(1, T // 2 + 1), T)[0] * corpus.rate_hz / T for x in com.T]


def ta(frames, corpus, levels):
    """The 273 features, with levels of the first two captures, which are the training part."""
    P, T, rate, full_scale = frames.astype(float), len(frames), corpus.rate_hz, corpus.full_scale
    m, s = P.mean(axis=(1, 2)), frames.sum(axis=(1, 2), dtype=float)
    seen = np.concatenate([corpus[i].mean(axis=(1, 2)) for i in range(2)])
    if levels == "training":
        levels = np.linspace(np.quantile(seen, 0.01), np.quantile(seen, 0.99), 16)
    else:
        levels = full_scale * np.arange(1, 17) / 17
    out = [
        T,
        P.mean(),
        P.max(),
        np.median(P),
        P.std(),
        mean_or_0(np.abs(np.diff(P, axis=0))),
        count_maxima(m),
    ]
    out += [sum((a * T > sum(s)) != (b * T > sum(s)) for a, b in pairwise(s))]
    out += list(np.histogram(P, bins=16, range=(0, full_scale))[0] / P.size)
    out += [sum((a > level) != (b > level) for a, b in pairwise(m)) * rate / T for level in levels]
    taxels = P.reshape(T, -1)
    out += [*taxels.mean(axis=0), *taxels.std(axis=0)]
    out += [*(taxels > taxels.min(axis=0) + 0.1 * full_scale).mean(axis=0)]
    x, n = np.interp(np.linspace(0, T - 1, 128), np.arange(T), m), np.arange(128)
    out += [abs(sum(x * np.exp(-2j * np.pi * k * n / 128))) / 128 for k in range(1, 21)]
    out += [
        np.sqrt((1 + (k > 0)) / 128) * sum(x * np.cos(np.pi * k * (2 * n + 1) / 256))
        for k in range(20)
    ]
    return out + [strongest_wave(m, range(1, T // 2 + 1), T)[0] * rate / T]


def signals_of_balli(P):
    """The 16 signals of one frame."""
    top = np.argwhere(P == P.max())[0] + 1  # the first in reading order
    polar = (P * ((np.moveaxis(np.indices(P.shape), 0, 2) + 1 - centre(P)) ** 2).sum(axis=2)).sum()
    out = [P.mean(), *centre(P), P.max(), *top, polar]
    region = P > P.max() / 2
    if not region.any():
        return [*out, *[0] * 9]
    taxels = np.argwhere(region)
    area = len(taxels)
    hull = ConvexHull(np.concatenate([taxels + [dr, dc] for dr in (0, 1) for dc in (0, 1)])).volume
    values, vectors = np.linalg.eigh(np.cov(taxels.T, bias=True) + np.eye(2) / 12)
    angle = longer = 0.0
    if values[1] - values[0] > 1e-9:
        longer = np.sqrt(1 - values[0] / values[1])
        angle = np.arctan2(vectors[1, 1], vectors[0, 1])
        angle = (angle + np.pi / 2 - 1e-9) % np.pi - np.pi / 2 + 1e-9
        angle = round(angle, 12)  # 1e-16 differs from 0
    parts = components(region, np.ones((3, 3)))[1]
    holes = components(np.pad(~region, 1, constant_values=True))[1] - 1
    shape = [4 * np.sqrt(values[1]), 4 * np.sqrt(values[0]), longer, angle]
    return [*out, area, hull, *shape, np.sqrt(4 * area / np.pi), parts - holes, area / hull]


def statistics_of_balli(x):
    """The 13 statistics of one signal."""
    T, largest = len(x), np.abs(x).max()

    def flat(part):
        return not len(part) or np.std(part) <= 1e-9 * largest

    points = []
    for n in (8, 16):  # rescaled range of chunks that vary
        chunks = [x[i : i + n] for i in range(0, T - n + 1, n) if not flat(x[i : i + n])]
        ratios = [np.ptp(np.cumsum(chunk - chunk.mean())) / chunk.std() for chunk in chunks]
        points += [(np.log(n), np.log(np.mean(ratios)))] if ratios else []
    hurst = np.polyfit(*np.array(points).T, 1)[0] if len(points) > 1 else 0.5
    d, dd = np.diff(x), np.diff(x, 2)
    mobility = 0 if flat(x) or flat(d) else np.sqrt(d.var() / x.var())
    complexity = 0 if not mobility or flat(dd) else np.sqrt(dd.var() / d.var()) / mobility
    out = [np.mean(x), np.median(x), np.var(x), x.min(), x.max(), np.mean(x * x)]
    out += [hurst, mobility, complexity]
    if flat(x):
        return [*out, 0, 0, 0, 0]
    y = x - x.mean()
    r = np.array([sum(y[: max(T - k, 0)] * y[k:]) / T for k in range(5)])
    return [*out, *solve_toeplitz(r[:4] + [1e-9 * r[0], 0, 0, 0], r[1:])]


def balli(frames, corpus):
    signals = np.array([signals_of_balli(frame) for frame in frames.astype(float)]).T
    return [value for signal in signals for value in statistics_of_balli(signal)]


def gaus(frames, corpus):
    """The families sd, bmh and msd."""
    x = frames.reshape(len(frames), -1).astype(np.float64)
    high = 2 * x > x.max()
    kinds = np.where(high, 2, 20 * (x - x.min(axis=0)) > corpus.full_scale)
    out = []
    for kind in range(3):
        shares = (kinds == kind).mean(axis=1)
        out += [np.mean(shares), np.std(shares), max(shares)]
    out += [np.mean(kinds.max(axis=0) == kind) for kind in range(3)] + [*high.any(axis=0)]
    q1, median, q3 = np.percentile(x, [25, 50, 75], axis=0)
    moving, shape = np.ptp(x, axis=0) > 0, np.zeros((2, x.shape[1]))
    if moving.any():
        shape[:, moving] = stats.skew(x[:, moving]), stats.kurtosis(x[:, moving])
    taxels = [x.mean(axis=0), median, x.min(axis=0), x.max(axis=0)]
    taxels += [x.sum(axis=0) / corpus.rate_hz, q1, q3, q3 - q1]
    return [*out, *np.transpose([*taxels, x.var(axis=0), *shape]).ravel()]


LOOPS = {
    Jung54("capture"): partial(jung, area="capture"),
    Jung28(): partial(jung, crossings=True),
    Jung28("capture", "maxima"): partial(jung, area="capture"),
    Ta273(): partial(ta, levels="training"),
    Ta273("fixed"): partial(ta, levels="fixed"),
    Balli(0): balli,
    Gaus(("sd", "bmh", "msd")): gaus,
}


@pytest.mark.parametrize("features", LOOPS, ids=str)
@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]), st.booleans())
def test_features_equal_a_loop_over_the_definitions(features, seed, grid, levels, real):
    low, high, full_scale = LEVELS[levels]
    arrays = ragged_frames(seed, grid, low, high)
    if real and not isinstance(features, Ta273):
        # multiples of 1/1024 for Gaus, so that no sum is rounded and equal steps are equal
        scale = 1 / 1024 if isinstance(features, Gaus) else 0.7 / full_scale
        arrays, full_scale = [(a * scale).astype(np.float32) for a in arrays], full_scale * scale
    corpus = corpus_of(arrays, full_scale=full_scale)
    table = clone(features).fit(corpus[:2]).transform(corpus)
    for i, frames in enumerate(corpus):
        assert_near(table.iloc[i], LOOPS[features](frames, corpus)[: table.shape[1]], atol=1e-6)


@given(st.integers(0, 10_000), st.sampled_from(GRIDS))
def test_wingerden_is_2014_with_features_29_to_43_of_2017_and_two_more(seed, grid):
    corpus = corpus_of(ragged_frames(seed, grid))
    table, later = Wingerden45().transform(corpus), Jung54().transform(corpus)
    numbers = {1, 12, 20, 28, *range(29, 44)}
    shared = [name for name in later if int(name[1:3]) in numbers]
    np.testing.assert_allclose(table[shared], later[shared])
    for i, frames in enumerate(corpus):
        change = np.abs(np.diff(frames.astype(float), axis=0)).mean(axis=(1, 2))
        assert_near(table["f44_change_variance"][i], np.var(change) if len(change) else 0)
        counts = [len([*peaks(frame, 0.75 * frames.max())]) for frame in frames]
        assert_near(table["f45_spatial_peaks_change"][i], mean_or_0(np.abs(np.diff(counts))))


def test_sums_beyond_what_float32_counts_are_exact():
    rng = np.random.default_rng(0)
    frames = rng.integers(65000, 65535, (3, 1, 1600)).astype(np.uint16)
    frames[1] = frames[2] = frames[0]
    frames[1, 0, 0] += 1  # one unit in 10^8
    row = row_of(Jung54(), frames, full_scale=65535.0)
    assert row["f22_peaks"] == 1 and row["f03_pressure_variability"] == 1


def course_of(bits):
    """A capture of one taxel that changes by 1 in marked steps, so few that the percentile is 0."""
    assert bits.count("1") < len(bits) / 4
    return np.append(0, np.cumsum([int(bit) for bit in bits])).astype(np.uint16)[:, None, None]


def test_runs_of_gaus_by_hand():
    rest = "0" * 40
    patterns = {
        "1011011101111" + rest: [1, 1, 1, 1, 0],
        # a run of 6 is none of 5, and the last step ends a run
        "111111" + rest + "11111": [0, 0, 0, 0, 1],
        # runs on both sides of the border of two captures are two runs
        "11" + rest + "1": [1, 1, 0, 0, 0],
        "1" + rest + "1": [2, 0, 0, 0, 0],
    }
    table = Gaus(("smmhh",)).transform(corpus_of([course_of(bits) for bits in patterns]))
    assert list(table.columns) == [f"smmhh_1x1_r1c1_run{k}" for k in range(1, 6)]
    assert table.to_numpy().tolist() == [*patterns.values()]


def test_patterns_of_gaus_of_one_frame_by_hand():
    frames = {
        "00": [[1, 1, 1], [1, 5, 1], [1, 1, 1]],
        "01": [[9, 1, 1], [1, 5, 1], [1, 1, 1]],
        "06": [[9, 5, 9], [1, 5, 1], [1, 1, 1]],  # 0, 1, 2, 3, 4, 6, 7
        "57": [[5, 5, 5], [5, 5, 5], [5, 5, 5]],
        "58": [[9, 1, 9], [1, 5, 1], [9, 1, 9]],
    }
    captures = [np.array([frame], np.uint16) for frame in frames.values()]
    table = Gaus(("lbptop",)).transform(corpus_of(captures))
    assert (table.sum(axis=1) == 1).all()  # nothing on the planes of time
    for i, bin in enumerate(frames):
        assert table.loc[i, f"lbptop_xy_{bin}"] == 1


def test_touch_by_hand_on_a_fingertip_that_taps_and_moves():
    frames = np.zeros((3, 4, 4), np.uint16)
    frames[0, 1, 1], frames[1, 1, 2], frames[2, 1, 2] = 512, 512, 256
    row = row_of(TouchFeatures(), frames, 54.0, 1024.0)
    expected = {
        **{"row_mean": 1.5 / 4, "col_range": 0.25, "half_area_q50": 1 / 16},
        **{"concentration_mean": 1 / 16, "peak_q50": np.log(0.5 + 1e-4)},
        **{"spread_mean": 0, "elongation_mean": 0},
        # changes 1 and -1/4 of full scale in sum; the first frame has the value of the second
        "relative_change_mean": (1 + 1 + 1 / 3) / 3,
        **{"net_change_q5": -1 / 3 * 0.9, "one_way_mean": 1 / 3},
        **{"likeness_q95": 0.9, "likeness_mean": 1 / 3},
        **{"taxels_most_0": np.log(0.5 + 1e-4), "taxels_most_1": np.log(0.5 + 1e-4)},
        "taxels_mean_2": np.log(1e-4),
    }
    assert row[[*expected]].to_dict() == pytest.approx(expected, rel=1e-6)


@given(st.integers(0, 1000), st.sampled_from([*GRIDS, (6, 6), (2, 2)]))
def test_neighbours_of_a_capture_change_nothing_in_touch(seed, grid):
    before, after, _, capture = ragged_frames(seed, grid)
    row = TouchFeatures().transform(corpus_of([capture], None, 12.0))
    captures = pd.DataFrame({"subject": ["1"], "gesture": ["pat"]})
    for others in ([before], [capture, capture], []):
        frames, start = np.concatenate([*others, capture, after]), sum(map(len, others))
        lengths = np.array([len(capture)])
        corpus = Corpus(frames, np.array([start]), lengths, captures, 12.0, full_scale=1023.0)
        assert TouchFeatures().transform(corpus).equals(row)


def test_columns_that_only_rounding_moves_are_constant():
    """On one row the centre lies in the middle of it, wherever it is pressed."""
    rng = np.random.default_rng(0)
    arrays = [rng.integers(0, 1000, (n, 1, 7)).astype(np.uint16) for n in (2, 3, 40, 41)]
    table = TouchFeatures().extract(corpus_of(arrays, None, 50.0))
    still = table[["row_crossings", "row_turns", "row_sd", "row_step", "row_range", "row_skewness"]]
    assert still.eq(0).all(axis=None) and table["row_mean"].round(6).eq(0.5).all()
    varied = TouchFeatures().transform(generate(subjects=1, repetitions=1))
    assert (varied.std() > 1e-6).all()  # generated gestures differ in every column


@given(st.integers(0, 1000), st.sampled_from(GRIDS), st.sampled_from([5.0, 54.0]))
def test_covariances_of_profiles_equal_a_loop(seed, grid, rate):
    arrays = ragged_frames(seed, grid)
    table = TouchProfiles().extract(corpus_of(arrays, None, rate))
    for row, frames in zip(table.to_dict("records"), arrays, strict=True):
        for lines, axis in (("rows", 2), ("cols", 1)):
            profile = (frames / 1023).mean(axis=axis)
            profile = profile - profile.mean(axis=0)

            def covariance(lag, shift, profile=profile):
                pairs = [
                    profile[t - lag, line] * profile[t, line + shift]
                    for t, line in np.ndindex(profile.shape)
                    if t >= lag and 0 <= line + shift < profile.shape[1]
                ]
                return np.arcsinh(mean_or_0(pairs) / 1.8e-7)

            expected = {"after_0_ms": (0, 0), "after_0_ms_next": (0, 1)}
            for ms in (20, 40, 60, 80, 110, 150, 200, 280, 370):
                expected[f"after_{ms}_ms"] = (max(1, round(ms / 1000 * rate)), 0)
            for ms in (20, 40, 80, 150, 280):
                for side, shift in (("next", 1), ("previous", -1)):
                    expected[f"after_{ms}_ms_{side}"] = (max(1, round(ms / 1000 * rate)), shift)
            found = {k: v for k, v in row.items() if k.startswith(f"{lines}_after")}
            by_loop = {f"{lines}_{name}": covariance(*pair) for name, pair in expected.items()}
            assert found == pytest.approx(by_loop, rel=1e-4, abs=1e-5)
