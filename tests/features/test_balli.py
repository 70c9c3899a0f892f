"""Signals, statistics and selection against loops written from the definitions, on captures of any length and grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_toeplitz
from scipy.ndimage import label as components
from scipy.spatial import ConvexHull

from bench.features.balli import NAMES, SIGNALS, STATISTICS, Balli
from tests.features.captures import GRIDS, LEVELS, corpus_of, ragged, row_of


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
    taxels = np.argwhere(region)
    area = len(taxels)
    hull = ConvexHull(np.concatenate([taxels + [dr, dc] for dr in (0, 1) for dc in (0, 1)])).volume
    values, vectors = np.linalg.eigh(np.cov(taxels.T, bias=True) + np.eye(2) / 12)
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


def of_signal(*values):
    """Statistics of a signal: the mean pressure on a grid of one taxel."""
    row = row_of(Balli(0), np.array(values, np.float32)[:, None, None])
    return row.filter(like="mean_pressure_").rename(lambda name: name.removeprefix("mean_pressure_"))


@given(st.integers(0, 10_000), st.sampled_from([*GRIDS, (5, 3)]), st.sampled_from([*LEVELS]), st.booleans())
def test_the_table_is_every_statistic_of_every_signal(seed, grid, levels, real):
    low, high, full_scale = LEVELS[levels]
    arrays = ragged(seed, grid, low, high, lengths=[1, 7, 20])
    arrays = [(a / 700).astype(np.float32) for a in arrays] if real else arrays
    table = Balli(0).transform(corpus_of(arrays, full_scale=full_scale))
    for i, frames in enumerate(arrays):
        traces = np.array([naive_signals(frame) for frame in frames]).T
        for name, trace in zip(SIGNALS, traces, strict=True):
            columns = [f"{name}_{statistic}" for statistic in STATISTICS]
            np.testing.assert_allclose(table.loc[i, columns], naive_statistics(trace), 1e-5, 1e-6, err_msg=name)


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


def test_kept_columns_keep_their_order_and_values(corpus):
    every = Balli(0).transform(corpus)
    features = Balli(12).fit(corpus, corpus.gestures)
    assert features.transform(corpus).equals(every[[name for name in NAMES if name in set(features.names_)]])
    for few in (corpus[:1], corpus[corpus.gestures == "pat"], corpus[corpus.subjects == "1"][::3]):
        assert Balli().fit_transform(few).shape == (len(few), 208)  # what cannot be learnt from keeps all
    still = corpus_of([np.full((9, 4, 4), 5, np.uint16)] * 12)
    assert Balli().fit(still, ["a", "b"] * 6).transform(still).shape == (12, 208)
