"""Families against loops over the definitions, on captures of any length and grid, or by hand."""

from itertools import product

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bench.features.gaus import Gaus
from tests.features.captures import GRIDS, LEVELS, corpus_of, ragged

RATE = 100.0


def naive_sd(frames, full_scale):
    T, R, C = frames.shape
    highest = max(v for v in frames.ravel().tolist())
    kinds = np.zeros((T, R, C), int)
    for r, c in product(range(R), range(C)):
        course = frames[:, r, c].tolist()
        for t in range(T):
            if 20 * (course[t] - min(course)) > full_scale:
                kinds[t, r, c] = 1
            if 2 * course[t] > highest:
                kinds[t, r, c] = 2
    out = []
    for kind in range(3):
        shares = [np.mean(kinds[t] == kind) for t in range(T)]
        out += [np.mean(shares), np.std(shares), max(shares)]
    return out + [np.mean(kinds.max(axis=0) == kind) for kind in range(3)]


def naive_bmh(frames, full_scale):
    highest = frames.max()
    return [float(any(2 * float(v) > highest for v in course)) for course in frames.reshape(len(frames), -1).T]


def naive_msd(frames, full_scale):
    out = []
    for x in frames.reshape(len(frames), -1).T.astype(np.float64):
        q1, median, q3 = np.percentile(x, [25, 50, 75])
        out += [x.mean(), median, x.min(), x.max(), x.sum() / RATE, q1, q3, q3 - q1, x.var()]
        out += [stats.skew(x), stats.kurtosis(x)] if np.ptp(x) else [0, 0]
    return out


NAIVE = {"sd": naive_sd, "bmh": naive_bmh, "msd": naive_msd}


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]), st.booleans())
def test_features_equal_loops_over_the_definitions(seed, grid, levels, real):
    low, high, full_scale = LEVELS[levels]
    arrays = ragged(seed, grid, low, high, lengths=[1, 2, 3 + seed % 5, 15])
    if real:  # multiples of 1/1024, so that no loop and no feature rounds a sum and equal steps are equal
        arrays, full_scale = [(a / 1024).astype(np.float32) for a in arrays], full_scale / 1024
    table = Gaus().transform(corpus_of(arrays, full_scale=full_scale))
    for i, frames in enumerate(arrays):
        for family in NAIVE:
            values = table.iloc[i].filter(regex=f"^{family}_")
            expected = NAIVE[family](frames, full_scale)
            np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9, err_msg=family)


def course_of(bits):
    """A capture of one taxel that changes by 1 in the steps marked 1; there are so few that the percentile is 0."""
    assert bits.count("1") < len(bits) / 4
    return np.append(0, np.cumsum([int(bit) for bit in bits])).astype(np.uint16)[:, None, None]


def test_runs_by_hand():
    rest = "0" * 40
    patterns = {
        "1011011101111" + rest: [1, 1, 1, 1, 0],
        "111111" + rest + "11111": [0, 0, 0, 0, 1],  # a run of 6 is none of 5, the last step ends a run
        "11" + rest + "1": [1, 1, 0, 0, 0],  # the runs before and after the border of two captures are two
        "1" + rest + "1": [2, 0, 0, 0, 0],
    }
    table = Gaus(("smmhh",)).transform(corpus_of([course_of(bits) for bits in patterns]))
    assert list(table.columns) == [f"smmhh_1x1_r1c1_run{k}" for k in range(1, 6)]
    assert table.to_numpy().tolist() == [*patterns.values()]


def test_patterns_of_one_frame_by_hand():
    frames = {
        "00": [[1, 1, 1], [1, 5, 1], [1, 1, 1]],
        "01": [[9, 1, 1], [1, 5, 1], [1, 1, 1]],
        "06": [[9, 5, 9], [1, 5, 1], [1, 1, 1]],  # 0, 1, 2, 3, 4, 6, 7
        "57": [[5, 5, 5], [5, 5, 5], [5, 5, 5]],
        "58": [[9, 1, 9], [1, 5, 1], [9, 1, 9]],
    }
    table = Gaus(("lbptop",)).transform(corpus_of([np.array([frame], np.uint16) for frame in frames.values()]))
    assert (table.sum(axis=1) == 1).all()  # nothing on the planes of time
    for i, bin in enumerate(frames):
        assert table.loc[i, f"lbptop_xy_{bin}"] == 1
