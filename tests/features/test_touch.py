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
from features import touch
from features.touch import TouchFeatures
from tests.conftest import random_corpus

GRIDS = [(8, 8), (1, 2), (3, 5), (1, 1), (6, 6)]
RATES = [8.0, 12.0, 54.0, 135.0]
STEPWISE = "change rise relative_change net_change one_way speed flow explained flow_row flow_col likeness".split()
SPECTRAL = "total change row col relative_change net_change flow_row flow_col half_area".split()
BANDS = [0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32]  # 32nds of half the rate


def gradient(q):
    """Of a list: half the difference of the neighbours, 0 at the ends; of two, their difference."""
    n = len(q)
    if n == 2:
        return [q[1] - q[0]] * 2
    return [(q[i + 1] - q[i - 1]) / 2 if 0 < i < n - 1 else 0.0 for i in range(n)]


def naive_signals(P):
    """The 19 signals of a capture of shares, frame by frame; what belongs to a step has None in the first frame."""
    T, R, C = P.shape
    N = R * C
    places = [(r, c) for r in range(R) for c in range(C)]
    found = {}

    def say(name, value):
        found.setdefault(name, []).append(value)

    for t in range(T):
        p = P[t]
        s = sum(p[a] for a in places)
        top = max(p[a] for a in places)
        square = sum(p[a] ** 2 for a in places)
        row = sum((r + 0.5) / R * p[r, c] for r, c in places) / s if s else 0.5
        col = sum((c + 0.5) / C * p[r, c] for r, c in places) / s if s else 0.5
        high = sum(((r + 0.5) / R - row) ** 2 * p[r, c] for r, c in places) / s if s else 0
        wide = sum(((c + 0.5) / C - col) ** 2 * p[r, c] for r, c in places) / s if s else 0
        both = sum(((r + 0.5) / R - row) * ((c + 0.5) / C - col) * p[r, c] for r, c in places) / s if s else 0
        say("total", math.log(s / N + 1e-4))
        say("peak", math.log(top + 1e-4))
        say("row", row)
        say("col", col)
        say("spread", math.sqrt(high + wide))
        point = high + wide < 1e-6
        say("elongation", 0 if point else math.sqrt((high - wide) ** 2 + 4 * both**2) / (high + wide))
        say("half_area", sum(p[a] > top / 2 for a in places) / N)
        say("concentration", (s / N) ** 2 / (square / N) if s else 0)
        if t == 0:
            for name in STEPWISE:
                say(name, None)
            continue
        q, before = P[t - 1], sum(P[t - 1][a] for a in places)
        d = [p[a] - q[a] for a in places]
        change, net = sum(map(abs, d)), s - before
        say("change", math.log(change / N + 1e-4))
        say("rise", math.log(sum(max(x, 0) for x in d) / N + 1e-4))
        say("relative_change", change / (s + before) if s + before else 0)
        say("net_change", net / (s + before) if s + before else 0)
        say("one_way", abs(net) / change if change else 0)
        moved = math.hypot(row - found["row"][t - 1], col - found["col"][t - 1])
        say("speed", math.log(moved + 1e-3))
        down = {a: 0.0 for a in places}
        right = dict(down)
        for frame in (p, q):
            for c in range(C):
                for r, g in enumerate(gradient([frame[r, c] for r in range(R)])):
                    down[r, c] += g / 2
            for r in range(R):
                for c, g in enumerate(gradient([frame[r, c] for c in range(C)])):
                    right[r, c] += g / 2
        g, m = np.array([[down[a], right[a]] for a in places]), np.array(d)
        ridge = 1e-5 + 0.01 * (g**2).sum()
        v, u = np.linalg.solve(g.T @ g + ridge * np.eye(2), -g.T @ m)
        energy = m @ m
        say("explained", min(max(-(v * g[:, 0] + u * g[:, 1]) @ m / energy, 0), 1) if energy else 0)
        v, u = min(max(v, -2), 2), min(max(u, -2), 2)
        say("flow", math.log(math.hypot(v, u) + 1e-2))
        say("flow_row", v)
        say("flow_col", u)
        lengths = math.sqrt(square * sum(q[a] ** 2 for a in places))
        say("likeness", sum(p[a] * q[a] for a in places) / lengths if lengths else 1)
    return found


