"""Every family against loops over the definitions, on captures of any length and grid."""

from fractions import Fraction
from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from sklearn.base import clone

from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.errors import InputError
from features import signals
from features.cache import cache_key
from features.gaus import FAMILIES, Gaus
from tests.conftest import random_corpus

RATE = 80.0


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
    for course in frames.reshape(len(frames), -1).T.astype(np.float64):
        q1, q3 = np.percentile(course, 25), np.percentile(course, 75)
        out += [course.mean(), np.median(course), course.min(), course.max(), course.sum() / RATE, q1, q3, q3 - q1]
        if len(set(course)) > 1:
            standard = (course - course.mean()) / course.std()
            out += [course.std() ** 2, (standard**3).mean(), (standard**4).mean() - 3]
        else:
            out += [0, 0, 0]
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
    low = int(position)
    high = min(low + 1, len(steps) - 1)
    percentile = ordered[low] + (position - low) * (ordered[high] - ordered[low])
    bits = "".join("1" if step > percentile else "0" for step in steps)
    runs = [len(run) for run in bits.split("0")]
    return [runs.count(k) for k in range(1, 6)]


def changes(pattern):
    bits = f"{pattern:08b}"
    return sum(bits[i] != bits[i - 1] for i in range(8))


UNIFORM = [pattern for pattern in range(256) if changes(pattern) <= 2]


def naive_lbptop(frames, full_scale):
    values = frames.tolist()
    sides = dict(zip("tyx", frames.shape, strict=True))
    out = []
    for first, second in ("yx", "tx", "ty"):
        counts = [0] * 59
        (third,) = set("tyx") - {first, second}
        for a, b, d in product(range(1, sides[first] - 1), range(1, sides[second] - 1), range(sides[third])):

            def value(i, j, d=d, axes=(first, second, third)):
                place = dict(zip(axes, (i, j, d), strict=True))
                return values[place["t"]][place["y"]][place["x"]]

            ring = [(a - 1, b - 1), (a - 1, b), (a - 1, b + 1), (a, b + 1)]
            ring += [(a + 1, b + 1), (a + 1, b), (a + 1, b - 1), (a, b - 1)]
            pattern = sum(2**k for k, (i, j) in enumerate(ring) if value(i, j) >= value(a, b))
            counts[UNIFORM.index(pattern) if pattern in UNIFORM else 58] += 1
        out += [count / max(sum(counts), 1) for count in counts]
    return out


NAIVE = {"sd": naive_sd, "bmh": naive_bmh, "msd": naive_msd, "smmhh": naive_smmhh, "lbptop": naive_lbptop}
SIZES = {"sd": 12, "bmh": 64, "msd": 704, "smmhh": 425, "lbptop": 177}
GRIDS = [(8, 8), (3, 5), (5, 1), (1, 4), (1, 1)]
LEVELS = {  # lowest and highest value, full scale
    "10 bit": (0, 1023, 1023.0),
    "few levels": (0, 3, 60.0),  # 5 % are 3
    "some touch": (40, 120, 1020.0),  # 5 % are 51
    "saturated": (1022, 1023, 1023.0),
    "16 bit": (0, 65535, 65535.0),
}


def corpus_of(arrays, full_scale=1023.0):
    about = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, about, RATE, full_scale=full_scale)


def ragged(seed, grid, low, high, captures=3, longest=20):
    rng = np.random.default_rng(seed)
    arrays = [rng.integers(low, high + 1, (rng.integers(1, longest + 1), *grid)) for _ in range(captures)]
    touched = [rng.random(len(a)) < 0.8 for a in arrays]  # in other frames nobody touches the sensor
    return [(a * t[:, None, None]).astype(np.uint16) for a, t in zip(arrays, touched, strict=True)]


def assert_equals_the_loops(corpus):
    table = Gaus().transform(corpus)
    for i, frames in enumerate(corpus):
        for family in FAMILIES:
            found = table.iloc[i].filter(regex=f"^{family}_")
            expected = NAIVE[family](frames, corpus.full_scale)
            assert len(found) == len(expected)
            if family in ("bmh", "smmhh"):
                assert found.tolist() == expected
            else:
                np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9, err_msg=family)


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]))
def test_features_equal_loops_over_the_definitions(seed, grid, levels):
    low, high, full_scale = LEVELS[levels]
    assert_equals_the_loops(corpus_of(ragged(seed, grid, low, high), full_scale))


@given(st.integers(0, 1000), st.sampled_from(GRIDS), st.sampled_from([1.0, 0.75, 3.3]))
def test_float_captures(seed, grid, full_scale):
    # multiples of 1/1024, so that no loop and no feature rounds a sum and equal steps are equal
    low = int(900 * full_scale)
    arrays = [(a / 1024).astype(np.float32) for a in ragged(seed, grid, low, int(1024 * full_scale))]
    assert_equals_the_loops(corpus_of(arrays, full_scale))


