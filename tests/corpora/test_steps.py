"""Windows, damaged copies, repair and scaling against loops, and what all of them must keep."""

import dataclasses
import math
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import COPY, Corpus, storage
from bench.corpora.faults import FAULTS
from bench.corpora.steps import REPAIRS, Faulted, Repair, Scale, Turned, Windows, around
from bench.errors import InputError
from tests.conftest import random_corpus

GRIDS = [(8, 8), (1, 2), (3, 5), (1, 1)]
STEPS = {
    "windows": Windows(0.1),
    "repair": Repair(REPAIRS),
    "scale": Scale("peak"),
    "log": Scale("log"),
    "faulted": Faulted(tuple(FAULTS), 2),
    "turned": Turned(2),
}


def corpus_of(arrays, rate=12.0, full_scale=1023.0):
    about = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, about, rate, full_scale=full_scale)


def with_broken(seed, grid, kind=np.uint16, lengths=None):
    """Random captures in which some taxels never change, some only at first, and some read full scale."""
    rng = np.random.default_rng(seed)
    arrays = []
    for length in rng.integers(1, 40, 3) if lengths is None else lengths:
        frames = rng.integers(0, 1023, (length, *grid))
        for row, col in np.ndindex(grid):
            until = [0, 0, 0, length, rng.integers(length + 1)][rng.integers(5)]
            frames[:until, row, col] = rng.choice([0, 400, 1022, 1023])
        arrays.append(frames.astype(kind))
    return arrays


# Windows


@given(
    st.lists(st.integers(1, 60), min_size=1, max_size=6),
    st.sampled_from([0.01, 0.5, 1.0, 1.7, 9.0]),
    st.sampled_from([0.0, 0.01, 0.3, 1.0, 2.5]),
    st.sampled_from([1.0, 8.0, 12.0, 54.0]),
)
def test_windows_equal_a_loop(lengths, seconds, hop, rate):
    arrays = [np.random.default_rng(n).integers(0, 999, (n, 2, 3)).astype(np.uint16) for n in lengths]
    corpus = corpus_of(arrays, rate)[np.random.default_rng(len(lengths)).permutation(len(lengths))]
    frames = max(1, round(seconds * rate))
    step = max(1, round(hop * rate)) if hop else math.ceil(frames / 2)
    expected = []
    for i in range(len(corpus)):
        begin = 0
        while begin == 0 or begin + frames <= len(corpus[i]):
            expected.append((i, begin, corpus[i][begin : begin + frames]))
            begin += step
    windows = Windows(seconds, hop)
    found = windows(corpus)
    assert windows.lengths(rate) == (frames, step) and found.steps == (windows,)
    assert windows.rows(corpus).tolist() == [i for i, _, _ in expected]
    assert found.piece.tolist() == [begin for _, begin, _ in expected]
    assert found.index.tolist() == [corpus.index[i] for i, _, _ in expected]
    assert len(found) == len(expected) and all(map(np.array_equal, found, (part for _, _, part in expected)))
    assert storage(found)[0] is storage(corpus)[0] and all(np.shares_memory(part, storage(corpus)[0]) for part in found)
    assert found.captures.equals(corpus.captures.iloc[[i for i, _, _ in expected]].reset_index(drop=True))


def test_windows_by_hand():
    corpus = corpus_of([np.zeros((n, 1, 1), np.uint16) for n in (1, 12, 17, 18, 30)])  # of 12 Hz
    found = Windows(1.0)(corpus)
    assert found.index.tolist() == [0, 1, 2, 3, 3, 4, 4, 4, 4]
    assert found.piece.tolist() == [0, 0, 0, 0, 6, 0, 6, 12, 18]
    assert found.lengths.tolist() == [1] + 8 * [12]
    assert Windows(1.0, 2.0)(corpus).lengths.tolist() == [1, 12, 12, 12, 12]  # a second one is not full
    assert Windows(0.25).lengths(12.0) == (3, 2)  # half of an odd number of frames
    assert Windows(1e-9).lengths(12.0) == (1, 1)


def test_windows_of_windows_say_where_they_lie_in_the_capture():
    corpus = corpus_of([np.arange(40, dtype=np.uint16)[:, None, None]])
    found = Windows(0.5, 0.25)(Windows(1.0, 1.0)(corpus))
    assert [part[0, 0, 0] for part in found] == found.piece.tolist() == [0, 3, 6, 12, 15, 18, 24, 27, 30]


# Repair


