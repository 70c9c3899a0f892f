"""What a corpus holds, against loops over its captures."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.survey import Survey
from tests.conftest import random_corpus


def of(arrays, gestures=None, subjects=None, **columns):
    """A corpus of given captures."""
    n = len(arrays)
    labels = {"subject": subjects or ["1"] * n, "gesture": gestures or ["pat"] * n, **columns}
    return Corpus.from_captures(arrays, pd.DataFrame(labels), 10.0, name="mine")


def noise(frames=12, grid=(5, 6), seed=0):
    return np.random.default_rng(seed).integers(10, 100, (frames, *grid)).astype(np.uint16)


@given(st.lists(st.integers(0, 35), min_size=1, max_size=40), st.sampled_from(["uint16", "float32"]))
def test_tables_are_those_of_loops_over_ragged_slices(chosen, kind):
    corpus = random_corpus(grid=(3, 4), full_scale=170.0)
    offset = 0 if kind == "uint16" else 10_000.5  # squares of large readings must not lose the small differences
    some = corpus.changed(frames=corpus.frames.astype(kind) + np.array(offset, kind))[np.array(chosen)]
    result = Survey(some)
    names = sorted(set(some.gestures))
    assert result.gestures == names
    for i, name in enumerate(names):
        captures = [f.astype(float) for f, g in zip(some, some.gestures, strict=True) if g == name]
        subjects = {s for s, g in zip(some.subjects, some.gestures, strict=True) if g == name}
        seconds, every = [len(f) / 100 for f in captures], np.concatenate(captures)
        row = result.durations.iloc[i][["captures", "subjects", "median", "shortest", "longest"]].tolist()
        assert row == pytest.approx(
            [len(captures), len(subjects), np.median(seconds), min(seconds), max(seconds)], rel=1e-12
        )
        still = sum((f == f[0]).all() for f in captures)
        row = result.pressure.iloc[i][["lowest", "mean", "highest", "full_scale", "still"]].tolist()
        assert row == pytest.approx([every.min(), every.mean(), every.max(), 100 * (every >= 170).mean(), still])
        np.testing.assert_allclose(result.means[i], every.mean(axis=0))
    every = np.concatenate([f.astype(float) for f in some])
    centred = np.concatenate([f.astype(float) - f.astype(float).mean(axis=0) for f in some])
    expected = {
        "lowest": every.min(axis=0),
        "highest": every.max(axis=0),
        "mean": every.mean(axis=0),
        "full_scale": 100 * (every >= 170).mean(axis=0),
        "sd": np.sqrt((centred**2).mean(axis=0)),
    }
    assert result.taxels[["row", "col"]].to_numpy().tolist() == [list(place) for place in np.ndindex(3, 4)]
    for column, values in expected.items():
        np.testing.assert_allclose(result.taxels[column], values.ravel(), atol=1e-9)


@given(st.integers(0, 100), st.sampled_from([(5, 6), (1, 7), (1, 1)]))
def test_taxels_are_compared_with_those_around_them(seed, grid):
    rng = np.random.default_rng(seed)
    arrays = [noise(9, grid, seed=i + seed) for i in range(4)]
    for frames in arrays:  # some taxels are still in some captures
        frames[:, rng.random(grid) < 0.15] = 7
    taxels = Survey(of(arrays)).taxels.set_index(["row", "col"])
    sd = np.sqrt(np.mean([f.var(axis=0) for f in arrays], axis=0))
    varies = np.array([(f != f[0]).any(axis=0) for f in arrays])
    for r, c in np.ndindex(grid):
        near = [(y, x) for y, x in np.ndindex(grid) if max(abs(y - r), abs(x - c)) == 1]
        moving = [sd[p] for p in near if varies[:, p[0], p[1]].any()]
        assert taxels.loc[(r, c), "around"] == pytest.approx(np.median(moving) if moving else np.nan, nan_ok=True)
        alone = [not v[r, c] and all(v[p] for p in near) and bool(near) for v in varies]
        assert taxels.loc[(r, c), "still"] == pytest.approx(100 * np.mean(alone))


def test_broken_and_odd_taxels_are_named():
    arrays = [noise(40, (6, 6), seed=i) for i in range(8)]
    for i, frames in enumerate(arrays):
        frames[:, 0, 0] = 0
        frames[:, 0, 3] = 1023
        frames[:, 0, 5] = i
        frames[:, 3, 3] = 50 + (frames[:, 3, 3] - 50.0) / 5
        frames[:, 5, 0] = 400 + 5 * (frames[:, 5, 0] - 50.0)
        if i < 3:
            frames[:, 5, 5] = 60
    result = Survey(of(arrays))
    assert {(t["row"], t["col"]): t["verdict"] for t in result.odd_taxels.to_dict("records")} == {
        (0, 0): "never varies",
        (0, 3): "always at full scale",
        (0, 5): "never varies within a capture",
        (3, 3): "varies far less than its neighbours",
        (5, 0): "varies far more than its neighbours",
        (5, 5): "often constant while its neighbours vary",
    }
    assert "6 of 36" in str(result) and len(result.taxel_lines()) == 7
    assert set(Survey(of([np.zeros((4, 2, 2), np.uint16)])).taxels["verdict"]) == {"never varies"}


def test_missing_and_uneven_combinations():
    rows = list(itertools.product(["2", "10"], ["pat", "rub", "tap"], ["bare", "fur"]))
    rows.remove(("2", "rub", "fur"))
    rows = [r for r in rows if r[:2] != ("10", "tap")]
    rows.append(("10", "pat", "bare"))
    subjects, gestures, covers = map(list, zip(*rows, strict=True))
    arrays = [noise(seed=i) for i in range(len(rows))]
    more = {"cover": covers, "split": ["train"] * len(rows), "repetition": range(len(rows)), "note": [*map(str, rows)]}
    result = Survey(of(arrays, gestures, subjects, **more))
    assert result.factors == ["subject", "gesture", "cover"]  # a number counts, notes were never meant to be crossed
    keys = list(itertools.product(["2", "10"], ["pat", "rub", "tap"], ["bare", "fur"]))
    assert result.counts.to_numpy().tolist() == [[*key, rows.count(key)] for key in keys] and result.usual == 1
    assert [line.strip() for line in result.gap_lines()[1:]] == [
        "subject 10, gesture tap: none",  # one gap, not one for each cover
        "subject 2, gesture rub, cover fur: none",
        "subject 10, gesture pat, cover bare: 2 captures",
    ]
