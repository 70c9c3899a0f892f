"""Every feature against a loop over frames and taxels, on captures of any length, grid, rate and kind of number."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.steps import Windows
from bench.corpora.synth import generate
from bench.features import touch
from bench.features.touch import TouchFeatures
from tests.conftest import random_corpus
from tests.features.captures import corpus_of, ragged, row_of

GRIDS = [(8, 8), (1, 2), (3, 5), (1, 1), (6, 6), (4, 1), (2, 2)]
RATES = [8.0, 12.0, 54.0, 135.0]
STEPWISE = "change rise relative_change net_change one_way speed flow explained flow_row flow_col likeness".split()
SPECTRAL = "total change row col relative_change net_change flow_row flow_col half_area".split()
BANDS = [0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32]  # 32nds of half the rate


def one(frames, rate=54.0, full_scale=1024.0):
    return row_of(TouchFeatures(), frames, rate, full_scale)


def gradient(p, axis):
    """Half the difference of the neighbours, 0 at the edges; of two, their difference."""
    if p.shape[axis] == 1:
        return p * 0
    g = np.moveaxis(np.gradient(p, axis=axis), axis, 0)
    if len(g) > 2:
        g[0] = g[-1] = 0
    return np.moveaxis(g, 0, axis)


def naive_signals(P):
    """The 19 signals of a capture of shares, frame by frame; a first frame has the step of the second."""
    T, R, C = P.shape
    r, c = np.mgrid[:R, :C] + 0.5
    r, c = r / R, c / C
    signals = []
    for t, p in enumerate(P):
        s = p.sum()
        row, col = ((x * p).sum() / s if s else 0.5 for x in (r, c))
        down, right = r - row, c - col
        high, wide, both = ((x * p).sum() / s if s else 0 for x in (down**2, right**2, down * right))
        x = {"total": math.log(p.mean() + 1e-4), "peak": math.log(p.max() + 1e-4), "row": row, "col": col}
        x["spread"] = math.sqrt(high + wide)
        x["elongation"] = math.hypot(high - wide, 2 * both) / (high + wide) if high + wide >= 1e-6 else 0
        x["half_area"] = (p > p.max() / 2).mean()
        x["concentration"] = p.mean() ** 2 / (p**2).mean() if s else 0
        x |= dict.fromkeys(STEPWISE, 0.0)
        signals.append(x)
        if t == 0:
            continue
        q = P[t - 1]
        d, change, net, pressure = p - q, abs(p - q).sum(), s - q.sum(), s + q.sum()
        x["change"] = math.log(change / p.size + 1e-4)
        x["rise"] = math.log(d.clip(0).mean() + 1e-4)
        x["relative_change"], x["net_change"] = (change / pressure, net / pressure) if pressure else (0, 0)
        x["one_way"] = abs(net) / change if change else 0
        x["speed"] = math.log(math.hypot(row - signals[t - 1]["row"], col - signals[t - 1]["col"]) + 1e-3)
        g = np.stack([(gradient(p, axis) + gradient(q, axis)).ravel() / 2 for axis in (0, 1)], axis=1)
        shift = np.linalg.solve(g.T @ g + (1e-5 + 0.01 * (g**2).sum()) * np.eye(2), -g.T @ d.ravel())
        x["explained"] = np.clip(-(g @ shift) @ d.ravel() / (d**2).sum(), 0, 1) if change else 0
        x["flow_row"], x["flow_col"] = shift = shift.clip(-2, 2)
        x["flow"] = math.log(math.hypot(*shift) + 1e-2)
        lengths = math.sqrt((p**2).sum() * (q**2).sum())
        x["likeness"] = (p * q).sum() / lengths if lengths else 1
    for name in STEPWISE:
        signals[0][name] = signals[min(1, T - 1)][name]
    return {name: np.array([x[name] for x in signals], float) for name in signals[0]}


def naive(frames, rate, full_scale, exact):
    """All features of one capture by name, and the names of those that hang on a rounding error.

    Where shares are exact in single precision, so are steps of nothing.
    """
    P = (frames.astype(np.float32) / np.float32(full_scale)).astype(float)
    T, R, C = P.shape
    out, close = {}, set()
    x = naive_signals(P)
    for name, a in x.items():
        mean, sd, d = a.mean(), a.std(), np.diff(a)
        out |= {f"{name}_q{q}": np.percentile(a, q) for q in (5, 25, 50, 75, 95)}
        out |= {f"{name}_mean": mean, f"{name}_sd": sd}
        out[f"{name}_step"], out[f"{name}_step_sd"] = (abs(d).mean(), d.std()) if T > 1 else (0, 0)
        out[f"{name}_crossings"] = sum((a[t] > mean) != (a[t - 1] > mean) for t in range(1, T)) / max(T - 1, 1)
        out[f"{name}_turns"] = sum(d[t] * d[t - 1] < 0 for t in range(1, T - 1)) / max(T - 2, 1)
        varies = sd > 1e-9 * abs(mean) + 1e-12
        z = (a - mean) / (sd if varies else 1)
        out[f"{name}_skewness"] = (z**3).mean() if varies else 0
        out[f"{name}_kurtosis"] = min((z**4).mean(), 30) if varies else 3
        sure = exact and name != "elongation"  # of two taxels it is 1 but for rounding
        if T > 1 and any((v != 0 or not sure) and abs(v) < 1e-5 for v in [*d, *(a - mean)]):
            close |= {f"{name}_{k}" for k in ("crossings", "turns")}
        if T > 1 and sd < 1e-4 and (sd or not sure):
            close |= {f"{name}_{k}" for k in ("crossings", "turns", "skewness", "kurtosis")}
    length = min(T, max(2, round(1.2 * rate)))
    points = max(64, length)
    for name in SPECTRAL:
        if T < 2:
            out |= {f"{name}_{k}": 0 for k in ("power", "centroid", *(f"band{i}" for i in range(1, 11)))}
            continue
        w = [0.5 - 0.5 * math.cos(2 * math.pi * (i + 1) / (length + 1)) for i in range(length)]
        power, used = np.zeros(points // 2), 0
        for begin in range(0, T - length + 1, max(length // 2, 1)):
            part = x[name][begin : begin + length]
            part = np.concatenate([(part - part.mean()) * w, np.zeros(points - length)])
            power += np.abs(np.fft.fft(part)[1 : points // 2 + 1]) ** 2
            used += 1
        power /= used * sum(v * v for v in w) * points
        total = power.sum()
        for i in range(10):
            low, high = (math.floor(b / 32 * points / 2) for b in BANDS[i : i + 2])
            share = power[low:high] if i < 9 else power[low:]
            out[f"{name}_band{i + 1}"] = math.log((share.sum() + 1e-6 * total + 1e-12) / (total + 1e-12))
        out[f"{name}_power"] = math.log(total + 1e-8)
        out[f"{name}_centroid"] = sum(v * (k + 1) / points for k, v in enumerate(power)) / total if total else 0
        if total < 1e-10:
            close.add(f"{name}_centroid")
    for seconds in (0.05, 0.1, 0.15, 0.2, 0.3, 0.4):
        k = max(1, round(seconds * rate))
        for name in ("total", "row", "col"):
            y = x[name] - x[name].mean()
            same = sum(y[t] * y[t + k] for t in range(T - k)) / T if k < T and (y * y).mean() > 1e-12 else 0
            out[f"{name}_after_{round(1000 * seconds)}_ms"] = same / (y * y).mean() if same else 0
    for name in ("row", "col"):
        out[f"{name}_range"] = x[name].max() - x[name].min()
    y, z = (x[name] - x[name].mean() for name in ("row", "col"))
    out["row_col_correlation"] = (y * z).mean() / math.sqrt((y * y).mean() * (z * z).mean() + 1e-9)
    for name, of in (("mean", np.mean), ("sd", np.std), ("most", np.max)):
        values = sorted((of(P[:, r, c]) for r in range(R) for c in range(C)), reverse=True)
        for i in range(16):
            at = i * (len(values) - 1) / 15
            out[f"taxels_{name}_{i}"] = math.log(np.interp(at, range(len(values)), values) + 1e-4)
        shares = [v / max(sum(values), 1e-9) for v in values]
        of_all = -sum(v * math.log(v + 1e-9) for v in shares)
        out[f"taxels_{name}_entropy"] = of_all / math.log(len(values)) if len(values) > 1 else 0
    return out, close


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from(RATES), st.booleans())
def test_features_equal_a_loop(seed, grid, rate, real):
    arrays, full_scale = ragged(seed, grid, lengths=[1, 2, 3, 5 + seed % 20, 80]), 1024.0
    if real:
        arrays, full_scale = [a * np.float32(0.37) for a in arrays], 500.0
    table = TouchFeatures().transform(corpus_of(arrays, None, rate, full_scale))
    assert table.shape == (5, 427) and np.isfinite(table).all(axis=None)
    left_out = 0
    for i, frames in enumerate(arrays):
        expected, close = naive(frames, rate, full_scale, exact=not real)
        assert set(expected) == set(table)
        left_out += len(close)
        expected = pd.Series(expected).drop([*close])
        apart = (table.loc[i, expected.index].astype(float) - expected).abs() - 1e-4 * expected.abs()
        assert apart.max() < (6e-3 if real else 1e-4), (len(frames), apart.sort_values().tail(5))
    assert real or left_out / table.size < 0.05


def test_by_hand_on_a_fingertip_that_taps_and_moves():
    frames = np.zeros((3, 4, 4), np.uint16)
    frames[0, 1, 1], frames[1, 1, 2], frames[2, 1, 2] = 512, 512, 256
    row = one(frames)
    assert row["row_mean"] == 1.5 / 4 and row["col_range"] == 0.25 and row["half_area_q50"] == 1 / 16
    assert row["concentration_mean"] == pytest.approx(1 / 16) and row["peak_q50"] == pytest.approx(np.log(0.5 + 1e-4))
    assert row["spread_mean"] == row["elongation_mean"] == 0
    # changes 1 and -1/4 of full scale in sum; the first frame has the value of the second
    assert row["relative_change_mean"] == pytest.approx((1 + 1 + 1 / 3) / 3)
    assert row["net_change_q5"] == pytest.approx(-1 / 3 * 0.9) and row["one_way_mean"] == pytest.approx(1 / 3)
    assert row["likeness_q95"] == pytest.approx(0.9) and row["likeness_mean"] == pytest.approx(1 / 3)
    assert row["taxels_most_0"] == row["taxels_most_1"] == pytest.approx(np.log(0.5 + 1e-4))
    assert row["taxels_mean_2"] == pytest.approx(np.log(1e-4))


def test_names_and_memory():
    assert str(len(touch.names())) == TouchFeatures.__doc__.split()[0]
    names = {"total_q5", "likeness_kurtosis", "half_area_band10", "col_after_400_ms", "taxels_most_entropy"}
    assert names <= set(touch.names())
    assert TouchFeatures().keeps(54, 64) == 54 * (19 + 3) + 9 * 64 + 5 * 32


@given(st.integers(0, 1000), st.sampled_from(GRIDS))
def test_neighbours_of_a_capture_change_nothing(seed, grid):
    before, capture, after = ragged(seed, grid)
    row = TouchFeatures().transform(corpus_of([capture], None, 12.0))
    captures = pd.DataFrame({"subject": ["1"], "gesture": ["pat"]})
    for others in ([before], [capture, capture], []):
        frames, start = np.concatenate([*others, capture, after]), sum(map(len, others))
        corpus = Corpus(frames, np.array([start]), np.array([len(capture)]), captures, 12.0, full_scale=1023.0)
        assert TouchFeatures().transform(corpus).equals(row)


@given(st.integers(0, 1000), st.sampled_from([0.1, 0.5, 1.0, 9.0]), st.sampled_from([0.0, 0.05, 2.0]))
def test_windows_equal_captures_cut_out(seed, seconds, hop):
    corpus = random_corpus(subjects=2, per_class=2, longest=90, seed=seed, grid=(3, 4))
    windows = Windows(seconds, hop)(corpus)[::-1]
    table = TouchFeatures().transform(windows)
    assert table.index.get_level_values("capture").tolist() == windows.index.tolist()
    assert table.reset_index(drop=True).equals(TouchFeatures().transform(windows.detached()))


def test_columns_that_only_rounding_moves_are_constant():
    """On one row the centre lies in the middle of it, wherever it is pressed."""
    rng = np.random.default_rng(0)
    arrays = [rng.integers(0, 1000, (n, 1, 7)).astype(np.uint16) for n in (2, 3, 40, 41)]
    table = TouchFeatures().extract(corpus_of(arrays, None, 50.0))
    still = table[["row_crossings", "row_turns", "row_sd", "row_step", "row_range", "row_skewness"]]
    assert still.eq(0).all(axis=None) and table["row_mean"].round(6).eq(0.5).all()
    varied = TouchFeatures().transform(generate(subjects=1, repetitions=1))
    assert (varied.std() > 1e-6).all()  # generated gestures differ in every column