def naive_repair(frames, kinds, full_scale, rate):
    """Taxel by taxel and frame by frame, each from the frames before."""
    P = frames.astype(float)
    T, R, C = P.shape
    settled = max(2, math.ceil(0.25 * rate))
    out = np.zeros_like(P)

    def beside(r, c):
        places = [(y, x) for y in (r - 1, r, r + 1) for x in (c - 1, c, c + 1) if (y, x) != (r, c)]
        return [(y, x) for y, x in places if 0 <= y < R and 0 <= x < C]

    for t in range(T):
        still = {(r, c): (P[: t + 1, r, c] == P[0, r, c]).all() for r, c in np.ndindex(R, C)}
        moving = [P[t][a] for a in still if not still[a]]
        values = {}
        for r, c in still:
            broken = False
            long = still[r, c] and t + 1 >= settled
            if "stuck" in kinds:
                broken |= P[: t + 1, r, c].min() >= full_scale
                broken |= bool(long and moving and P[t, r, c] > max(moving))
            if "dead" in kinds:
                broken |= bool(long and sum(not still[a] for a in beside(r, c)) > len(beside(r, c)) / 2)
            if not broken:
                values[r, c] = P[t, r, c]
        for _ in range(3):
            near = {a: [values[b] for b in beside(*a) if b in values] for a in still if a not in values}
            values |= {a: np.mean(found) for a, found in near.items() if found}
        for a in still:
            out[t][a] = values.get(a, 0)
    if "offset" in kinds:
        return np.array([out[t] - out[: t + 1].min(axis=0) for t in range(T)])
    return out


@given(
    st.integers(0, 10_000),
    st.sampled_from([(4, 4), (1, 5), (2, 3), (1, 1), (7, 2)]),
    st.sampled_from([("stuck",), ("dead",), ("offset",), ("stuck", "dead"), REPAIRS]),
    st.sampled_from([1.0, 12.0, 54.0]),
    st.sampled_from([np.uint16, np.float32]),
)
def test_repair_equals_a_loop(seed, grid, kinds, rate, kind):
    arrays = with_broken(seed, grid, kind)
    corpus = corpus_of(arrays, rate)
    before = corpus.frames.copy()
    found = Repair(kinds)(corpus)
    for one, frames in zip(found, arrays, strict=True):
        np.testing.assert_allclose(one, naive_repair(frames, kinds, 1023, rate), rtol=1e-5, atol=1e-3)
    assert found.frames.dtype == np.float32 and np.array_equal(corpus.frames, before)
    assert np.array_equal(found.lengths, corpus.lengths) and found.captures.equals(corpus.captures)


SCALED = [Scale("peak"), Scale("log")]


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([np.uint16, np.float32]))
def test_repair_and_scale_are_causal(seed, grid, kind):
    (frames,) = with_broken(seed, grid, kind, lengths=[30])
    for step in (Repair(("stuck",)), Repair(("dead",)), Repair(("offset",)), Repair(REPAIRS), *SCALED):
        (whole,) = step(corpus_of([frames]))
        for length in (1, 2, 3, 7, 20, 29):
            (part,) = step(corpus_of([frames[:length]]))
            assert np.array_equal(part, whole[:length]), step
        changed = frames.copy()
        changed[20:] = 77
        assert np.array_equal(step(corpus_of([changed]))[0][:20], whole[:20])


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
@pytest.mark.parametrize("grid", GRIDS)
def test_a_sound_sensor_needs_no_repair(grid, kind):
    rng = np.random.default_rng(0)
    arrays = [rng.integers(0, 1023, (n, *grid)).astype(kind) for n in (1, 2, 40)]  # none reads full scale
    found = Repair(("stuck", "dead"))(corpus_of(arrays))
    assert np.array_equal(found.frames, np.concatenate(arrays))
    resting = arrays[2].copy()
    resting[:, 0, 0] = 0  # neither dead, as long as no more than half of its neighbours move, nor stuck
    resting[:, 1:] = 0
    few = Repair(("stuck", "dead"))(corpus_of([resting]))
    assert min(grid) == 1 or np.array_equal(few.frames, resting)
    let_go = [np.concatenate([a[:1] * 0, a]) for a in arrays]
    assert np.array_equal(Repair(("offset",))(corpus_of(let_go)).frames, np.concatenate(let_go))
    untouched = [np.zeros((50, *grid), kind)]
    assert not Repair(REPAIRS)(corpus_of(untouched)).frames.any()


