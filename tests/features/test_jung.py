"""Every feature against a loop written from the papers' definitions, on captures of any length and grid."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from bench import source
from bench.corpora.corpus import Corpus
from bench.corpora.folder import open_folder, write_folder
from bench.corpora.synth import generate
from bench.errors import InputError
from features import cache as kept
from features import signals
from features.cache import cache_key
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


GRIDS = [(8, 8), (3, 5), (1, 4), (5, 1), (1, 1)]
LEVELS = {  # lowest and highest value, full scale: what sensors give, and what is hard for float32
    "10 bit": (0, 1023, 1023.0),
    "few levels": (0, 3, 1023.0),
    "saturated": (1022, 1023, 1023.0),
    "16 bit": (0, 65535, 65535.0),
    "saturated 16 bit": (65534, 65535, 65535.0),
}


def corpus_of(arrays, rate=100.0, full_scale=1023.0):
    about = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, about, rate, full_scale=full_scale)


def ragged(seed, grid, low, high, captures=3, longest=30):
    rng = np.random.default_rng(seed)
    arrays = [rng.integers(low, high + 1, (rng.integers(1, longest + 1), *grid)) for _ in range(captures)]
    touched = [rng.random(len(a)) < 0.8 for a in arrays]  # in other frames nobody touches the sensor
    return [(a * t[:, None, None]).astype(np.uint16) for a, t in zip(arrays, touched, strict=True)]


@given(
    st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([*LEVELS]), st.sampled_from(["frame", "capture"])
)
def test_features_equal_a_loop_over_the_definitions(seed, grid, levels, area):
    low, high, full_scale = LEVELS[levels]
    corpus = corpus_of(ragged(seed, grid, low, high), full_scale=full_scale)
    table54 = Jung54(area).transform(corpus)
    crossings, maxima = Jung28(area).transform(corpus), Jung28(area, peaks="maxima").transform(corpus)
    assert table54.shape == (3, 54 - 16 + sum(grid)) and crossings.shape == (3, 28 - 16 + sum(grid))
    for i, frames in enumerate(corpus):
        expected, old_peaks = naive(frames, 100.0, full_scale, area)
        np.testing.assert_allclose(table54.iloc[i], expected, rtol=1e-5, atol=1e-9)
        first = expected[: crossings.shape[1]]
        np.testing.assert_allclose(maxima.iloc[i], first, rtol=1e-5, atol=1e-9)
        first[crossings.columns.get_loc("f22_peaks_mean_plus_sd")] = old_peaks
        np.testing.assert_allclose(crossings.iloc[i], first, rtol=1e-5, atol=1e-9)


@given(st.integers(0, 1000), st.sampled_from([1.0, 0.7, 3.3]))
def test_float_captures(seed, full_scale):
    arrays = [(a / 1023 * full_scale).astype(np.float32) for a in ragged(seed, (4, 4), 0, 1023)]
    table = Jung54().transform(corpus_of(arrays, full_scale=full_scale))
    for i, frames in enumerate(arrays):
        np.testing.assert_allclose(table.iloc[i], naive(frames, 100.0, full_scale)[0], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("value", [1023, 65535])
def test_variance_of_a_long_capture_in_which_one_value_differs(value):
    frames = np.full((1500, 8, 8), value, np.uint16)
    frames[700, 3, 3] -= 1
    row = Jung54().transform(corpus_of([frames], full_scale=float(value))).iloc[0]
    assert row["f44_variance"] == pytest.approx(frames.astype(np.float64).var(), rel=1e-5)
    assert row["f03_pressure_variability"] == 2 / 1499  # a step down that wrapped round would be 65535


def test_sums_beyond_what_float32_counts_are_exact():
    rng = np.random.default_rng(0)
    frames = rng.integers(65000, 65535, (3, 1, 1600)).astype(np.uint16)
    frames[1] = frames[2] = frames[0]
    frames[1, 0, 0] += 1  # one unit in 10^8
    row = Jung54().transform(corpus_of([frames], full_scale=65535.0)).iloc[0]
    assert row["f22_peaks"] == 1 and row["f03_pressure_variability"] == 1


def test_periodicity_of_a_fingertip_that_goes_round():
    time = np.arange(200) / 100
    row, col = np.round(3.5 + 3 * np.sin(2 * np.pi * 2 * time)), np.round(3.5 + 3 * np.sin(2 * np.pi * 5 * time))
    frames = np.zeros((200, 8, 8), np.uint16)
    frames[np.arange(200), row.astype(int), col.astype(int)] = 500
    found = Jung54().transform(corpus_of([frames])).iloc[0]
    assert (found["f53_row_frequency"], found["f54_col_frequency"]) == (2, 5)


def test_of_equal_amplitudes_the_lowest_frequency_counts():
    for length in range(2, 40):  # the spectrum of an impulse is flat
        frames = np.full((length, 8, 8), 10, np.uint16)
        frames[length // 2, 0, 0] = 900
        row = Jung54().transform(corpus_of([frames])).iloc[0]
        assert row["f53_row_frequency"] == row["f54_col_frequency"] == 100 / length


def test_spatial_peaks_by_hand():
    frame = np.zeros((4, 5), np.uint16)
    frame[0, 0] = frame[0, 1] = frame[1, 0] = 100  # a plateau counts once
    frame[0, 4] = 80  # neither the row above nor the next row begins beside the last column
    frame[1, 0] = 100
    frame[3, 2] = 76
    frame[3, 4] = 75  # not above three quarters
    row = Jung54().transform(corpus_of([np.stack([frame, frame * 0])])).iloc[0]
    assert row["f37_spatial_peaks_mean"] == 1.5 and row["f38_spatial_peaks_variance"] == 2.25
    assert row["f40_peak_distance_change"] == 0  # the second frame has no peak


def test_by_hand_on_a_fingertip_that_moves_one_column():
    frames = np.zeros((2, 8, 8), np.uint16)
    frames[0, 0, 0], frames[1, 0, 1] = 100, 200
    row = Jung54().transform(corpus_of([frames])).iloc[0]
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


@pytest.mark.parametrize("grid", [(8, 8), (1, 4), (1, 1)])
@pytest.mark.parametrize("frames", [1, 2, 3, 50])
@pytest.mark.parametrize("value", [0, 7, 1023, 65535])
@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_constant_captures_are_finite(frames, value, grid, kind):
    one = corpus_of([np.full((frames, *grid), value, kind)], full_scale=max(value, 1023.0))
    for features in (Jung28(), Jung28(peaks="maxima"), Jung54(), Jung54("capture")):
        row = features.transform(one).iloc[0]
        assert np.isfinite(row).all() and row["f28_duration"] == frames
        assert row.filter(regex="travel|displacement|crossings|derivative|_step_|frequency").abs().sum() == 0


def test_a_slice_has_the_rows_of_the_whole(corpus, monkeypatch):
    whole = Jung54().transform(corpus)
    chosen = np.array([7, 3, 20, 3])
    assert Jung54().transform(corpus[chosen]).equals(whole.iloc[chosen].reset_index(drop=True))
    assert Jung54().transform(corpus[np.array([], dtype=int)]).equals(whole.iloc[:0])
    monkeypatch.setattr(signals, "blocks", lambda c, blocks=signals.blocks: blocks(c, values=50 * 64))
    assert len(signals.blocks(corpus)) > 5
    assert Jung54().transform(corpus).equals(whole)


@given(st.integers(0, 1000), st.sampled_from([*GRIDS, (5, 7)]))
def test_rounding_does_not_depend_on_the_other_captures(seed, grid):
    rng = np.random.default_rng(seed)  # values so different in size that their sums are rounded
    arrays = [(rng.random((rng.integers(1, 12), *grid)) ** 30).astype(np.float32) for _ in range(40)]
    corpus = corpus_of([np.repeat(a, 2, axis=0) for a in arrays], full_scale=1.0)
    whole = Jung54().transform(corpus)
    for i in range(len(corpus)):
        assert Jung54().transform(corpus[i : i + 1]).equals(whole.iloc[i : i + 1].reset_index(drop=True))
    assert (whole["f22_peaks"] == 0).all()  # every frame comes twice, none is greater than both neighbours


def test_names_clones_and_parameters(corpus):
    for features in (Jung28(), Jung28("capture", "maxima"), Jung54("capture")):
        with pytest.raises(NotFittedError):
            features.get_feature_names_out()
        table = features.fit_transform(corpus)
        assert list(features.get_feature_names_out()) == list(table.columns)
        assert clone(features).get_params() == features.get_params()
        assert list(clone(features).set_output(transform="pandas").fit_transform(corpus).columns) == list(table.columns)
    named = set(Jung28().transform(corpus).columns)
    assert {"f22_peaks_mean_plus_sd", "f24_row_displacement_mean", "f27_col_displacement_sum"} <= named
    for wrong in (Jung54("frames"), Jung28("frames"), Jung28(peaks="2014")):
        with pytest.raises(InputError, match="features.*: give"):
            wrong.check()
        with pytest.raises(InputError):
            wrong.transform(corpus)


def test_features_are_computed_once_per_corpus(corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    expected = Jung54().transform(corpus)
    assert Jung54().transform(stored[np.array([4, 2])]).equals(expected.iloc[[4, 2]].reset_index(drop=True))
    monkeypatch.setattr(Jung54, "extract", lambda *_: pytest.fail("computed again"))
    assert Jung54().transform(stored).equals(expected)
    monkeypatch.setattr(kept.pd, "read_parquet", lambda *_: pytest.fail("read again"))
    assert Jung54().transform(stored[5:2:-1]).equals(expected.iloc[5:2:-1].reset_index(drop=True))
    assert len(list((tmp_path / "home" / "features").iterdir())) == 1  # nothing is left beside the table


def test_corpus_parameters_and_class_are_in_the_key():
    keys = [
        cache_key(Jung54(), "a"),
        cache_key(Jung54(), "b"),
        cache_key(Jung54("capture"), "a"),
        cache_key(Jung28(), "a"),
    ]
    assert len({*keys, cache_key(Jung28(peaks="maxima"), "a")}) == 5


def test_a_change_of_code_never_meets_stale_values(monkeypatch):
    before = cache_key(Jung54(), "a")
    assert before == cache_key(Jung54(), "a")
    original = source.meaning
    for name, other in (("signals.py", True), ("jung28.py", True), ("jung54.py", True), ("kept.py", False)):
        changed = lambda p, at, n=name: (original(p, at)[0] + p.endswith(n) * b"changed", original(p, at)[1])  # noqa: E731
        with monkeypatch.context() as patch:
            patch.setattr(source, "meaning", changed)
            assert (cache_key(Jung54(), "a") != before) == other


@pytest.mark.parametrize("damage", [b"", b"PAR1 this is no table", None])
def test_a_damaged_table_is_computed_again(corpus, tmp_path, damage):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    expected = Jung28().transform(corpus)
    path = tmp_path / "home" / "features" / f"{cache_key(Jung28(), stored.digest)}.parquet"
    path.parent.mkdir(parents=True)
    if damage is not None:
        path.write_bytes(damage)
    assert Jung28().transform(stored).equals(expected)
    assert pd.read_parquet(path).equals(expected)


def test_a_folder_that_cannot_be_written_only_costs_time(corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    stored, expected = open_folder(tmp_path / "c"), Jung28().transform(corpus)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "file"))
    asked = []
    extract = Jung28.extract
    monkeypatch.setattr(Jung28, "extract", lambda self, c: (asked.append(len(c)), extract(self, c))[1])
    assert Jung28().transform(stored[3:5]).equals(expected.iloc[3:5].reset_index(drop=True))
    assert asked == [2]  # no more than the captures that were asked for


def test_a_disk_that_is_full_only_costs_time(corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    stored, expected = open_folder(tmp_path / "c"), Jung28().transform(corpus)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_parquet", full)
    assert Jung28().transform(stored).equals(expected)
    assert not list((tmp_path / "home" / "features").iterdir())


def test_a_corpus_that_was_replaced_does_not_fill_the_cache(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    write_folder(random_corpus(seed=1), tmp_path / "d")
    (tmp_path / "c").rename(tmp_path / "old")
    (tmp_path / "d").rename(tmp_path / "c")
    assert Jung28().transform(stored).equals(Jung28().transform(corpus))
    assert not list((tmp_path / "home" / "features").iterdir())


def test_the_registry_imports_nothing_heavy():
    code = "import sys, features; sys.exit(bool({'numpy', 'pandas', 'sklearn', 'scipy'} & set(sys.modules)))"
    root = str(source.Path(source.__file__).parents[1])
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0
