"""Every feature against a loop written from the papers' definitions, on captures of any length and grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench import source
from bench.corpora.synth import generate
from bench.corpus import open_folder, write_folder
from features import signals
from features.jung28 import Jung28
from features.jung54 import Jung54
from tests.conftest import random_corpus


def naive(frames, rate, full_scale, area="frame"):
    """Features 1-54 of one capture, frame by frame and taxel by taxel; old feature 22 last."""
    T, R, C = frames.shape
    P = frames.astype(float)
    top = P.max()
    s = [P[t].sum() for t in range(T)]
    mean_s = sum(s) / T
    com = []
    for t in range(T):
        if s[t] == 0:
            com.append(((R + 1) / 2, (C + 1) / 2))
        else:
            com.append(
                (
                    sum((r + 1) * P[t, r, c] for r in range(R) for c in range(C)) / s[t],
                    sum((c + 1) * P[t, r, c] for r in range(R) for c in range(C)) / s[t],
                )
            )
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
        found = []
        for r in range(R):
            for c in range(C):
                if P[t, r, c] <= 0.75 * top:
                    continue
                peak = True
                for y in range(max(0, r - 1), min(R, r + 2)):
                    for x in range(max(0, c - 1), min(C, c + 2)):
                        if (y, x) < (r, c):
                            peak &= P[t, r, c] > P[t, y, x]
                        elif (y, x) > (r, c):
                            peak &= P[t, r, c] >= P[t, y, x]
                if peak:
                    found.append(np.hypot(r + 1 - com[t][0], c + 1 - com[t][1]))
        counts.append(len(found))
        means.append(np.mean(found) if found else None)
        distances += found
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


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([(8, 8), (3, 5), (1, 4), (5, 1)]), st.sampled_from(["frame", "capture"]))
def test_features_equal_a_loop_over_the_definitions(seed, grid, area):
    corpus = random_corpus(subjects=1, per_class=1, grid=grid, longest=16, seed=seed)
    table54, table28 = Jung54(area).transform(corpus), Jung28().transform(corpus)
    assert table54.shape == (3, 54 - 16 + sum(grid)) and table28.shape == (3, 28 - 16 + sum(grid))
    for i, frames in enumerate(corpus):
        expected, old_peaks = naive(frames, 100.0, 1023, area)
        np.testing.assert_allclose(table54.iloc[i], expected, rtol=1e-6, atol=1e-6)
        if area == "frame":
            first = expected[: table28.shape[1]]
            first[table28.columns.get_loc("f22_peaks_mean_plus_sd")] = old_peaks
            np.testing.assert_allclose(table28.iloc[i], first, rtol=1e-6, atol=1e-6)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 1000))
def test_float_captures(seed):
    corpus = random_corpus(subjects=1, per_class=1, grid=(4, 4), longest=20, seed=seed)
    values = (corpus.frames / 1023).astype(np.float32)
    floats = type(corpus)(**{**vars(corpus), "frames": values, "full_scale": 1.0})
    for i, frames in enumerate(floats):
        np.testing.assert_allclose(
            Jung54().transform(floats).iloc[i], naive(frames, 100.0, 1.0)[0], rtol=1e-5, atol=1e-6
        )


def test_by_hand_on_a_fingertip_that_moves_one_column():
    frames = np.zeros((2, 8, 8), np.uint16)
    frames[0, 0, 0], frames[1, 0, 1] = 100, 200
    corpus = random_corpus(subjects=1, per_class=1)[:1]
    one = type(corpus).from_captures([frames], corpus.captures, 135.0)
    row = Jung54().transform(one).iloc[0]
    assert row["f01_mean_pressure"] == 300 / 128 and row["f02_max_pressure"] == 200
    assert row["f03_pressure_variability"] == 300 and row["f43_derivative"] == 300 / 64
    assert row["f20_contact_area"] == row["f21_peak_contact_area"] == 1 / 64
    assert (row["f24_row_travel_mean"], row["f26_col_travel_mean"], row["f27_col_travel_sum"]) == (0, 1, 1)
    assert row["f28_duration"] == 2 and row["f23_mean_crossings"] == 1
    assert (row["f29_values_bin1"], row["f30_values_bin2"]) == (127 / 128, 1 / 128)
    assert row["f37_spatial_peaks_mean"] == 0.5  # 100 is not above 0.75 of 200
    assert (row["f45_up_right"], row["f48_down_right"]) == (0.5, 0.5)  # to the right, on the border of two quadrants
    assert row["f49_step_mean"] == row["f51_step_sum"] == 1 and row["f52_step_range"] == 0


def test_counts_and_linear_dependencies_on_8_by_8():
    corpus = generate(subjects=2)
    table = Jung54().transform(corpus)
    assert table.shape[1] == 54 and Jung28().transform(corpus).shape[1] == 28
    assert table.columns.is_unique and list(table.columns) == sorted(table.columns, key=lambda c: int(c[1:3]))
    np.testing.assert_allclose(table["f43_derivative"], table["f03_pressure_variability"] / 64)
    np.testing.assert_allclose(table["f01_mean_pressure"], table.filter(like="f04_row").mean(axis=1))
    np.testing.assert_allclose(table["f01_mean_pressure"], table.filter(like="f12_col").mean(axis=1))
    np.testing.assert_allclose(table.filter(like="_values_bin").sum(axis=1), 1)


@pytest.mark.parametrize("frames", [1, 2, 3, 50])
@pytest.mark.parametrize("value", [0, 7, 1023])
def test_constant_captures_are_finite(frames, value):
    corpus = random_corpus(subjects=1, per_class=1)
    one = type(corpus).from_captures([np.full((frames, 8, 8), value, np.uint16)], corpus.captures[:1], 135.0)
    for features in (Jung28(), Jung54(), Jung54("capture")):
        row = features.transform(one).iloc[0]
        assert np.isfinite(row).all() and row["f28_duration"] == frames
        assert row.filter(regex="travel|crossings").abs().sum() == 0


def test_a_slice_has_the_rows_of_the_whole(corpus, monkeypatch):
    whole = Jung54().transform(corpus)
    chosen = np.array([7, 3, 20, 3])
    assert Jung54().transform(corpus[chosen]).equals(whole.iloc[chosen].reset_index(drop=True))
    monkeypatch.setattr(signals, "blocks", lambda c, blocks=signals.blocks: blocks(c, frames=50))
    assert Jung54().transform(corpus).equals(whole)


def test_features_are_computed_once_per_corpus(corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    expected = Jung54().transform(corpus)
    assert Jung54().transform(stored[np.array([4, 2])]).equals(expected.iloc[[4, 2]].reset_index(drop=True))
    monkeypatch.setattr(Jung54, "extract", lambda *_: pytest.fail("computed again"))
    assert Jung54().transform(stored).equals(expected)
    assert Jung54().cache_key("a") != Jung54().cache_key("b") != Jung54("capture").cache_key("b")


def test_a_change_of_code_never_meets_stale_values(monkeypatch):
    before = Jung54().cache_key("a")
    assert before == Jung54().cache_key("a")
    monkeypatch.setattr(source, "content", lambda path, changed: b"changed" if path.endswith("signals.py") else b"")
    assert Jung54().cache_key("a") != before


def test_a_folder_that_cannot_be_written_only_costs_time(corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "file"))
    assert Jung28().transform(open_folder(tmp_path / "c")).equals(Jung28().transform(corpus))