def test_a_stuck_taxel_is_the_mean_of_its_neighbours():
    frames = np.random.default_rng(0).integers(0, 900, (20, 4, 4)).astype(np.uint16)
    frames[:, 1, 1] = frames[:, 0, 3] = 1023
    (found,) = Repair(("stuck",))(corpus_of([frames]))
    near = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)]
    np.testing.assert_allclose(found[:, 1, 1], np.mean([frames[:, r, c] for r, c in near], axis=0), rtol=1e-6)
    np.testing.assert_allclose(
        found[:, 0, 3], np.mean([frames[:, 0, 2], frames[:, 1, 2], frames[:, 1, 3]], axis=0), rtol=1e-6
    )
    sound = np.ones((4, 4), bool)
    sound[1, 1] = sound[0, 3] = False
    assert np.array_equal(found[:, sound], frames[:, sound])
    frames[10, 1, 1] = 1022  # so it was a touch
    (found,) = Repair(("stuck",))(corpus_of([frames]))
    assert (found[:10, 1, 1] < 900).all() and np.array_equal(found[10:, 1, 1], frames[10:, 1, 1])


def test_a_taxel_stuck_below_full_scale_is_found_when_it_stands_out():
    frames = np.random.default_rng(0).integers(0, 300, (20, 3, 3)).astype(np.uint16)
    frames[:, 1, 1] = 400
    frames[12, 0, 0] = 700  # a touch that is above it
    (found,) = Repair(("stuck",))(corpus_of([frames]))
    others = frames.reshape(20, 9)[:, [0, 1, 2, 3, 5, 6, 7, 8]].mean(axis=1)
    repaired = np.isclose(found[:, 1, 1], others, rtol=1e-6)
    assert repaired.tolist() == [False] * 2 + [True] * 10 + [False] + [True] * 7  # 3 frames are a quarter of a second
    assert (found[~repaired, 1, 1] == 400).all()


def test_a_dead_taxel_among_moving_ones():
    frames = np.random.default_rng(0).integers(0, 900, (20, 3, 3)).astype(np.uint16)
    frames[:, 1, 1] = 5
    (found,) = Repair(("dead",))(corpus_of([frames]))
    others = frames.reshape(20, 9)[:, [0, 1, 2, 3, 5, 6, 7, 8]].mean(axis=1)
    assert (found[:2, 1, 1] == 5).all()
    np.testing.assert_allclose(found[2:, 1, 1], others[2:], rtol=1e-6)
    frames[:, 0], frames[:, 1, 0] = 7, 7  # now 4 of its 8 neighbours move, which is not more than half
    assert (Repair(("dead",))(corpus_of([frames])).frames[:, 1, 1] == 5).all()


def test_a_taxel_without_a_sound_neighbour_is_filled_from_filled_ones():
    frames = np.full((5, 1, 7), 1023, np.uint16)
    frames[:, 0, 0] = np.arange(5)
    (found,) = Repair(("stuck",))(corpus_of([frames]))
    assert np.array_equal(found[:, 0], np.outer(np.arange(5), [1, 1, 1, 1, 0, 0, 0]))  # three passes


def test_an_offset_is_what_never_went_away():
    frames = np.array([9, 12, 7, 7, 20, 3, 4], np.uint16)[:, None, None]
    (found,) = Repair(("offset",))(corpus_of([frames]))
    assert found.ravel().tolist() == [0, 3, 0, 0, 13, 0, 1]


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("length", [1, 2, 30])
@pytest.mark.parametrize("value", [0, 5, 1023])
def test_constant_captures_and_small_grids(grid, length, value):
    frames = np.full((length, *grid), value, np.uint16)
    for kinds in ((k,) for k in REPAIRS):
        (found,) = Repair(kinds)(corpus_of([frames]))
        gone = value and (kinds == ("offset",) or (kinds == ("stuck",) and value == 1023))
        assert (found == (0 if gone else value)).all(), kinds
    assert (Scale("peak")(corpus_of([frames])).frames == (1023 if value else 0)).all()


def test_neighbours_are_summed_over_the_edges():
    frames = np.random.default_rng(0).random((2, 3, 4)).astype(np.float32)
    for t, r, c in np.ndindex(2, 3, 4):
        near = frames[t, max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2].sum() - frames[t, r, c]
        assert around(frames)[t, r, c] == pytest.approx(near, rel=1e-5)