@pytest.mark.parametrize("levels", [*LEVELS])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5, 6])
def test_short_captures(frames, levels):
    low, high, full_scale = LEVELS[levels]
    rng = np.random.default_rng(frames)
    arrays = [rng.integers(low, high + 1, (frames, 4, 3)).astype(np.uint16) for _ in range(4)]
    assert_equals_the_loops(corpus_of(arrays, full_scale))


def test_ranges_by_hand():
    frames = np.zeros((2, 1, 4), np.uint16)
    frames[:, 0, 0] = 7, 58  # more than 51 above the minimum
    frames[:, 0, 1] = 7, 59
    frames[:, 0, 2] = 200, 100  # 100 is not above half
    frames[:, 0, 3] = 150, 150  # never above its minimum
    row = Gaus(("sd", "bmh")).transform(corpus_of([frames], full_scale=1020.0)).iloc[0]
    assert row.filter(like="bmh").tolist() == [0, 0, 1, 1]
    assert (row["sd_none_mean"], row["sd_none_sd"], row["sd_none_max"]) == (0.5, 0, 0.5)
    assert (row["sd_touch_mean"], row["sd_touch_sd"], row["sd_touch_max"]) == (0.125, 0.125, 0.25)
    assert (row["sd_high_mean"], row["sd_high_sd"], row["sd_high_max"]) == (0.375, 0.125, 0.5)
    assert (row["sd_none_taxels"], row["sd_touch_taxels"], row["sd_high_taxels"]) == (0.25, 0.25, 0.5)


def test_statistics_of_one_taxel():
    course = np.array([3, 900, 14, 15, 92, 65, 35], np.uint16)
    row = Gaus(("msd",)).transform(corpus_of([course[:, None, None]])).iloc[0]
    expected = {
        "mean": 1124 / 7,
        "median": 35,
        "min": 3,
        "max": 900,
        "area": 1124 / 80,
        "q1": 14.5,
        "q3": 78.5,
        "iqr": 64,
        "variance": course.astype(float).var(),
        "skewness": stats.skew(course.astype(float)),
        "kurtosis": stats.kurtosis(course.astype(float)),
    }
    assert list(row.index) == [f"msd_r1c1_{name}" for name in expected]
    np.testing.assert_allclose(row, [*expected.values()], rtol=1e-12)


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


def test_equal_steps_are_none_above_their_percentile():
    steady = np.arange(0, 900, 30, dtype=np.uint16)[:, None, None]
    back = steady[::-1]  # a step down that wrapped round would be large
    assert (Gaus(("smmhh",)).transform(corpus_of([steady, back])).to_numpy() == 0).all()
    swerve = np.concatenate([steady, back[10:]])
    assert Gaus(("smmhh",)).transform(corpus_of([swerve])).iloc[0].tolist() == [1, 0, 0, 0, 0]  # 870 to 570


def test_a_cell_of_the_pyramid_is_the_average_of_its_taxels():
    course = course_of("00100000000").ravel()
    frames = np.full((len(course), 3, 5), 10, np.uint16)
    frames[:, 0, 0] += course
    frames[:, 1, 1] -= course  # the other way, in the same cell of 2 x 2
    frames[:, 2, 4] += course  # a cell of its own
    row = Gaus(("smmhh",)).transform(corpus_of([frames])).iloc[0]
    assert len(row) == 5 * (3 * 5 + 2 * 3 + 1 * 2 + 1)
    moving = ["3x5_r1c1", "3x5_r2c2", "3x5_r3c5", "2x3_r2c3", "1x2_r1c2", "1x1_r1c1"]
    assert list(row.index[row > 0]) == [f"smmhh_{cell}_run1" for cell in moving]


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


def test_patterns_in_time_by_hand():
    frame = np.array([[9, 7, 1], [1, 5, 1], [1, 1, 1]], np.uint16)  # rows are time
    for side, shape in (("xt", (3, 1, 3)), ("yt", (3, 3, 1))):
        table = Gaus(("lbptop",)).transform(corpus_of([frame.reshape(shape), frame[:2].reshape(2, *shape[1:])]))
        assert table.loc[0, f"lbptop_{side}_03"] == 1 and table.loc[0].sum() == 1
        assert table.loc[1].sum() == 0


def test_counts_on_8_by_8():
    corpus = generate(subjects=1)
    table = Gaus().transform(corpus)
    assert table.shape == (len(corpus), 1382) and table.columns.is_unique
    for family, size in SIZES.items():
        alone = Gaus((family,)).transform(corpus)
        assert alone.shape[1] == size and alone.equals(table.filter(regex=f"^{family}_"))
    named = {"sd_high_mean", "bmh_r1c1", "msd_r8c8_median", "smmhh_8x8_r1c1_run1", "smmhh_1x1_r1c1_run5"}
    assert named | {"lbptop_xy_00", "lbptop_yt_58"} <= set(table.columns)
    np.testing.assert_allclose(table.filter(regex="^sd_.*_mean$").sum(axis=1), 1)
    np.testing.assert_allclose(table.filter(regex="^sd_.*_taxels$").sum(axis=1), 1)
    np.testing.assert_allclose(table.filter(regex="^lbptop_xy").sum(axis=1), 1)


