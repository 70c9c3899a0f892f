"""The 273 features against loops over their definitions, and what is learnt from training captures."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.features.jung54 import Jung54
from bench.features.ta273 import Ta273
from bench.features.wingerden45 import Wingerden45
from tests.features.captures import GRIDS, LEVELS, corpus_of, near, ragged


def naive(frames, rate, full_scale, levels):
    """The features of one capture, written from their definitions."""
    T, R, C = frames.shape
    P = frames.astype(float)
    m = [float(P[t].mean()) for t in range(T)]
    middle = sum(m) / T
    out = [T, P.mean(), P.max(), np.median(P), P.std(), np.mean(np.abs(P[1:] - P[:-1])) if T > 1 else 0]
    out += [sum(m[t - 1] < m[t] > m[t + 1] for t in range(1, T - 1))]
    s = [int(frames[t].sum(dtype=int)) for t in range(T)]
    out += [sum((s[t] * T > sum(s)) != (s[t - 1] * T > sum(s)) for t in range(1, T))]
    out += list(np.histogram(P, bins=16, range=(0, full_scale))[0] / P.size)
    out += [sum((m[t] > level) != (m[t - 1] > level) for t in range(1, T)) * rate / T for level in levels]
    taxels = [P[:, r, c] for r in range(R) for c in range(C)]
    out += [x.mean() for x in taxels] + [x.std() for x in taxels]
    out += [np.mean(x > x.min() + 0.1 * full_scale) for x in taxels]
    x = np.interp(np.linspace(0, T - 1, 128), np.arange(T), m)
    n = np.arange(128)
    out += [abs(sum(x * np.exp(-2j * np.pi * k * n / 128))) / 128 for k in range(1, 21)]
    scale = [np.sqrt(1 / 128)] + [np.sqrt(2 / 128)] * 19
    out += [scale[k] * sum(x * np.cos(np.pi * k * (2 * n + 1) / 256)) for k in range(20)]
    best, where = 0, 0
    for k in range(1, T // 2 + 1):
        wave = abs(sum((m[t] - middle) * np.exp(-2j * np.pi * k * t / T) for t in range(T)))
        if wave > best * (1 + 1e-9):
            best, where = wave, k
    return out + [where * rate / T if np.ptp(m) > 1e-9 else 0]


@given(
    st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]), st.sampled_from(["training", "fixed"])
)
def test_features_equal_a_loop_over_the_definitions(seed, grid, scale, where):
    low, high, full_scale = LEVELS[scale]
    corpus = corpus_of(ragged(seed, grid, low, high), full_scale=full_scale)
    table = Ta273(where).fit(corpus[:2]).transform(corpus)
    seen = np.concatenate([corpus[i].mean(axis=(1, 2)) for i in range(2)])
    levels = np.linspace(np.quantile(seen, 0.01), np.quantile(seen, 0.99), 16)
    if where == "fixed":
        levels = full_scale * np.arange(1, 17) / 17
    assert table.shape == (3, 8 + 16 + 16 + 3 * grid[0] * grid[1] + 41)
    for i, frames in enumerate(corpus):
        near(table.iloc[i], naive(frames, 100.0, full_scale, levels), atol=1e-6)


@given(st.integers(0, 10_000), st.sampled_from(GRIDS))
def test_wingerden_is_2014_with_features_29_to_43_of_2017_and_two_more(seed, grid):
    corpus = corpus_of(ragged(seed, grid, 0, 1023))
    table, later = Wingerden45().transform(corpus), Jung54().transform(corpus)
    shared = [c for c in later if 29 <= int(c[1:3]) <= 43 or c.startswith(("f01", "f12", "f20", "f28"))]
    np.testing.assert_allclose(table[shared], later[shared])
    for i, frames in enumerate(corpus):
        P, T = frames.astype(float), len(frames)
        change = [np.abs(P[t] - P[t - 1]).mean() for t in range(1, T)]
        peaks = [0] * T
        for t, r, c in np.ndindex(P.shape):
            around = np.pad(P[t], 1)[r : r + 3, c : c + 3].ravel()
            peak = P[t, r, c] > 0.75 * P.max() and (P[t, r, c] > around[:4]).all()
            peaks[t] += peak and (P[t, r, c] >= around[5:]).all()
        near(table["f44_change_variance"][i], np.var(change) if change else 0)
        near(table["f45_spatial_peaks_change"][i], np.mean(np.abs(np.diff(peaks))) if T > 1 else 0)