def test_repair_undoes_what_the_fault_of_a_sensor_did():
    """On a smooth touch what is filled is nearer to what was there than what the broken taxel read."""
    t, r, c = np.mgrid[:40, :8, :8]
    touch = (600 + 300 * np.sin(t / 3 + r / 4 + c / 5)).astype(np.uint16)
    for name in ("stuck_taxels", "dead_taxels"):
        shares = (touch / 1023).astype(np.float32)
        broken = np.rint(FAULTS[name].apply(shares, 3, "1", 1) * 1023).astype(np.uint16)
        (found,) = Repair(("stuck", "dead"))(corpus_of([broken]))
        off = np.abs(broken.astype(float) - touch)[3:].mean()
        assert off > 20 and np.abs(found - touch)[3:].mean() < off / 20


# Scaling


@given(st.integers(0, 10_000), st.sampled_from(GRIDS), st.sampled_from([1023.0, 65535.0, 0.7]))
def test_scaling_equals_a_loop(seed, grid, full_scale):
    rng = np.random.default_rng(seed)
    arrays = [rng.random((n, *grid)) * (rng.random((n, 1, 1)) < 0.6) * full_scale for n in (1, 2, 20)]
    arrays = [a.astype(np.float32) if full_scale < 1 else np.rint(a).astype(np.uint16) for a in arrays]
    corpus = corpus_of(arrays, full_scale=full_scale)
    found = Scale("peak")(corpus)
    for one, frames in zip(found, arrays, strict=True):
        for t in range(len(frames)):
            most = float(frames[: t + 1].max())
            expected = frames[t] * (full_scale / most) if most else frames[t] * 0
            np.testing.assert_allclose(one[t], expected, rtol=1e-6)
    assert found.frames.dtype == np.float32 and found.full_scale == full_scale
    assert found.frames.min() >= 0 and found.frames.max() <= np.float32(full_scale)  # also after rounding


@pytest.mark.parametrize("gain", [2, 4, 16])
def test_a_gain_tells_nothing_after_scaling(gain):
    corpus = random_corpus(longest=20)
    louder = corpus.changed(frames=corpus.frames * np.uint16(gain))
    assert np.array_equal(Scale("peak")(louder).frames, Scale("peak")(corpus).frames)


# Damaged copies


@pytest.mark.parametrize("kind", ["uint16", "float32"])
def test_originals_stay_and_copies_follow(kind):
    corpus = random_corpus()
    if kind == "float32":
        corpus = corpus.changed(frames=corpus.frames.astype(np.float32) / 3)
    before = corpus.frames.copy()
    step = Faulted(("noise", "dead_taxels", "gain_drift"), 4)
    found, rows = step(corpus), step.rows(corpus)
    assert len(found) == 5 * len(corpus) and rows.tolist() == [i for i in range(36) for _ in range(5)]
    assert found.index.tolist() == rows.tolist() and found.gestures.tolist() == corpus.gestures[rows].tolist()
    assert np.array_equal(corpus.frames, before) and found.frames.dtype == before.dtype
    for i in range(36):
        assert np.array_equal(found[5 * i], corpus[i])
        for copy in range(1, 5):
            one = found[5 * i + copy]
            assert one.shape == corpus[i].shape and not np.array_equal(one, corpus[i])
            assert found.piece[5 * i + copy] == copy * COPY
    assert found.frames.max() <= corpus.full_scale and found.frames.min() >= 0
    assert not np.shares_memory(found.frames, corpus.frames)


def test_copies_equal_the_fault_at_the_drawn_severity():
    corpus = random_corpus(subjects=2)
    names = ("noise", "shift", "early_end", "stuck_taxels")
    step = Faulted(names, 3)
    found = step(corpus)
    drawn = set()
    for i in range(len(corpus)):
        for copy in range(3):
            rng = step.generator(i, copy)
            name, severity = names[rng.integers(len(names))], int(rng.integers(5))
            shares = corpus[i].astype(np.float32) / np.float32(1023)
            expected = np.rint(FAULTS[name].damage(shares, FAULTS[name].amounts[severity], rng) * np.float32(1023))
            assert np.array_equal(found[4 * i + copy + 1], expected.clip(0, 1023))
            drawn.add((name, severity))
    assert len(drawn) > 15  # of 20