def naive(frames, rate, full_scale, exact=False):
    """All features of one capture by name, and the names of those that hang on a rounding error.

    Where shares are exact in single precision, so are steps of nothing.
    """
    P = (frames.astype(np.float32) / np.float32(full_scale)).astype(float)
    T, R, C = P.shape
    out, close = {}, set()
    x = naive_signals(P)
    for name in STEPWISE:
        x[name][0] = x[name][1] if T > 1 else 0
    for name, values in x.items():
        x[name] = a = np.array(values, float)
        mean, sd = a.sum() / T, math.sqrt(((a - a.mean()) ** 2).sum() / T)
        for q in (5, 25, 50, 75, 95):
            out[f"{name}_q{q}"] = np.percentile(a, q)
        out[f"{name}_mean"], out[f"{name}_sd"] = mean, sd
        d = [a[t] - a[t - 1] for t in range(1, T)]
        out[f"{name}_step"] = sum(map(abs, d)) / (T - 1) if d else 0
        out[f"{name}_step_sd"] = np.std(d) if d else 0
        out[f"{name}_crossings"] = sum((a[t] > mean) != (a[t - 1] > mean) for t in range(1, T)) / max(T - 1, 1)
        turns = sum(d[t] * d[t - 1] < 0 for t in range(1, len(d)))
        out[f"{name}_turns"] = turns / (T - 2) if T > 2 else 0
        varies = sd > 1e-9 * abs(mean) + 1e-12
        z = (a - mean) / (sd if varies else 1)
        out[f"{name}_skewness"] = (z**3).mean() if varies else 0
        out[f"{name}_kurtosis"] = min((z**4).mean(), 30) if varies else 3
        if T > 1 and any((v != 0 or not exact) and abs(v) < 1e-5 for v in [*d, *(a - mean)]):
            close |= {f"{name}_{k}" for k in ("crossings", "turns")}
        if T > 1 and sd < 1e-4 and (sd or not exact):
            close |= {f"{name}_{k}" for k in ("crossings", "turns", "skewness", "kurtosis")}
    length = min(T, max(2, round(1.2 * rate)))
    points = max(64, length)
    for name in SPECTRAL:
        if T < 2:
            out |= {f"{name}_{k}": 0 for k in ("power", "centroid", *(f"band{i}" for i in range(1, 11)))}
            continue
        w = [0.5 - 0.5 * math.cos(2 * math.pi * (i + 1) / (length + 1)) for i in range(length)]
        whole, used = np.zeros(points // 2), 0
        for begin in range(0, T - length + 1, max(length // 2, 1)):
            part = x[name][begin : begin + length]
            part = np.concatenate([(part - part.mean()) * w, np.zeros(points - length)])
            whole += np.abs(np.fft.fft(part)[1 : points // 2 + 1]) ** 2
            used += 1
        whole /= used * sum(v * v for v in w) * points
        total = whole.sum()
        for i in range(10):
            low, high = (math.floor(b / 32 * points / 2) for b in BANDS[i : i + 2])
            share = whole[low:high] if i < 9 else whole[low:]
            out[f"{name}_band{i + 1}"] = math.log((share.sum() + 1e-6 * total + 1e-12) / (total + 1e-12))
        out[f"{name}_power"] = math.log(total + 1e-8)
        out[f"{name}_centroid"] = sum(v * (k + 1) / points for k, v in enumerate(whole)) / total if total else 0
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


def compare(arrays, rate, full_scale, atol, exact=False):
    table = TouchFeatures().transform(corpus_of(arrays, rate, full_scale))
    assert table.shape == (len(arrays), 427) and np.isfinite(table).all(axis=None)
    left_out = 0
    for i, frames in enumerate(arrays):
        expected, close = naive(frames, rate, full_scale, exact)
        assert set(expected) == set(table)
        left_out += len(close)
        names = [name for name in table if name not in close]
        apart = (table.loc[i, names].astype(float) - pd.Series(expected)[names]).abs()
        apart -= 1e-4 * pd.Series(expected)[names].abs()
        assert apart.max() < atol, (len(frames), apart.sort_values().tail(5))
    return left_out / table.size


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("grid", GRIDS)
def test_features_equal_a_loop(grid, rate):
    seed = round(rate) + 10 * grid[1]
    left_out = compare(ragged(seed, grid), rate, 1024.0, 1e-4, exact=True)
    assert left_out < 0.03
    compare(ragged(seed + 1, grid, real=True), rate, 500.0, 3e-3)  # logarithms of 1e-4 and a rounding error
    compare(ragged(seed + 2, grid, sparse=False), rate, 1023.0, 3e-3)


@given(st.integers(0, 10_000), st.tuples(st.integers(1, 4), st.integers(1, 4)), st.sampled_from(RATES), st.booleans())
def test_features_equal_a_loop_on_any_grid(seed, grid, rate, real):
    lengths = np.random.default_rng(seed).integers(1, 25, 3)
    compare(ragged(seed, grid, real, lengths), rate, 512.0 if real else 1024.0, 6e-3)


def test_shift_of_a_ramp_is_its_speed():
    """On a plane of slope 1 that moves by 0.3 columns, the shift is 0.3 columns, but for the ridge and the edges."""
    t, _, c = np.mgrid[:20, :6, :6]
    row = row_of((500 + 20 * (c - 0.3 * t)).astype(np.float32))
    inner = 4 * 6 / (4 * 6 * 1.01)  # the gradient is 0 at the two edges, as is what it explains
    assert row["flow_col_mean"] == pytest.approx(0.3 * inner, rel=0.02) and abs(row["flow_row_mean"]) < 1e-6
    assert row["explained_mean"] == pytest.approx(24 / 36, rel=0.02) and row["one_way_mean"] == pytest.approx(1)


def test_by_hand_on_a_fingertip_that_taps_and_moves():
    frames = np.zeros((3, 4, 4), np.uint16)
    frames[0, 1, 1], frames[1, 1, 2], frames[2, 1, 2] = 512, 512, 256
    row = row_of(frames)
    assert row["row_mean"] == 1.5 / 4 and row["col_range"] == 0.25 and row["half_area_q50"] == 1 / 16
    assert row["concentration_mean"] == pytest.approx(1 / 16) and row["peak_q50"] == pytest.approx(np.log(0.5 + 1e-4))
    assert row["spread_mean"] == row["elongation_mean"] == 0
    # changes 1 and -1/4 of full scale in sum; the first frame has the value of the second
    assert row["relative_change_mean"] == pytest.approx((1 + 1 + 1 / 3) / 3)
    assert row["net_change_q5"] == pytest.approx(-1 / 3 * 0.9) and row["one_way_mean"] == pytest.approx(1 / 3)
    assert row["likeness_q95"] == pytest.approx(0.9) and row["likeness_mean"] == pytest.approx(1 / 3)
    assert row["taxels_most_0"] == row["taxels_most_1"] == pytest.approx(np.log(0.5 + 1e-4))
    assert row["taxels_mean_2"] == pytest.approx(np.log(1e-4))


@pytest.mark.parametrize("grid", [(3, 5), (6, 6), (8, 8), (7, 1)])
def test_pressure_on_one_taxel_is_a_point(grid):
    rng = np.random.default_rng(0)
    frames = np.zeros((60, *grid), np.float32)
    for frame in frames:
        frame[rng.integers(grid[0]), rng.integers(grid[1])] = rng.integers(1, 1024)
    row = row_of(frames, full_scale=1023.0)
    assert (row.filter(regex="^elongation_(q|mean|sd|step)") == 0).all()
    assert row.filter(regex="^spread_q").max() < 1e-6


@pytest.mark.parametrize("length", [1, 3, 65, 300])
def test_a_taxel_that_never_changes_has_no_spread_in_time(length):
    values = np.random.default_rng(0).integers(1, 1024, (1, 8, 8)).astype(np.uint16)
    row = row_of(np.repeat(values, length, axis=0), full_scale=1023.0)
    found = row[[f"taxels_sd_{i}" for i in range(16)]].to_numpy(float)
    np.testing.assert_allclose(found, np.log(1e-4), atol=5e-3)


def test_one_frame_has_no_steps_and_no_spectrum():
    row = row_of(ragged(3, (6, 6), lengths=[1])[0])
    steps = row[[name for name in row.index if name.rsplit("_", 1)[0] in STEPWISE]]
    assert len(steps) > 100 and (steps.drop(steps.filter(like="kurtosis").index) == 0).all()
    spectra = row.filter(regex="_(band.*|power|centroid|.*_ms)$")
    assert len(spectra) == 9 * 12 + 18 and (spectra == 0).all()


def test_names_and_count():
    names = touch.names()
    assert names.is_unique and len(names) == 427  # 13 of 19, 12 of 9, 6 of 3, 3, and 17 of 3
    assert str(len(names)) == TouchFeatures.__doc__.split()[0]
    assert {"total_q5", "likeness_kurtosis", "half_area_band10", "col_after_400_ms", "taxels_most_entropy"} <= set(
        names
    )
    for grid in GRIDS:
        corpus = random_corpus(subjects=1, per_class=1, grid=grid)
        features = TouchFeatures().fit(corpus)
        assert features.transform(corpus).columns.equals(names) and list(features.get_feature_names_out()) == [*names]


@given(st.integers(0, 1000), st.sampled_from(GRIDS))
def test_what_lies_around_a_capture_changes_nothing(seed, grid):
    rng = np.random.default_rng(seed)
    capture, (before, after) = ragged(seed, grid, lengths=[rng.integers(1, 40)])[0], ragged(seed + 1, grid)[-2:]
    row = TouchFeatures().transform(corpus_of([capture], 12.0))
    for around in ([before, capture, after], [after, capture], [capture, before], [capture, capture, capture]):
        frames = np.concatenate(around)
        start = sum(len(a) for a in around[: [a is capture for a in around].index(True)])
        about = pd.DataFrame({"subject": ["1"], "gesture": ["pat"]})
        one = Corpus(frames, np.array([start]), np.array([len(capture)]), about, 12.0, full_scale=1024.0)
        assert TouchFeatures().transform(one).equals(row)


@given(st.integers(0, 1000), st.sampled_from([0.1, 0.5, 1.0, 9.0]), st.sampled_from([0.0, 0.05, 2.0]))
def test_windows_equal_captures_of_their_own(seed, seconds, hop):
    corpus = random_corpus(subjects=2, per_class=2, longest=90, seed=seed, grid=(3, 4))
    windows = Windows(seconds, hop)(corpus)
    found = TouchFeatures().transform(windows)
    assert found.index.get_level_values("capture").tolist() == windows.index.tolist()
    alone = TouchFeatures().transform(windows.detached())
    assert found.reset_index(drop=True).equals(alone) and alone.index.equals(pd.RangeIndex(len(windows)))


@pytest.mark.parametrize("times", [2, 3, 64])
def test_nothing_is_in_sensor_units(times):
    for real in (False, True):
        arrays = ragged(5, (6, 6), real)
        wide = [a.astype(np.float32) * np.float32(times) for a in arrays]
        found, scaled = (
            TouchFeatures().transform(corpus_of(a, 54.0, scale)) for a, scale in ((arrays, 1023), (wide, 1023 * times))
        )
        whole = times == 64 or not real  # else the products are rounded
        np.testing.assert_allclose(scaled, found, **({"rtol": 0, "atol": 0} if whole else {"rtol": 1e-3, "atol": 3e-3}))


def test_nothing_grows_with_duration():
    """A periodic capture of more than one spectrum's length, and the same twice over.

    Equal but for what one step more changes: quantiles, mean, SD and steps of the signals, rates of crossings and
    turns, skewness, kurtosis, shares of power and its logarithm, centroids, ranges, correlation, sorted taxels.
    Autocorrelations are sums over all frames but the lag by all frames, and so approach their limit from below.
    """
    rng = np.random.default_rng(0)
    period = rng.integers(0, 1024, (10, 6, 6)).astype(np.uint16)
    once, twice = (row_of(np.concatenate([period] * n)) for n in (8, 16))
    lagged = once.filter(regex="_ms$").index
    shapes = once.filter(regex="_(skewness|kurtosis)$").index
    bands = once.filter(regex="_band").index
    rest = once.index.difference([*lagged, *shapes, *bands])
    assert (once[rest] - twice[rest]).abs().max() < 0.03
    assert (once[shapes] - twice[shapes]).abs().max() < 0.2
    assert (np.exp(once[bands]) - np.exp(twice[bands])).abs().max() < 0.02
    for name in lagged:
        lag = round(int(name.split("_")[-2]) * 0.054)
        assert once[name] / (1 - lag / 80) == pytest.approx(twice[name] / (1 - lag / 160), abs=0.03)
    different = row_of(rng.integers(0, 1024, (80, 6, 6)).astype(np.uint16))
    assert (once[rest] - different[rest]).abs().max() > 0.3


def test_memory_of_a_window_grows_by_its_signals_alone():
    assert TouchFeatures().keeps(54, 64) == 54 * (19 + 3) + 9 * 64 + 5 * 32
    assert TouchFeatures().keeps(55, 64) - TouchFeatures().keeps(54, 64) == len(touch.SIGNALS) + 3


def test_what_only_rounding_moves_stands_still():
    """On one row the centre lies in the middle of it, whatever is pressed."""
    rng = np.random.default_rng(0)
    arrays = [rng.integers(0, 1000, (n, 1, 7)).astype(np.uint16) for n in (2, 3, 40, 41)]
    about = pd.DataFrame({"subject": list("1122"), "gesture": list("abab")})
    found = TouchFeatures().extract(Corpus.from_captures(arrays, about, 50.0))
    own = found[["row_crossings", "row_turns", "row_sd", "row_step", "row_range", "row_skewness"]]
    assert own.eq(0).all(axis=None) and found["row_mean"].round(6).eq(0.5).all()
    assert found["col_turns"].iloc[2:].gt(0).all()


def test_gestures_differ():
    """No column is the same for all captures of generated touch, so none is a leftover."""
    table = TouchFeatures().transform(generate(subjects=1, repetitions=1))
    assert (table.std() > 1e-6).all()
