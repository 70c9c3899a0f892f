"""What a corpus holds, against loops over its captures."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.survey import blocks, survey
from bench.errors import InputError
from tests.conftest import random_corpus


def of(arrays, gestures=None, subjects=None, **columns):
    """A corpus of given captures."""
    n = len(arrays)
    about = {"subject": subjects or ["1"] * n, "gesture": gestures or ["pat"] * n, **columns}
    return Corpus.from_captures(arrays, pd.DataFrame(about), 10.0, name="own")


def noise(frames=12, grid=(5, 6), seed=0):
    return np.random.default_rng(seed).integers(10, 100, (frames, *grid)).astype(np.uint16)


@given(st.lists(st.integers(0, 35), min_size=1, max_size=40), st.sampled_from([1, 500, 1 << 20]))
def test_blocks_hold_every_capture_once_and_are_bounded(chosen, most):
    some = random_corpus(grid=(3, 4))[np.array(chosen)]
    seen = []
    for part, frames in blocks(some, most):
        lengths = some.lengths[part]
        assert frames.size <= most or len(lengths) == 1
        seen += np.split(frames, np.cumsum(lengths)[:-1])
    assert len(seen) == len(some)
    for found, expected in zip(seen, some, strict=True):
        assert np.array_equal(found, expected.reshape(len(expected), 12))


@given(st.lists(st.integers(0, 35), min_size=1, max_size=40), st.sampled_from(["uint16", "float32"]))
def test_tables_are_those_of_loops_over_ragged_slices(chosen, kind):
    whole = random_corpus(grid=(3, 4), full_scale=170.0)
    offset = 0 if kind == "uint16" else 10_000.5  # squares of large readings must not lose the small differences
    whole = whole.changed(frames=whole.frames.astype(kind) + np.array(offset, kind))
    some = whole[np.array(chosen)]
    found = survey(some)
    names = sorted(set(some.gestures))
    assert found.gestures == names
    for i, name in enumerate(names):
        own = [f.astype(float) for f, g in zip(some, some.gestures, strict=True) if g == name]
        seconds = [len(f) / 100 for f in own]
        told = found.durations.iloc[i]
        assert (told["captures"], told["median"]) == (len(own), pytest.approx(np.median(seconds)))
        assert (told["shortest"], told["longest"]) == (min(seconds), max(seconds))
        assert told["subjects"] == len({s for s, g in zip(some.subjects, some.gestures, strict=True) if g == name})
        told, every = found.pressure.iloc[i], np.concatenate(own)
        assert (told["lowest"], told["highest"]) == (every.min(), every.max())
        assert told["mean"] == pytest.approx(every.mean())
        assert told["full_scale"] == pytest.approx(100 * (every >= 170).mean())
        assert told["still"] == sum((f == f[0]).all() for f in own)
        np.testing.assert_allclose(found.means[i], every.mean(axis=0))
    every = np.concatenate([f.astype(float) for f in some])
    centred = np.concatenate([f.astype(float) - f.astype(float).mean(axis=0) for f in some])
    table = found.taxels.set_index(["row", "col"])
    for r, c in np.ndindex(3, 4):
        told = table.loc[(r, c)]
        assert (told["lowest"], told["highest"]) == (every[:, r, c].min(), every[:, r, c].max())
        assert told["mean"] == pytest.approx(every[:, r, c].mean())
        assert told["full_scale"] == pytest.approx(100 * (every[:, r, c] >= 170).mean())
        assert told["sd"] == pytest.approx(np.sqrt((centred[:, r, c] ** 2).mean()), abs=1e-9)


def neighbours(r, c, rows, cols):
    near = itertools.product(range(max(r - 1, 0), min(r + 2, rows)), range(max(c - 1, 0), min(c + 2, cols)))
    return [place for place in near if place != (r, c)]


@given(st.integers(0, 100), st.sampled_from([(5, 6), (1, 7), (4, 1), (2, 2)]))
def test_taxels_are_compared_with_those_around_them(seed, grid):
    rng = np.random.default_rng(seed)
    arrays = [noise(9, grid, seed=i + seed) for i in range(4)]
    for frames in arrays:  # some taxels are still in some captures
        frames[:, rng.random(grid) < 0.15] = 7
    found = survey(of(arrays)).taxels.set_index(["row", "col"])
    sd = np.sqrt(np.mean([f.var(axis=0) for f in arrays], axis=0))
    varies = np.array([(f != f[0]).any(axis=0) for f in arrays])
    for r, c in np.ndindex(grid):
        near = neighbours(r, c, *grid)
        known = [sd[p] for p in near if varies[:, p[0], p[1]].any()]
        assert found.loc[(r, c), "around"] == pytest.approx(np.median(known) if known else np.nan, nan_ok=True)
        alone = [not v[r, c] and all(v[p] for p in near) for v in varies]
        assert found.loc[(r, c), "still"] == pytest.approx(100 * np.mean(alone))


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
    found = survey(of(arrays))
    assert {(t["row"], t["col"]): t["verdict"] for t in found.odd_taxels.to_dict("records")} == {
        (0, 0): "never varies",
        (0, 3): "always at full scale",
        (0, 5): "never varies within a capture",
        (3, 3): "varies far less than those around it",
        (5, 0): "varies far more than those around it",
        (5, 5): "often does not vary while all around it do",
    }
    assert "Taxels: 6 of 36 odd" in str(found) and "row 0, col 3: always at full scale" in str(found)
    assert "nothing is odd" in str(survey(of([noise()])))


def test_grids_and_captures_that_can_show_nothing():
    for arrays in ([noise(1, (1, 1))], [noise(1, (2, 3)), noise(1, (2, 3), seed=1)], [np.zeros((4, 2, 2), np.uint16)]):
        found = survey(of(arrays))
        assert len(found.taxels) == arrays[0][0].size and "own" in str(found)
    assert set(found.taxels["verdict"]) == {"never varies"} and found.pressure["still"].tolist() == [1]
    with pytest.raises(InputError, match="no captures"):
        survey(of([noise()])[np.array([], int)])


def test_missing_and_uneven_combinations():
    rows = list(itertools.product(["2", "10"], ["pat", "rub", "tap"], ["bare", "fur"]))
    rows.remove(("2", "rub", "fur"))
    rows = [r for r in rows if r[:2] != ("10", "tap")]
    rows.append(("10", "pat", "bare"))
    subjects, gestures, covers = map(list, zip(*rows, strict=True))
    arrays = [noise(seed=i) for i in range(len(rows))]
    more = {"cover": covers, "split": ["train"] * len(rows), "repetition": range(len(rows)), "note": [*map(str, rows)]}
    found = survey(of(arrays, gestures, subjects, **more))
    assert found.factors == ["subject", "gesture", "cover"]  # a number counts, notes were never meant to be crossed
    told = {tuple(r[:3]): r[3] for r in found.counts.to_numpy()}
    assert told == {
        key: rows.count(key) for key in itertools.product(["2", "10"], ["pat", "rub", "tap"], ["bare", "fur"])
    }
    assert found.counts["subject"].tolist() == ["2"] * 6 + ["10"] * 6 and found.usual == 1
    assert {tuple(r) for r in found.gaps.to_numpy()} == {
        ("2", "rub", "fur", 0),
        ("10", "pat", "bare", 2),
        ("10", "tap", "bare", 0),
        ("10", "tap", "fur", 0),
    }
    lines = found.gap_lines()
    assert lines[0] == (
        "Gaps: of 12 combinations of subject, gesture and cover, 8 have 1 capture, 1 another number, 3 none"
    )
    assert [line.strip() for line in lines[1:]] == [
        "subject 10, gesture tap: none",
        "subject 2, gesture rub, cover fur: none",
        "subject 10, gesture pat, cover bare: 2 captures",
    ]


def test_many_gaps_are_counted_not_all_printed():
    n = 30
    subjects, gestures = [str(i) for i in range(n)], [f"g{i}" for i in range(n)]
    lines = survey(of([noise(seed=i) for i in range(n)], gestures, subjects)).gap_lines()
    assert len(lines) == 1 + 12 + 1 and lines[-1] == f"  ... and {n * (n - 1) - 12} more"


def test_duplicates_also_under_other_labels_and_in_slices():
    a, b = noise(seed=1), noise(seed=2)
    arrays = [a, b, a.copy(), b[:-1], b.copy(), noise(seed=3), a.copy()]
    corpus = of(arrays, [*"ppqppqp"], [*"1112111"], cover=["x", "x", "x", "x", "y", "x", "x"])
    found = survey(corpus)
    table = found.duplicates
    assert table[["group", "capture"]].to_numpy().tolist() == [[1, 0], [1, 2], [1, 6], [2, 1], [2, 4]]
    assert table["differs"].tolist() == ["gesture"] * 3 + ["cover"] * 2
    expected = {
        frozenset(j for j in range(7) if np.array_equal(arrays[i], arrays[j])) for i in range(7)
    }  # a naive comparison of all pairs
    assert {frozenset(p["capture"]) for _, p in table.groupby("group")} == {e for e in expected if len(e) > 1}
    lines = found.duplicate_lines()
    assert "5 captures share their frames with another one, in 2 groups; 1 of them under several" in lines[0]
    assert lines[1].strip() == (
        "capture 0, subject 1, gesture p, cover x = capture 2, gesture q = capture 6, gesture p"
    )
    assert not table["quiet"].any() and "refuse" not in lines[0] and "chance" not in lines[0]
    some = survey(corpus[np.array([6, 5, 4, 0])])
    assert some.duplicates["capture"].tolist() == [0, 6]  # numbers of the whole corpus
    assert "no two captures" in survey(corpus[3:6]).duplicate_lines()[0]


def test_quiet_captures_that_are_the_same_are_told_apart_from_copies():
    rest, copy = np.full((20, 5, 6), 3, np.uint16), noise(seed=1)
    found = survey(of([rest, copy, rest, copy, rest], subjects=[*"12345"]))
    assert found.duplicates[["capture", "quiet"]].to_numpy().tolist() == [
        *([i, False] for i in (1, 3)),
        *([i, True] for i in (0, 2, 4)),
    ]
    assert found.duplicate_lines()[0].endswith(
        "2 of them under several subjects or gestures; protocols that separate subjects refuse 1; 1 may be equal by "
        "chance: fewer than 8 readings change"
    )


def test_a_typical_capture_is_in_the_middle():
    arrays = [noise(n, seed=n) * np.uint16(k) for n, k in ((5, 1), (9, 2), (10, 3), (11, 4), (30, 9))]
    corpus = of([*arrays, noise(3)], ["pat"] * 5 + ["tap"])
    assert survey(corpus).typical == {"pat": 2, "tap": 5}
    assert survey(corpus[1:]).typical["tap"] == 5


def test_generated_captures_say_so(corpus):
    assert "synthetic" not in str(survey(corpus))
    found = survey(corpus.changed(info={"synthetic": True}))
    assert found.synthetic and "synthetic: generated captures, not people" in repr(found)