def test_copies_are_the_same_in_any_company():
    corpus = random_corpus()
    step = Faulted(tuple(FAULTS), 2)
    whole = step(corpus)
    assert np.array_equal(step(corpus).frames, whole.frames)
    chosen = np.array([30, 4, 17])
    part = step(corpus[chosen])
    for at, i in enumerate(chosen):
        for copy in range(3):
            assert np.array_equal(part[3 * at + copy], whole[3 * int(i) + copy])
    more = Faulted(tuple(FAULTS), 4)(corpus)
    assert all(np.array_equal(more[5 * i + 2], whole[3 * i + 2]) for i in range(36))


def test_no_test_capture_meets_the_draws_of_a_training_copy():
    def first(rng):
        return rng.bit_generator.state["state"]["state"], rng.bit_generator.state["state"]["inc"]

    captures, subjects = range(300), [str(s) for s in range(1, 60)]
    test = {first(f.generator("1", i)) for f in FAULTS.values() if not f.sensor for i in captures}
    test |= {first(f.generator(s, 0)) for f in FAULTS.values() if f.sensor for s in subjects}
    step = Faulted(("noise",), 9)
    training = [first(step.generator(i, copy)) for i in captures for copy in range(9)]
    sensors = sum(f.sensor for f in FAULTS.values())
    assert len(test) == (17 - sensors) * 300 + sensors * 59 and len(set(training)) == 2700
    assert not test & set(training)
    frames = np.full((30, 8, 8), 0.5, np.float32)  # and what is drawn differs, not the seed alone
    corpus = corpus_of([np.full((30, 8, 8), 500, np.uint16)] * 40)
    copies = Faulted(("noise",), 3)(corpus)
    tested = [FAULTS["noise"].apply(frames, s, "1", i) for i in range(40) for s in range(1, 6)]
    found = {np.rint(one * 1023).astype(np.uint16).tobytes() for one in tested}
    assert not found & {one.tobytes() for one in copies}


# All of them


@pytest.mark.parametrize("name", STEPS)
def test_rows_are_those_of_the_captures_made(name):
    step = STEPS[name]
    corpus = random_corpus()[np.array([11, 3, 7, 30])]
    found = step(corpus)
    assert np.array_equal(corpus.index[step.rows(corpus)], found.index)
    assert len(step.rows(corpus)) == len(found) == len(found.captures) == len(found.piece)
    assert found.captures.equals(corpus.captures.iloc[step.rows(corpus)].reset_index(drop=True))
    assert found.steps == (step,) and corpus.steps == ()
    assert len(set(zip(found.index, found.piece, strict=True))) == len(found)  # what a kept table is read by
    again = step(found)
    assert again.steps == (step, step) and np.array_equal(found.index[step.rows(found)], again.index)
    same = (found.rate_hz, found.full_scale, found.name, found.grid)
    assert same == (corpus.rate_hz, corpus.full_scale, corpus.name, corpus.grid)


@pytest.mark.parametrize("name", STEPS)
def test_what_is_made_of_a_capture_depends_on_it_alone(name):
    corpus = random_corpus(grid=(3, 4))
    whole, rows = STEPS[name](corpus), STEPS[name].rows(corpus)
    for i in (0, 7, 35):
        alone = STEPS[name](corpus[i : i + 1])
        assert all(map(np.array_equal, alone, whole[np.flatnonzero(rows == i)]))


@pytest.mark.parametrize("name", STEPS)
def test_no_captures_stay_none(name):
    none = random_corpus()[np.array([], dtype=int)]
    found = STEPS[name](none)
    assert len(found) == len(found.captures) == len(found.piece) == len(STEPS[name].rows(none)) == 0
    assert found.grid == (8, 8)


@pytest.mark.parametrize("name", STEPS)
def test_a_step_tells_its_parameters(name):
    """They are part of what names a kept table."""
    step = STEPS[name]
    assert all(f"{f.name}={getattr(step, f.name)!r}" in repr(step) for f in dataclasses.fields(step))
    assert step == dataclasses.replace(step) and hash(step) == hash(dataclasses.replace(step))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Repair(("stuck", "broken")), "model.repair=stuck+broken: give stuck or dead or offset, joined by +"),
        (lambda: Scale("none"), "model.scale=none: give none or peak"),
        (lambda: Scale("mean"), "model.scale=mean: give none or peak"),
        (lambda: Faulted(("noise", "nois")), "model.faults=noise+nois: 'nois' is no fault; did you mean noise?"),
        (lambda: Faulted(("noise",), 0), "model.copies=0: give 1 to 1048575"),
        (lambda: Faulted(("all",)), "model.faults=all: 'all' is no fault"),
    ],
)
def test_wrong_names_are_refused_in_one_line(make, message):
    with pytest.raises(InputError, match=re.escape(message)) as found:
        make()
    assert "\n" not in str(found.value)