def test_only_what_is_asked_for_is_computed_in_an_order_of_its_own(corpus, monkeypatch):
    whole = Gaus().transform(corpus)
    monkeypatch.setattr("features.gaus._pyramid", lambda *_: pytest.fail("nobody asked for it"))
    some = Gaus(("lbptop", "sd")).transform(corpus)
    assert list(some.columns) == [name for name in whole.columns if name.startswith(("sd_", "lbptop_"))]
    assert some.equals(whole[some.columns]) and some.equals(Gaus(["sd", "lbptop"]).transform(corpus))


@pytest.mark.parametrize("grid", [(8, 8), (3, 5), (1, 4), (1, 1)])
@pytest.mark.parametrize("frames", [1, 2, 3, 50])
@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_constant_captures_are_finite(frames, grid, kind):
    values = [0, 7, 1023, 65535] if kind == np.uint16 else [0, 0.1, 1023, 1e-30]
    for value in values:
        one = corpus_of([np.full((frames, *grid), value, kind)], full_scale=max(value, 1023.0))
        row = Gaus().transform(one).iloc[0]
        assert np.isfinite(row).all()
        assert (row.filter(like="bmh") == (value > 0)).all() and row["sd_high_mean"] == (value > 0)
        assert row.filter(regex="smmhh|variance|skewness|kurtosis|iqr|_sd$|sd_touch").abs().sum() == 0
        assert row["msd_r1c1_mean"] == pytest.approx(value)
        planes = [min(grid) >= 3, min(frames, grid[1]) >= 3, min(frames, grid[0]) >= 3]
        assert row.filter(regex="lbptop_.._57").tolist() == planes
        assert row.filter(regex="lbptop").sum() == sum(planes)


@pytest.mark.parametrize("frames", [1, 2, 3, 50])
def test_saturated_captures_are_finite(frames):
    values = np.full((frames, 8, 8), 65535, np.uint16)
    values[-1, :4] = 0
    values[0, 7, 7] -= 1
    corpus = corpus_of([values, values // 2**15, values[::-1].copy()], full_scale=65535.0)
    assert np.isfinite(Gaus().transform(corpus)).all(axis=None)
    assert_equals_the_loops(corpus)


def test_a_slice_has_the_rows_of_the_whole(corpus, monkeypatch):
    whole = Gaus().transform(corpus)
    chosen = np.array([7, 3, 20, 3])
    assert Gaus().transform(corpus[chosen]).equals(whole.iloc[chosen].reset_index(drop=True))
    assert Gaus().transform(corpus[np.array([], dtype=int)]).equals(whole.iloc[:0])
    monkeypatch.setattr(signals, "blocks", lambda c, blocks=signals.blocks: blocks(c, values=50 * 64))
    assert len(signals.blocks(corpus)) > 5
    assert Gaus().transform(corpus).equals(whole)


@given(st.integers(0, 1000), st.sampled_from(GRIDS))
def test_rounding_does_not_depend_on_the_other_captures(seed, grid):
    rng = np.random.default_rng(seed)  # values so different in size that their sums are rounded
    arrays = [(rng.random((rng.integers(1, 25), *grid)) ** 30).astype(np.float32) for _ in range(20)]
    corpus = corpus_of(arrays, full_scale=1.0)
    whole = Gaus().transform(corpus)
    for i in range(len(corpus)):
        assert Gaus().transform(corpus[i : i + 1]).equals(whole.iloc[i : i + 1].reset_index(drop=True))


def test_names_and_clones():
    corpus = random_corpus(subjects=2, grid=(3, 4))
    features = Gaus(("bmh", "lbptop"))
    table = features.fit_transform(corpus)
    assert list(features.get_feature_names_out()) == list(table.columns)
    assert clone(features).get_params() == {"families": ("bmh", "lbptop")}
    assert cache_key(Gaus(), "a") != cache_key(features, "a")


@pytest.mark.parametrize("families", [(), ("",), ("sd", "lbp"), ("sd", "bmh", "sd"), "sd", None, (["sd"],)])
def test_families_that_cannot_be(corpus, families):
    with pytest.raises(InputError, match=r"features\.families=.*: give some of sd\+bmh\+msd\+smmhh\+lbptop"):
        Gaus(families).check()
    with pytest.raises(InputError):
        Gaus(families).transform(corpus)
    Gaus().check()
