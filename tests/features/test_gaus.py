"""Every family against loops over the definitions, on captures of any length and grid."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bench.features.gaus import FAMILIES, Gaus
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


def naive_smmhh(frames, full_scale):
    T, R, C = frames.shape
    out, side = [], 1
    while True:
        rows, cols = -(-R // side), -(-C // side)
        for i, j in product(range(rows), range(cols)):
            cell = frames[:, i * side : (i + 1) * side, j * side : (j + 1) * side]
            means = [sum(Fraction(v) for v in frame.ravel().tolist()) / frame.size for frame in cell]
            out += naive_runs([abs(after - before) for before, after in zip(means[:-1], means[1:], strict=True)])
        if (rows, cols) == (1, 1):
            return out
        side *= 2


def naive_runs(steps):
    if not steps:
        return [0] * 5
    ordered, position = sorted(steps), Fraction(3, 4) * (len(steps) - 1)
    low, high = ordered[int(position)], ordered[min(int(position) + 1, len(steps) - 1)]
    percentile = low + (position - int(position)) * (high - low)
    runs = [len(run) for run in "".join("01"[step > percentile] for step in steps).split("0")]
    return [runs.count(k) for k in range(1, 6)]


def changes(pattern):
    bits = f"{pattern:08b}"
    return sum(bits[i] != bits[i - 1] for i in range(8))


UNIFORM = [pattern for pattern in range(256) if changes(pattern) <= 2]


def naive_lbptop(frames, full_scale):
    out = []
    for axes in ((1, 2, 0), (0, 2, 1), (0, 1, 2)):  # row and column, time and column, time and row
        cube, counts = frames.transpose(axes), [0] * 59
        for a, b, d in np.ndindex(cube.shape):
            if 0 < a < cube.shape[0] - 1 and 0 < b < cube.shape[1] - 1:
                ring = [(a - 1, b - 1), (a - 1, b), (a - 1, b + 1), (a, b + 1)]
                ring += [(a + 1, b + 1), (a + 1, b), (a + 1, b - 1), (a, b - 1)]
                pattern = sum(2**k for k, (i, j) in enumerate(ring) if cube[i, j, d] >= cube[a, b, d])
                counts[UNIFORM.index(pattern) if pattern in UNIFORM else 58] += 1
        out += [count / max(sum(counts), 1) for count in counts]
    return out


NAIVE = {"sd": naive_sd, "bmh": naive_bmh, "msd": naive_msd, "smmhh": naive_smmhh, "lbptop": naive_lbptop}
SIZES = {"sd": 12, "bmh": 64, "msd": 704, "smmhh": 425, "lbptop": 177}


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]), st.booleans())
def test_features_equal_loops_over_the_definitions(seed, grid, levels, real):
    low, high, full_scale = LEVELS[levels]
    arrays = ragged(seed, grid, low, high, lengths=[1, 2, 3 + seed % 5, 15])
    if real:  # multiples of 1/1024, so that no loop and no feature rounds a sum and equal steps are equal
        arrays, full_scale = [(a / 1024).astype(np.float32) for a in arrays], full_scale / 1024
    table = Gaus().transform(corpus_of(arrays, full_scale=full_scale))
    for i, frames in enumerate(arrays):
        for family in FAMILIES:
            values = table.iloc[i].filter(regex=f"^{family}_")
            expected = NAIVE[family](frames, full_scale)
            if family in ("bmh", "smmhh"):
                assert values.tolist() == expected
            else:
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


def test_families_have_their_sizes_and_are_computed_alone(corpus, monkeypatch):
    table = Gaus().transform(corpus)
    for family, size in SIZES.items():
        alone = Gaus((family,)).transform(corpus)
        assert alone.shape[1] == size and alone.equals(table.filter(regex=f"^{family}_"))
    names = {"sd_high_mean", "bmh_r1c1", "msd_r8c8_median", "smmhh_8x8_r1c1_run1", "smmhh_1x1_r1c1_run5"}
    assert names | {"lbptop_xy_00", "lbptop_yt_58"} <= set(table.columns)
    monkeypatch.setattr("bench.features.gaus._pyramid", lambda *_: pytest.fail("computed without need"))
    some = Gaus(("lbptop", "sd")).transform(corpus)
    assert some.equals(table[[name for name in table if name.startswith(("sd_", "lbptop_"))]])
    assert some.equals(Gaus(["sd", "lbptop"]).transform(corpus))