# Another scale, another mounting


def test_a_logarithmic_reading_by_hand():
    (found,) = Scale("log")(corpus_of([np.array([[[0, 255, 1023]]], dtype=np.uint16)]))
    by_hand = [0, 1023 * np.log(1 + 1000 * 255 / 1023) / np.log(1001), 1023]
    assert found.dtype == np.float32 and found.ravel() == pytest.approx(by_hand, rel=1e-6)
    (same,) = Scale("log")(corpus_of([np.array([[[0, 0.25, 1.0]]], dtype=np.float32)], full_scale=1.0))
    assert same.ravel()[1] == pytest.approx(np.log(251) / np.log(1001), rel=1e-6)  # in shares: no unit matters


def mountings(frame):
    """Every way in which a grid of the same shape can lie, by index of each taxel, the grid itself first."""
    rows, cols = frame.shape
    found = []
    for swap in (False, True) if rows == cols else (False,):
        for up in (False, True):
            for left in (False, True):
                made = np.empty_like(frame)
                for r, c in np.ndindex(rows, cols):
                    to = (rows - 1 - r if up else r, cols - 1 - c if left else c)
                    made[to[::-1] if swap else to] = frame[r, c]
                found.append(made)
    return found


@pytest.mark.parametrize("grid", [(4, 4), (3, 5), (1, 3)])
def test_turned_copies_lie_otherwise_in_all_frames_alike_and_every_way_occurs(grid):
    rng = np.random.default_rng(0)
    arrays = [rng.integers(0, 1023, (int(n), *grid)).astype(np.uint16) for n in rng.integers(1, 9, 30)]
    corpus = corpus_of(arrays)
    found = Turned(4)(corpus)
    assert len(found) == 150 and list(Turned(4).rows(corpus)) == [i for i in range(30) for _ in range(5)]
    assert len(set(zip(found.index, found.piece, strict=True))) == 150
    seen = set()
    for i, frames in enumerate(arrays):
        assert np.array_equal(found[5 * i], frames)
        for copy in range(1, 5):
            turned = found[5 * i + copy]
            ways = [mountings(frame) for frame in frames]
            same = [
                k
                for k in range(len(ways[0]))
                if all(np.array_equal(w[k], t) for w, t in zip(ways, turned, strict=True))
            ]
            assert same, "the frames of a copy lie differently"
            seen |= set(same[:1])
    # A grid of one row can only be reversed.
    assert seen == (set(range(1, 8)) if grid == (4, 4) else {1, 2, 3} if min(grid) > 1 else {1})
    again = Turned(4)(corpus[7:9])  # whatever it is turned with
    assert all(np.array_equal(again[k], found[35 + k]) for k in range(10))


def test_no_two_copies_of_a_capture_lie_alike_as_long_as_there_are_other_ways():
    rng = np.random.default_rng(0)
    for grid, ways in (((4, 4), 8), ((3, 5), 4)):
        found = Turned(7)(corpus_of([rng.integers(0, 1023, (3, *grid)).astype(np.uint16)]))
        assert len(found) == 8 and len({found[k].tobytes() for k in range(8)}) == ways
    with pytest.raises(InputError, match="model.turns=8: give 1 to 7, or 0 for none"):
        Turned(8)


def test_one_taxel_cannot_lie_otherwise():
    (frames,) = [np.arange(5, dtype=np.uint16).reshape(5, 1, 1)]
    found = Turned(2)(corpus_of([frames]))
    assert len(found) == 3 and all(np.array_equal(one, frames) for one in found)


def test_a_logarithm_is_of_what_lies_within_full_scale():
    (found,) = Scale("log")(corpus_of([np.array([[[-5, 2000, 10]]], dtype=np.float32)]))
    assert found.ravel()[:2].tolist() == [0, 1023] and 0 < found.ravel()[2] < 1023


def test_damaged_copies_are_turned_each_by_itself():
    corpus = corpus_of([np.random.default_rng(0).integers(0, 1023, (20, 8, 8)).astype(np.uint16)])
    found = Turned(1)(Faulted(("noise",), 3)(corpus))
    assert len(found) == 8 and len(set(found.piece)) == 8 and set(found.index) == {0}
    assert len({found[k].tobytes() for k in range(8)}) == 8
