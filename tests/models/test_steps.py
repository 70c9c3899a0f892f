"""Windows, damaged copies, repair and scaling against loops, and what all of them must keep."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import convolve

from bench.corpora.corpus import COPY, shared_frames
from bench.corpora.faults import FAULTS
from bench.corpora.windows import Windows
from bench.models.steps import REPAIRS, DamagedCopies, Repair, Scale, TurnedCopies
from tests.conftest import random_corpus
from tests.features.captures import corpus_of

STEPS = [
    Windows(0.1),
    Repair(REPAIRS),
    Scale("peak"),
    Scale("log"),
    DamagedCopies(tuple(FAULTS), 2),
    TurnedCopies(2),
]


@given(
    st.lists(st.integers(1, 60), min_size=1, max_size=6),
    st.sampled_from([0.01, 0.5, 1.7, 9.0]),
    st.sampled_from([0.0, 0.01, 0.3, 2.5]),
    st.sampled_from([1.0, 12.0, 54.0]),
)
def test_windows_equal_a_loop(lengths, seconds, hop, rate):
    arrays = [
        np.random.default_rng(n).integers(0, 999, (n, 2, 3)).astype(np.uint16) for n in lengths
    ]
    corpus = corpus_of(arrays, rate=rate)[
        np.random.default_rng(len(lengths)).permutation(len(lengths))
    ]
    frames = max(1, round(seconds * rate))
    step = max(1, round(hop * rate)) if hop else math.ceil(frames / 2)
    expected = []
    for i, begin in itertools.product(range(len(corpus)), range(0, 60, step)):
        if begin == 0 or begin + frames <= len(corpus[i]):
            expected.append((corpus.index[i], begin, corpus[i][begin : begin + frames]))
    made = Windows(seconds, hop)(corpus)
    assert [*zip(made.index, made.piece, strict=True)] == [
        (index, begin) for index, begin, _ in expected
    ]
    assert all(map(np.array_equal, made, (part for *_, part in expected)))
    assert shared_frames(made)[0] is shared_frames(corpus)[0]


def with_broken(seed, grid):
    """Random captures with taxels that never change, change at first, or read full scale."""
    rng = np.random.default_rng(seed)
    arrays = [rng.integers(0, 1023, (length, *grid)) for length in rng.integers(1, 40, 3)]
    for frames in arrays:
        for row, col in np.ndindex(grid):
            until = [0, 0, 0, len(frames), rng.integers(len(frames) + 1)][rng.integers(5)]
            frames[:until, row, col] = rng.choice([0, 400, 1022, 1023])
    return arrays


def beside(values):
    """Sum over the eight taxels around each one."""
    return convolve(values.astype(float), [[1, 1, 1], [1, 0, 1], [1, 1, 1]], mode="constant")


def naive_repair(frames, kinds, full_scale, rate):
    """Frame by frame, each from the frames before."""
    out = []
    for t, now in enumerate(frames.astype(float)):
        still = (frames[: t + 1] == frames[0]).all(axis=0)
        long = still & (t + 1 >= max(2, math.ceil(0.25 * rate)))
        sound = np.ones_like(still)
        if "stuck" in kinds:
            sound &= frames[: t + 1].min(axis=0) < full_scale
            sound &= ~long | (now <= (now[~still].max() if not still.all() else np.inf))
        if "dead" in kinds:
            sound &= ~long | (beside(~still) <= beside(np.ones_like(now)) / 2)
        values = np.where(sound, now, 0)
        for _ in range(3):
            filled = ~sound & (beside(sound) > 0)
            values = np.where(filled, beside(values) / np.maximum(beside(sound), 1), values)
            sound |= filled
        out.append(values)
    if "offset" in kinds:
        out = [out[t] - np.min(out[: t + 1], axis=0) for t in range(len(out))]
    return naive_denoising(np.array(out)) if "noise" in kinds else out


def naive_denoising(frames):
    """Frame by frame, reading by reading, two frames late."""
    out = []
    for t, now in enumerate(frames):
        steps = np.diff(frames[max(t - 32, 0) : t + 1], axis=0)
        steps = (steps**2 / 2).mean(axis=0) if t else np.zeros_like(now)
        lines = sorted([*steps.mean(axis=1), *steps.mean(axis=0)])
        noise = lines[(len(lines) - 1) // 4]
        denoised = np.empty_like(now)
        for row, col in np.ndindex(now.shape):
            rows, cols = (slice(max(place - 1, 0), place + 2) for place in (row, col))
            values = frames[max(t - 4, 0) : t + 1, rows, cols]
            share = max(1 - noise / values.var(), 0) if values.var() > 1e-9 else 0
            middle = frames[max(t - 2, 0), row, col]
            denoised[row, col] = values.mean() + share * (middle - values.mean())
        out.append(denoised)
    return out


def test_noise_is_taken_out_and_touch_stays():
    rng = np.random.default_rng(0)
    time, row, col = np.ogrid[:120, :8, :8]
    centre = 3.5 + 3 * np.sin(time / 10)
    touch = 40 * np.exp(-((row - centre) ** 2 + (col - 3.5) ** 2) / 4)
    noisy = touch + rng.normal(0, 10, touch.shape)
    corpus = corpus_of([frames.astype(np.float32) for frames in (touch, noisy)])
    quiet, denoised = (frames[22:] for frames in Repair(("noise",))(corpus))
    assert np.abs(quiet - touch[20:-2]).mean() < 0.3
    assert np.sqrt(np.mean((denoised - touch[20:-2]) ** 2)) < 5  # of 10


@given(
    st.integers(0, 10_000),
    st.sampled_from([(4, 4), (1, 5), (1, 1)]),
    st.sampled_from([("stuck",), ("dead",), ("noise",), ("offset",), REPAIRS]),
    st.sampled_from([1.0, 12.0]),
    st.sampled_from([np.uint16, np.float32]),
)
def test_repair_equals_a_loop(seed, grid, kinds, rate, kind):
    arrays = [frames.astype(kind) for frames in with_broken(seed, grid)]
    for one, frames in zip(Repair(kinds)(corpus_of(arrays, rate=rate)), arrays, strict=True):
        np.testing.assert_allclose(
            one, naive_repair(frames, kinds, 1023, rate), rtol=1e-5, atol=1e-3
        )


@given(st.integers(0, 10_000), st.sampled_from([(3, 5), (1, 1)]), st.sampled_from([1023.0, 0.7]))
def test_scaling_to_the_peak_equals_a_loop(seed, grid, full_scale):
    rng = np.random.default_rng(seed)
    arrays = [
        rng.random((n, *grid)) * (rng.random((n, 1, 1)) < 0.6) * full_scale for n in (1, 2, 20)
    ]
    arrays = [
        a.astype(np.float32) if full_scale < 1 else np.rint(a).astype(np.uint16) for a in arrays
    ]
    found = Scale("peak")(corpus_of(arrays, full_scale=full_scale))
    for one, frames in zip(found, arrays, strict=True):
        expected = [
            frames[t] * (full_scale / (float(frames[: t + 1].max()) or 1))
            for t in range(len(frames))
        ]
        np.testing.assert_allclose(one, expected, rtol=1e-6)
    assert found.frames.dtype == np.float32 and found.frames.max() <= np.float32(
        full_scale
    )  # also after rounding


def test_logarithmic_readings_by_hand():
    (found,) = Scale("log")(corpus_of([np.array([[[0, 255, 1023]]], dtype=np.uint16)]))
    by_hand = [0, 1023 * np.log(1 + 1000 * 255 / 1023) / np.log(1001), 1023]
    assert found.dtype == np.float32 and found.ravel() == pytest.approx(by_hand, rel=1e-6)
    (same,) = Scale("log")(
        corpus_of([np.array([[[-0.5, 0.25, 2.0]]], dtype=np.float32)], full_scale=1.0)
    )
    assert same.ravel() == pytest.approx(
        [0, np.log(251) / np.log(1001), 1], rel=1e-6
    )  # in shares; none beyond 0 to 1


def test_originals_stay_and_copies_equal_the_fault_at_the_drawn_severity():
    corpus = random_corpus(subjects=2)
    names = ("noise", "shift", "early_end", "stuck_taxels")
    step = DamagedCopies(names, 3)
    made = step(corpus)
    assert made.piece.tolist() == [copy * COPY for _ in corpus for copy in range(4)]
    assert all(map(np.array_equal, corpus, made[::4]))
    drawn = set()
    for i, copy in np.ndindex(len(corpus), 3):
        rng = step.copy_generator(i, copy)
        name, severity = names[rng.integers(len(names))], int(rng.integers(5))
        shares = corpus[i].astype(np.float32) / np.float32(1023)
        expected = FAULTS[name].damage(shares, FAULTS[name].amounts[severity], rng) * np.float32(
            1023
        )
        assert np.array_equal(made[4 * i + copy + 1], np.rint(expected).clip(0, 1023))
        drawn.add((name, severity))
    assert len(drawn) > 15  # of 20


def test_no_test_capture_meets_the_draws_of_a_training_copy():
    def first(rng):
        return rng.bit_generator.state["state"]["state"]

    test = {
        first(f.make_generator("1", i)) for f in FAULTS.values() if not f.sensor for i in range(50)
    }
    test |= {
        first(f.make_generator(str(s), 0))
        for f in FAULTS.values()
        if f.sensor
        for s in range(1, 50)
    }
    training = [
        first(DamagedCopies(("noise",), 9).copy_generator(i, copy))
        for i in range(50)
        for copy in range(9)
    ]
    assert len(set(training)) == 450 and not test & set(training)


@pytest.mark.parametrize("step", STEPS, ids=repr)
def test_what_is_made_of_a_capture_depends_on_it_alone(step):
    corpus = random_corpus(grid=(3, 4))[np.array([11, 3, 7, 30])]
    made, rows = step(corpus), step.source_rows(corpus)
    assert np.array_equal(corpus.index[rows], made.index) and made.steps == (step,)
    assert made.captures.equals(corpus.captures.iloc[rows].reset_index(drop=True))
    assert len(set(zip(made.index, made.piece, strict=True))) == len(
        made
    )  # what a kept table is read by
    for i in range(4):
        assert all(map(np.array_equal, step(corpus[i : i + 1]), made[np.flatnonzero(rows == i)]))
    none = step(corpus[np.array([], dtype=int)])
    assert len(none) == len(none.captures) == len(none.piece) == 0 and none.grid == (3, 4)


@pytest.mark.parametrize(("grid", "others"), [((4, 4), 7), ((3, 5), 3), ((1, 3), 1), ((1, 1), 0)])
def test_turned_copies_lie_otherwise_in_all_frames_alike_and_every_way_occurs(grid, others):
    rng = np.random.default_rng(0)
    arrays = [
        rng.integers(0, 1023, (int(n), *grid)).astype(np.uint16) for n in rng.integers(1, 9, 30)
    ]
    made = TurnedCopies(4)(corpus_of(arrays))
    seen = set()
    for i, frames in enumerate(arrays):
        turns = [frames, frames.transpose(0, 2, 1)] if grid[0] == grid[1] else [frames]
        ways = [f[:, ::up, ::left].tobytes() for f in turns for up in (1, -1) for left in (1, -1)]
        turned = [ways.index(made[5 * i + copy].tobytes()) for copy in range(5)]
        assert turned[0] == 0 and len(set(turned[1:])) == min(
            4, max(1, others)
        )  # alike only where there is no other
        seen |= set(turned[1:])
    assert seen == (set(range(1, others + 1)) or {0})
