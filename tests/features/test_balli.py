"""Signals, statistics and selection against loops written from the definitions, on captures of any length and grid."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.linalg import solve_toeplitz
from scipy.ndimage import label as components
from scipy.spatial import ConvexHull
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from bench.corpora.corpus import Corpus
from bench.corpora.folder import open_folder, write_folder
from bench.errors import InputError
from features import signals as shared
from features.balli import NAMES, SIGNALS, STATISTICS, Balli, signals
from features.signals import Touch

GRIDS = [(8, 8), (3, 5), (5, 3), (1, 4), (4, 1), (1, 1)]
LEVELS = {"10 bit": (0, 1023), "few levels": (0, 3), "saturated": (1022, 1023), "16 bit": (0, 65535)}


def naive_signals(frame):
    """The 16 signals of one frame."""
    R, C = frame.shape
    P = frame.astype(float)
    total = P.sum()
    cr, cc = (R + 1) / 2, (C + 1) / 2
    if total > 0:
        cr = sum((r + 1) * P[r, c] for r in range(R) for c in range(C)) / total
        cc = sum((c + 1) * P[r, c] for r in range(R) for c in range(C)) / total
    top = max((r, c) for r in range(R) for c in range(C) if P[r, c] == P.max())
    top = min((r, c) for r in range(R) for c in range(C) if P[r, c] == P[top])
    polar = sum(P[r, c] * ((r + 1 - cr) ** 2 + (c + 1 - cc) ** 2) for r in range(R) for c in range(C))
    out = [P.mean(), cr, cc, P.max(), top[0] + 1, top[1] + 1, polar]
    region = P > P.max() / 2
    if not region.any():
        return [*out, *[0] * 9]
    places = np.argwhere(region)
    area = len(places)
    hull = ConvexHull(np.concatenate([places + [dr, dc] for dr in (0, 1) for dc in (0, 1)])).volume
    values, vectors = np.linalg.eigh(np.cov(places.T, bias=True) + np.eye(2) / 12)
    angle = longer = 0.0
    if values[1] - values[0] > 1e-9:
        longer = np.sqrt(1 - values[0] / values[1])
        angle = np.arctan2(vectors[1, 1], vectors[0, 1])
        angle = round((angle + np.pi / 2 - 1e-9) % np.pi - np.pi / 2 + 1e-9, 12)  # 1e-16 is not constant beside 0
    parts = components(region, np.ones((3, 3)))[1]
    holes = components(np.pad(~region, 1, constant_values=True))[1] - 1
    shape = [4 * np.sqrt(values[1]), 4 * np.sqrt(values[0]), longer, angle]
    return [*out, area, hull, *shape, np.sqrt(4 * area / np.pi), parts - holes, area / hull]


def naive_statistics(x):
    """The 13 statistics of one signal."""
    x = np.asarray(x, dtype=float)
    T, largest = len(x), np.abs(x).max()
    out = [np.mean(x), np.median(x), np.var(x), x.min(), x.max(), np.mean(x * x)]

    def flat(part):
        return np.std(part) <= 1e-9 * largest

    points, n = [], 8
    while n <= T:
        ratios = []
        for i in range(0, T - n + 1, n):
            chunk = x[i : i + n]
            if not flat(chunk):
                walk = [sum(chunk[: k + 1] - chunk.mean()) for k in range(n)]
                ratios.append((max(walk) - min(walk)) / chunk.std())
        if ratios:
            points.append((np.log(n), np.log(np.mean(ratios))))
        n *= 2
    out.append(np.polyfit(*np.array(points).T, 1)[0] if len(points) > 1 else 0.5)
    d = np.diff(x)
    dd = np.diff(d)
    mobility = np.sqrt(d.var() / x.var()) if len(d) and not flat(x) and not flat(d) else 0
    ratio = np.sqrt(dd.var() / d.var()) if len(dd) and mobility and not flat(dd) else 0
    out += [mobility, ratio / mobility if mobility else 0]
    if flat(x):
        return [*out, 0, 0, 0, 0]
    y = x - x.mean()
    r = np.array([sum(y[t] * y[t + k] for t in range(T - k)) / T for k in range(5)])
    return [*out, *solve_toeplitz(r[:4] + [1e-9 * r[0], 0, 0, 0], r[1:])]


def corpus_of(arrays, full_scale=1023.0):
    about = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, about, 100.0, full_scale=full_scale)


def ragged(seed, grid, low, high, captures=3, longest=40):
    rng = np.random.default_rng(seed)
    arrays = [rng.integers(low, high + 1, (rng.integers(1, longest + 1), *grid)) for _ in range(captures)]
    sparse = [a * (rng.random(a.shape) < rng.random((len(a), 1, 1)) * 1.3) for a in arrays]  # some frames are untouched
    return [a.astype(np.uint16) for a in sparse]


def of_signal(*values):
    """Statistics of a signal: the mean pressure on a grid of one taxel."""
    row = Balli(0).extract(corpus_of([np.array(values, np.float32)[:, None, None]])).iloc[0]
    return row.filter(like="mean_pressure_").rename(lambda name: name.removeprefix("mean_pressure_"))


def of_frame(*rows):
    """Signals of one frame."""
    row = Balli(0).extract(corpus_of([np.array(rows, np.uint16)[None]])).iloc[0]
    return row.filter(regex="_mean$").rename(lambda name: name.removesuffix("_mean"))


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]), st.booleans())
def test_signals_equal_a_loop_over_the_frames(seed, grid, levels, real):
    arrays = ragged(seed, grid, *LEVELS[levels], longest=8)
    if real:
        arrays = [(a / 700).astype(np.float32) for a in arrays]
    found = np.column_stack(signals(Touch(corpus_of(arrays, 65535.0))))
    expected = [naive_signals(frame) for a in arrays for frame in a]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert found.shape[1] == len(SIGNALS)


@given(st.integers(0, 10_000), st.sampled_from(["noise", "walk", "steps", "wave", "jumps"]))
def test_statistics_equal_a_loop_over_the_signal(seed, kind):
    rng = np.random.default_rng(seed)
    arrays = []
    for length in rng.integers(1, 150, 6):
        x = rng.integers(0, 1000, length)
        if kind == "walk":
            x = 5000 + np.cumsum(rng.integers(-9, 10, length))
        elif kind == "steps":
            x = np.repeat(rng.integers(0, 9, 10), 15)[:length]
        elif kind == "wave":
            x = 500 + np.round(300 * np.sin(np.arange(length) / 3))
        elif kind == "jumps":
            x = 100 * (rng.random(length) < 0.05)
        arrays.append(np.asarray(x, np.uint16)[:, None, None])
    table = Balli(0).extract(corpus_of(arrays)).filter(like="mean_pressure_")
    expected = [naive_statistics(a.ravel()) for a in arrays]
    np.testing.assert_allclose(table, expected, rtol=1e-6, atol=1e-9)
    assert table.shape[1] == len(STATISTICS)


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]))
def test_the_table_is_every_statistic_of_every_signal(seed, grid, levels):
    arrays = ragged(seed, grid, *LEVELS[levels])
    table = Balli(0).transform(corpus_of(arrays, 65535.0))
    for i, frames in enumerate(arrays):
        traces = np.array([naive_signals(frame) for frame in frames]).T
        for name, trace in zip(SIGNALS, traces, strict=True):
            found = [table.loc[i, f"{name}_{statistic}"] for statistic in STATISTICS]
            np.testing.assert_allclose(found, naive_statistics(trace), rtol=1e-5, atol=1e-6, err_msg=name)


def test_shapes_by_hand():
    ell = of_frame([0, 90, 50], [0, 100, 90], [0, 0, 0])  # 50 is not above half
    assert (ell["area"], ell["convex_area"], ell["euler_number"]) == (3, 3.5, 1)
    assert ell["solidity"] == pytest.approx(3 / 3.5)
    assert ell["equivalent_diameter"] == pytest.approx(np.sqrt(12 / np.pi))
    assert ell["orientation"] == pytest.approx(np.pi / 4)  # of an L the two ends lie across the corner
    assert (ell["max_row"], ell["max_column"], ell["max_pressure"]) == (2, 2, 100)
    ring = of_frame([9, 9, 9], [9, 0, 9], [9, 9, 9])
    assert (ring["euler_number"], ring["area"], ring["convex_area"]) == (0, 8, 9)
    assert (ring["orientation"], ring["eccentricity"]) == (0, 0) and ring["major_axis"] == ring["minor_axis"]
    assert (ring["max_row"], ring["max_column"], ring["polar_moment"]) == (1, 1, 9 * (4 * 1 + 4 * 2))
    corners = of_frame([9, 0], [0, 9])
    assert (corners["euler_number"], corners["convex_area"], corners["solidity"]) == (1, 3, pytest.approx(2 / 3))
    assert corners["orientation"] == pytest.approx(np.pi / 4)
    assert of_frame([0, 9], [9, 0])["orientation"] == pytest.approx(-np.pi / 4)
    apart = of_frame([9, 0, 9], [0, 0, 0])
    assert (apart["euler_number"], apart["convex_area"]) == (2, 3)
    level, upright = of_frame([7, 7, 7], [0, 0, 0]), of_frame([7, 0], [7, 0], [7, 0])
    for bar in (level, upright):
        assert bar["major_axis"] == pytest.approx(4 * np.sqrt(0.75))
        assert bar["minor_axis"] == pytest.approx(4 * np.sqrt(1 / 12))
        assert bar["eccentricity"] == pytest.approx(np.sqrt(8 / 9)) and bar["solidity"] == 1
    assert (level["orientation"], upright["orientation"]) == (pytest.approx(np.pi / 2), 0)
    untouched = of_frame([0, 0], [0, 0], [0, 0])
    assert (untouched[list(SIGNALS[7:])] == 0).all()
    assert untouched[list(SIGNALS[:7])].tolist() == [0, 2, 1.5, 0, 1, 1, 0]


def test_statistics_by_hand():
    saw = of_signal(0, 1, 0, 1)
    assert (saw["mean"], saw["median"], saw["variance"], saw["energy"]) == (0.5, 0.5, 0.25, 0.5)
    assert saw["mobility"] == pytest.approx(np.sqrt(8 / 9 / 0.25))  # of the differences 1, -1, 1
    assert saw["complexity"] == pytest.approx(np.sqrt(4 / (8 / 9)) / saw["mobility"])
    two = of_signal(0, 1)  # autocorrelation 1, -1/2, 0, 0, 0
    system = [[1, -0.5, 0, 0], [-0.5, 1, -0.5, 0], [0, -0.5, 1, -0.5], [0, 0, -0.5, 1]]
    expected = np.linalg.solve(system, [-0.5, 0, 0, 0])
    assert two[["ar1", "ar2", "ar3", "ar4"]].to_numpy(float) == pytest.approx(expected, rel=1e-6)
    block = [0, 0, 0, 0, 1, 1, 1, 1]  # range 2, deviation 1/2, at each length
    assert of_signal(*block, *block)["hurst"] == pytest.approx(0)
    assert of_signal(*[0] * 8, *[1] * 8)["hurst"] == 0.5  # the chunks of 8 frames are constant
    assert of_signal(*block, 0, 0, 0, 0, 0, 0, 0)["hurst"] == 0.5  # not 16 frames
    growing = of_signal(*block, *[2 * v for v in block])["hurst"]  # 4 and 4, then range 5, variance 11/16
    assert growing == pytest.approx(np.log2(5 / np.sqrt(11 / 16) / 4))
    ramp = of_signal(*range(20))
    assert ramp["mobility"] == ramp["complexity"] == 0


def test_a_known_process_is_found():
    rng = np.random.default_rng(0)
    x = np.zeros(20_000)
    for t in range(2, len(x)):
        x[t] = 1.2 * x[t - 1] - 0.6 * x[t - 2] + rng.normal()
    assert of_signal(*x)[["ar1", "ar2", "ar3", "ar4"]].to_numpy(float) == pytest.approx([1.2, -0.6, 0, 0], abs=0.03)
    assert of_signal(*rng.normal(size=20_000))["hurst"] == pytest.approx(0.55, abs=0.05)
    assert of_signal(*np.cumsum(rng.normal(size=20_000)))["hurst"] == pytest.approx(1, abs=0.08)


def test_names_and_count(corpus):
    table = Balli(0).transform(corpus)
    assert table.shape == (36, 208) and table.columns.is_unique
    assert {"mean_pressure_median", "convex_area_hurst", "centroid_row_ar1", "solidity_complexity"} <= set(table)


@pytest.mark.parametrize("grid", [(8, 8), (1, 4), (1, 1)])
@pytest.mark.parametrize("frames", [1, 2, 3, 50])
@pytest.mark.parametrize("value", [0, 7, 1023, 65535])
@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_constant_captures_are_finite(frames, value, grid, kind):
    row = Balli(0).transform(corpus_of([np.full((frames, *grid), value, kind)], max(value, 1023.0))).iloc[0]
    assert np.isfinite(row).all()
    assert row.filter(regex="_(ar.|mobility|complexity)$").abs().sum() == 0
    assert (row.filter(regex="_hurst$") == 0.5).all() and row["mean_pressure_mean"] == value
    assert row["area_mean"] == (value > 0) * grid[0] * grid[1] and row["solidity_mean"] == (value > 0)


@given(st.integers(0, 1000), st.sampled_from(GRIDS), st.sampled_from([1e-30, 0.1, 1e6]))
def test_pressure_that_only_scales_leaves_the_shape_constant(seed, grid, scale):
    rng = np.random.default_rng(seed)  # the centre of mass then moves by rounding alone
    frames = rng.random(grid) * rng.random((40, 1, 1)) * scale
    row = Balli(0).transform(corpus_of([frames.astype(np.float32).astype(np.float64)], scale)).iloc[0]
    assert np.isfinite(row).all()
    frames = np.full((40, *grid), 1 / 3) * rng.random((40, 1, 1)) * scale
    row = Balli(0).transform(corpus_of([frames], scale)).iloc[0]
    assert (row.filter(regex="(centroid|area|axis).*(ar.|mobility|complexity)$") == 0).all()
    assert (row.filter(regex="(centroid|area|axis).*hurst$") == 0.5).all()


def test_a_slice_has_the_rows_of_the_whole(corpus, monkeypatch):
    whole = Balli(0).transform(corpus)
    chosen = np.array([7, 3, 20, 3])
    assert Balli(0).transform(corpus[chosen]).equals(whole.iloc[chosen].reset_index(drop=True))
    assert Balli(0).transform(corpus[np.array([], dtype=int)]).equals(whole.iloc[:0])
    monkeypatch.setattr(shared, "blocks", lambda c, blocks=shared.blocks: blocks(c, values=50 * 64))
    assert len(shared.blocks(corpus)) > 5
    assert Balli(0).transform(corpus).equals(whole)


@given(st.integers(0, 1000), st.sampled_from([*GRIDS, (5, 7)]))
@example(391, (8, 8))  # the area of a convex hull in a capture of one frame
def test_rounding_does_not_depend_on_the_other_captures(seed, grid):
    rng = np.random.default_rng(seed)  # values so different in size that their sums are rounded
    arrays = [(rng.random((rng.integers(1, 40), *grid)) ** 30).astype(np.float32) for _ in range(20)]
    corpus = corpus_of(arrays, full_scale=1.0)
    whole = Balli(0).transform(corpus)
    for i in range(len(corpus)):
        assert Balli(0).transform(corpus[i : i + 1]).equals(whole.iloc[i : i + 1].reset_index(drop=True))


def test_only_training_captures_are_looked_at():
    rng = np.random.default_rng(0)
    about = pd.DataFrame({"subject": np.repeat([*"12345"], 12), "gesture": ["pat", "rub", "tap"] * 20})
    arrays = [rng.integers(0, 500 + 30 * (i % 3), (30, 3, 4)).astype(np.uint16) for i in range(60)]
    corpus = Corpus.from_captures(arrays, about, 100.0)
    other = [a if i < 48 else a[: 10 + i % 3] // (1 + i % 3) for i, a in enumerate(arrays)]
    changed = Corpus.from_captures(other, about, 100.0)
    kept = Balli(10).fit(corpus[:48], corpus.gestures[:48]).names_
    assert kept.equals(Balli(10).fit(corpus[:48]).names_)  # labels are the gestures
    assert kept.equals(Balli(10).fit(changed[:48], changed.gestures[:48]).names_)
    assert not kept.equals(Balli(10).fit(changed, changed.gestures).names_)


def test_kept_columns_keep_their_order_and_values(corpus):
    whole = Balli(0).transform(corpus)
    features = Balli(12).fit(corpus, corpus.gestures)
    kept = features.transform(corpus)
    assert kept.shape == (36, 12) and list(features.get_feature_names_out()) == list(kept.columns)
    assert kept.equals(whole[[name for name in NAMES if name in set(features.names_)]])
    again = clone(features).set_output(transform="pandas").fit_transform(corpus, corpus.gestures)
    assert again.equals(kept) and clone(features).get_params() == {"selected": 12}
    assert features.transform(corpus[5:7]).equals(kept.iloc[5:7].reset_index(drop=True))


def test_what_cannot_be_learnt_from_keeps_all_columns(corpus):
    for few in (corpus[:1], corpus[corpus.gestures == "pat"], corpus[corpus.subjects == "1"][::3]):
        assert Balli().fit_transform(few).shape == (len(few), 208)
    still = corpus_of([np.full((9, 4, 4), 5, np.uint16)] * 12)
    assert Balli().fit(still, ["a", "b"] * 6).transform(still).shape == (12, 208)
    assert Balli(300).fit(corpus, corpus.gestures).transform(corpus).shape[1] <= 208


def test_one_table_is_stored_for_every_number_of_columns(corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    expected = Balli(4).fit_transform(corpus, corpus.gestures)
    assert Balli(4).fit_transform(stored, corpus.gestures).equals(expected)
    monkeypatch.setattr(Balli, "extract", lambda *_: pytest.fail("computed again"))
    assert Balli(4).fit_transform(stored, corpus.gestures).equals(expected)
    assert Balli(2).fit_transform(stored, corpus.gestures).shape == (36, 2)
    assert Balli(0).fit_transform(stored[3:5]).shape == (2, 208)
    assert len(list((tmp_path / "home" / "features").iterdir())) == 1


def test_parameters(corpus):
    assert Balli.learns and Balli().selected == 42
    Balli().check(), Balli(0).check(), Balli(1).check()
    for wrong in (-1, -9):
        for use in (Balli.check, lambda features: features.fit(corpus), lambda features: features.transform(corpus)):
            with pytest.raises(InputError, match=f"features.selected={wrong}: give"):
                use(Balli(wrong))
    for use in (Balli(3).get_feature_names_out, lambda: Balli(3).transform(corpus)):
        with pytest.raises(NotFittedError):
            use()
    assert list(Balli(0).fit(corpus).get_feature_names_out()) == list(NAMES)
