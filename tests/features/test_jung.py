"""Every feature against a loop written from the papers' definitions, on captures of any length and grid."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from tests.features.captures import GRIDS, LEVELS, corpus_of, near, ragged, row_of


def naive(frames, rate, full_scale, area="frame"):
    """Features 1-54 of one capture, frame by frame and taxel by taxel; old feature 22 last."""
    T, R, C = frames.shape
    P = frames.astype(float)
    top = P.max()
    s = [P[t].sum() for t in range(T)]
    mean_s = sum(s) / T
    com = [((R + 1) / 2, (C + 1) / 2)] * T
    for t in range(T):
        if s[t]:
            row = sum((r + 1) * P[t, r, c] for r in range(R) for c in range(C)) / s[t]
            com[t] = (row, sum((c + 1) * P[t, r, c] for r in range(R) for c in range(C)) / s[t])
    steps = max(T - 1, 1)
    change = [np.abs(P[t] - P[t - 1]) for t in range(1, T)]
    areas = [(P[t] > 0.5 * (P[t].max() if area == "frame" else top)).mean() for t in range(T)]
    out = [P.mean(), top, sum(d.sum() for d in change) / steps]
    out += [P[:, r].mean() for r in range(R)] + [P[:, :, c].mean() for c in range(C)]
    out += [np.mean(areas), areas[int(np.argmax(s))]]
    out += [sum(s[t] > s[t - 1] and s[t] > s[t + 1] for t in range(1, T - 1))]

    def crossings(level):
        return sum(s[t - 1] <= level < s[t] for t in range(1, T))

    out += [crossings(mean_s)]
    down = [com[t][0] - com[t - 1][0] for t in range(1, T)]
    right = [com[t][1] - com[t - 1][1] for t in range(1, T)]
    for moved in (down, right):
        out += [sum(map(abs, moved)) / steps, sum(map(abs, moved))]
    out += [T]
    out += list(np.histogram(P, bins=8, range=(0, full_scale))[0] / P.size)
    counts, means, distances = [], [], []
    for t in range(T):
        peaks = []
        for r, c in np.ndindex(R, C):
            near = [(y, x) for y in range(max(0, r - 1), min(R, r + 2)) for x in range(max(0, c - 1), min(C, c + 2))]
            peak = all(P[t, r, c] > P[t][other] for other in near if other < (r, c))
            peak &= all(P[t, r, c] >= P[t][other] for other in near)
            if peak and P[t, r, c] > 0.75 * top:
                peaks.append(np.hypot(r + 1 - com[t][0], c + 1 - com[t][1]))
        counts.append(len(peaks))
        means.append(np.mean(peaks) if peaks else None)
        distances += peaks
    out += [np.mean(counts), np.var(counts), np.mean(distances) if distances else 0]
    both = [abs(means[t] - means[t - 1]) for t in range(1, T) if means[t] is not None and means[t - 1] is not None]
    out += [np.mean(both) if both else 0]
    for axis in (2, 1):
        m = P.mean(axis=axis)
        out += [np.mean(np.abs(m[1:] - m[:-1])) if T > 1 else 0]
    out += [np.mean(change) if T > 1 else 0, P.var()]
    quadrants = [0, 0, 0, 0]
    length = [float(np.hypot(d, r)) for d, r in zip(down, right, strict=True)]
    for d, r, size in zip(down, right, length, strict=True):
        if size > 1e-6:
            angle = np.degrees(np.arctan2(-d, r))
            for side in (-5, 5):
                quadrants[int(np.floor(((angle + side) % 360) / 90)) % 4] += 0.5
    out += [q / steps for q in quadrants]
    out += [np.mean(length), np.std(length), sum(length), max(length) - min(length)] if length else [0, 0, 0, 0]
    for axis in (0, 1):
        path = np.array([p[axis] for p in com])
        best, where = 0, 0
        for k in range(1, T // 2 + 1):
            wave = abs(sum((path[t] - path.mean()) * np.exp(-2j * np.pi * k * t / T) for t in range(T)))
            if wave > best * (1 + 1e-9):
                best, where = wave, k
        out += [where * rate / T if np.ptp(path) > 1e-9 else 0]
    return out, crossings(mean_s + np.std(s))


REAL = st.sampled_from([None, 1.0, 0.7, 3.3])
AREA = st.sampled_from(["frame", "capture"])


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]), AREA, REAL)
def test_features_equal_a_loop_over_the_definitions(seed, grid, levels, area, real):
    low, high, full_scale = LEVELS[levels]
    arrays = ragged(seed, grid, low, high, longest=30)
    if real:
        arrays, full_scale = [(a / full_scale * real).astype(np.float32) for a in arrays], real
    corpus = corpus_of(arrays, full_scale=full_scale)
    table = Jung54(area).transform(corpus)
    crossings, maxima = Jung28(area).transform(corpus), Jung28(area, peaks="maxima").transform(corpus)
    for i, frames in enumerate(corpus):
        expected, crossed = naive(frames, 100.0, full_scale, area)
        near(table.iloc[i], expected)
        first = expected[: crossings.shape[1]]
        near(maxima.iloc[i], first)
        first[crossings.columns.get_loc("f22_peaks_mean_plus_sd")] = crossed
        near(crossings.iloc[i], first)


def test_sums_beyond_what_float32_counts_are_exact():
    rng = np.random.default_rng(0)
    frames = rng.integers(65000, 65535, (3, 1, 1600)).astype(np.uint16)
    frames[1] = frames[2] = frames[0]
    frames[1, 0, 0] += 1  # one unit in 10^8
    row = row_of(Jung54(), frames, full_scale=65535.0)
    assert row["f22_peaks"] == 1 and row["f03_pressure_variability"] == 1


def test_by_hand_on_a_fingertip_that_moves_one_column():
    frames = np.zeros((2, 8, 8), np.uint16)
    frames[0, 0, 0], frames[1, 0, 1] = 100, 200
    row = row_of(Jung54(), frames)
    assert row["f01_mean_pressure"] == 300 / 128 and row["f02_max_pressure"] == 200
    assert row["f03_pressure_variability"] == 300 and row["f43_derivative"] == 300 / 64
    assert row["f20_contact_area"] == row["f21_peak_contact_area"] == 1 / 64
    assert (row["f24_row_travel_mean"], row["f26_col_travel_mean"], row["f27_col_travel_sum"]) == (0, 1, 1)
    assert row["f28_duration"] == 2 and row["f23_mean_crossings"] == 1
    assert (row["f29_values_bin1"], row["f30_values_bin2"]) == (127 / 128, 1 / 128)
    assert row["f37_spatial_peaks_mean"] == 0.5  # 100 is not above 0.75 of 200
    assert (row["f45_up_right"], row["f48_down_right"]) == (0.5, 0.5)  # to the right, on the border of two quadrants
    assert row["f49_step_mean"] == row["f51_step_sum"] == 1 and row["f52_step_range"] == 0
