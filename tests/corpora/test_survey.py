"""Surveys against pandas on a table of all readings, duplicates against all pairs."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.duplicates import identical_groups, leaked_captures
from bench.corpora.survey import Survey
from tests.conftest import random_corpus
from tests.corpora.made import copied
from tests.features.captures import corpus_of


def noise(frames=12, grid=(5, 6), seed=0):
    return np.random.default_rng(seed).integers(10, 100, (frames, *grid)).astype(np.uint16)


WHOLE = random_corpus(grid=(3, 4), full_scale=170.0)


@given(
    st.lists(st.integers(0, 35), min_size=1, max_size=20), st.sampled_from(["uint16", "float32"])
)
def test_tables_are_those_of_all_readings_of_ragged_slices(chosen, kind):
    offset = (
        0 if kind == "uint16" else 10_000.5
    )  # squares of large readings must not lose the small differences
    some = WHOLE.with_fields(frames=WHOLE.frames.astype(kind) + np.array(offset, kind))[
        np.array(chosen)
    ]
    result = Survey(some)
    every = np.concatenate(list(some)).reshape(-1, 12).astype(float)
    labels = [np.repeat(values, some.lengths) for values in (some.gestures, np.arange(len(some)))]
    readings = pd.DataFrame(
        every, index=pd.MultiIndex.from_arrays(labels, names=["gesture", "capture"])
    )
    by, full = readings.groupby("gesture"), readings >= 170
    pressure = pd.DataFrame(
        {
            "gesture": sorted(set(some.gestures)),
            "lowest": by.min().min(axis=1).to_numpy(),
            "mean": by.mean().mean(axis=1).to_numpy(),
            "highest": by.max().max(axis=1).to_numpy(),
            "full_scale": 100 * full.groupby("gesture").mean().mean(axis=1).to_numpy(),
            "still": readings.groupby(["gesture", "capture"])
            .nunique()
            .eq(1)
            .all(axis=1)
            .groupby("gesture")
            .sum()
            .values,
        }
    )
    pd.testing.assert_frame_equal(result.pressure, pressure, check_dtype=False)
    np.testing.assert_allclose(result.means.reshape(-1, 12), by.mean())
    centred = readings - readings.groupby("capture").transform("mean")
    expected = {
        "lowest": readings.min(),
        "highest": readings.max(),
        "mean": readings.mean(),
        "full_scale": 100 * full.mean(),
        "sd": np.sqrt((centred**2).mean()),
    }
    assert result.taxels[["row", "col"]].to_numpy().tolist() == [
        list(place) for place in np.ndindex(3, 4)
    ]
    for column, values in expected.items():
        np.testing.assert_allclose(result.taxels[column], values, atol=1e-9)


@given(st.integers(0, 100), st.sampled_from([(5, 6), (1, 7), (1, 1)]))
def test_taxels_are_compared_with_those_around_them(seed, grid):
    rng = np.random.default_rng(seed)
    arrays = [noise(9, grid, seed=i + seed) for i in range(4)]
    for frames in arrays:  # some taxels are still in some captures
        frames[:, rng.random(grid) < 0.15] = 7
    taxels = Survey(corpus_of(arrays)).taxels.set_index(["row", "col"])
    sd = np.sqrt(np.mean([f.var(axis=0) for f in arrays], axis=0))
    varies = np.array([(f != f[0]).any(axis=0) for f in arrays])
    for r, c in np.ndindex(grid):
        near = [(y, x) for y, x in np.ndindex(grid) if max(abs(y - r), abs(x - c)) == 1]
        moving = [sd[p] for p in near if varies[:, p[0], p[1]].any()]
        assert taxels.loc[(r, c), "around"] == pytest.approx(
            np.median(moving) if moving else np.nan, nan_ok=True
        )
        alone = [not v[r, c] and all(v[p] for p in near) and bool(near) for v in varies]
        assert taxels.loc[(r, c), "still"] == pytest.approx(100 * np.mean(alone))


def test_broken_and_odd_taxels_are_named():
    arrays = [noise(40, (6, 6), seed=i) for i in range(8)]
    for i, frames in enumerate(arrays):
        frames[:, 0, 0], frames[:, 0, 3], frames[:, 0, 5] = 0, 1023, i
        frames[:, 3, 3] = 50 + (frames[:, 3, 3] - 50.0) / 5
        frames[:, 5, 0] = 400 + 5 * (frames[:, 5, 0] - 50.0)
        frames[:, 5, 5] = 60 if i < 3 else frames[:, 5, 5]
    result = Survey(corpus_of(arrays))
    assert result.odd_taxels[["row", "col", "verdict"]].to_numpy().tolist() == [
        [0, 0, "never varies"],
        [0, 3, "always at full scale"],
        [0, 5, "never varies within a capture"],
        [3, 3, "varies far less than its neighbours"],
        [5, 0, "varies far more than its neighbours"],
        [5, 5, "often constant while its neighbours vary"],
    ]
    assert "6 of 36" in str(result) and len(result.taxel_lines()) == 7


def test_missing_and_uneven_combinations():
    keys = list(itertools.product(["2", "10"], ["pat", "rub", "tap"], ["bare", "fur"]))
    rows = [key for key in keys if key != ("2", "rub", "fur") and key[:2] != ("10", "tap")] + [
        ("10", "pat", "bare")
    ]
    subjects, gestures, covers = map(list, zip(*rows, strict=True))
    more = {
        "cover": covers,
        "split": ["train"] * len(rows),
        "repetition": range(len(rows)),
        "note": [*map(str, rows)],
    }
    result = Survey(
        corpus_of([noise(seed=i) for i in range(len(rows))], gestures, subject=subjects, **more)
    )
    assert result.factors == [
        "subject",
        "gesture",
        "cover",
    ]  # a number counts, notes were never meant to be crossed
    assert (
        result.counts.to_numpy().tolist() == [[*key, rows.count(key)] for key in keys]
        and result.usual == 1
    )
    assert [line.strip() for line in result.gap_lines()[1:]] == [
        "subject 10, gesture tap: none",  # one gap, not one for each cover
        "subject 2, gesture rub, cover fur: none",
        "subject 10, gesture pat, cover bare: 2 captures",
    ]


@given(st.integers(0, 10**6), st.sampled_from(["uint16", "float32"]))
def test_groups_are_those_of_all_pairs_compared(seed, kind):
    rng = np.random.default_rng(seed)
    shapes = [(1, 1), (1, 2), (2, 1)]
    arrays = []
    for _ in range(
        30
    ):  # few values, so that captures are alike in parts, as a whole, and not at all
        values = rng.integers(0, 2, (rng.integers(1, 4), *shapes[rng.integers(3)])).astype(kind)
        arrays.append(
            -values if kind == "float32" else values
        )  # a zero with a sign equals one without
    expected = {tuple(j for j, b in enumerate(arrays) if np.array_equal(a, b)) for a in arrays}
    assert identical_groups(arrays) == sorted(list(group) for group in expected if len(group) > 1)
    assert identical_groups(arrays[:1]) == identical_groups([]) == []


@given(st.integers(0, 10**6))
def test_what_is_tested_after_training_is_that_of_a_loop(seed):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 8, 20)
    groups = [g.tolist() for g in (np.flatnonzero(labels == k) for k in range(6)) if len(g) > 1]
    sides = [np.split(rng.permutation(20)[:15], [9]) for _ in range(3)]
    expected = {}
    for train, test in sides:
        train.sort()
        for i in test:
            twins = [int(j) for j in train for g in groups if i in g and j in g]
            if twins:
                expected.setdefault(int(i), twins[0])
    assert leaked_captures(groups, sides, 20) == sorted(expected.items())


def test_repeated_recordings_are_listed_and_warned_of():
    survey = Survey(copied(random_corpus(longest=20), [(10, 1), (30, 1), (5, 4)]))
    (warning,) = survey.repeat_warnings()
    assert "\n" not in warning and warning.startswith("Duplicates: 5 captures")
    groups = survey.duplicates[["group", "capture"]].to_numpy().tolist()
    assert groups == [[1, 1], [1, 10], [1, 30], [2, 4], [2, 5]]
    assert Survey(random_corpus()).repeat_warnings() == []
