"""Each fault against numbers worked out by hand, and what all of them must keep."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora import fault_names, faults
from bench.corpora.faults import FAULTS, SEVERITIES, as_shares, damage_captures, fault
from tests.conftest import random_corpus

ALL = list(FAULTS.values())


class Luck:
    """A generator that draws what a test wants."""

    def __init__(self, **draws):
        self.draws = draws

    def __getattr__(self, name):
        return lambda *_, **__: self.draws[name]


RAMP = (np.arange(6)[:, None, None] / 10).astype(np.float32)  # 0, 0.1, ... 0.5 on one taxel
FOUR = [[[0.1, 0.11], [0.12, 0.13]]]
SIX = [[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]]
TAPS = [[[0.05, 0.1], [0.2, 1]]]
STILL = np.full((5, 1, 1), 0.5)
STEADY = np.float32([0.2, 0.22, 0.2, 0.22, 1])[:, None, None]
LEVELS = np.float32([0, 0, 0.5, 1])[:, None, None]
LUCK = np.array([0.9, 0.1, 0.39, 0.4, 0.5, 0.0])
HALF = np.sqrt(0.5)
WIDE = np.full((1, 4, 8), 0.5)
NOISY = np.pad(np.full((1, 2, 4), 0.02), ((0, 0), (0, 2), (4, 0))) + 0.5
SIDE = np.exp(-(np.arange(-3, 4.0) ** 2) / 0.5)  # 3 taxels are 6 SD: nothing is left beyond
NEAR = 1 / np.exp(-(np.arange(-9, 10.0) ** 2) / 2).sum()  # of a row of one taxel

BY_HAND = [  # fault, amount, frames, draws, damaged frames
    # 40 % of 4 rounds up to 2, and it is never less than one
    ("dead_taxels", 40, FOUR, {"permutation": np.array([2, 0, 1, 3])}, [[[0, 0.11], [0, 0.13]]]),
    ("stuck_taxels", 1, FOUR, {"permutation": np.array([3, 0, 1, 2])}, [[[0.1, 0.11], [0.12, 1]]]),
    # row 1 and column 2
    (
        "dead_lines",
        40,
        SIX,
        {"permutation": np.array([1, 4, 0, 2, 3])},
        [[[0.1, 0.2, 0], [0, 0, 0]]],
    ),
    ("saturation", 90, TAPS, {}, [[[0.05, 0.1], [0.1, 0.1]]]),
    (
        "noise",
        10,
        TAPS,
        {"standard_normal": np.float32([[[-1, 1], [2, 1]]])},
        [[[0, 0.2], [0.4, 1]]],
    ),
    ("fewer_bits", 2, [[[0, 0.16, 0.17, 0.5, 0.84, 1]]], {}, [[[0, 0, 1 / 3, 2 / 3, 1, 1]]]),
    # a quarter of a period a frame
    ("vibration", 10, STILL, {"random": 0.0, "rate_hz": 12.0}, [0.5, 0.6, 0.5, 0.4, 0.5]),
    # 0.1 % in the ten seconds of a frame
    ("drift", 36, STILL, {"rate_hz": 0.1}, [0.5, 0.501, 0.502, 0.503, 0.504]),
    # a quarter of the taxels is half of each side; it begins at row 0, column 4
    (
        "noisy_region",
        25,
        WIDE,
        {"random": [0.2, 0.99], "standard_normal": np.ones((1, 4, 8), np.float32)},
        NOISY,
    ),
    ("dropped_frames", 40, RAMP, {"random": LUCK}, [0, 0.3, 0.4]),
    ("dropped_frames", 60, RAMP, {"random": LUCK / 2}, [0]),  # the luckiest one arrives
    # at rest in four frames, whose SD is 0.02 / sqrt(2); then still, in steps of 0.5
    (
        "own_noise",
        2,
        STEADY,
        {"standard_normal": np.ones((5, 1, 1), np.float32)},
        np.minimum(STEADY + 0.04 * HALF, 1),
    ),
    (
        "own_noise",
        2,
        LEVELS,
        {"standard_normal": np.ones((4, 1, 1), np.float32)},
        np.minimum(LEVELS + 1 / np.sqrt(12), 1),
    ),
    ("doubled_frames", 40, RAMP, {"random": LUCK}, [0, 0.1, 0.1, 0.2, 0.2, 0.3, 0.4, 0.5, 0.5]),
    ("lower_rate", 4, RAMP, {}, [0, 0, 0, 0, 0.4, 0.4]),
    ("late_start", 40, RAMP, {}, [0.2, 0.3, 0.4, 0.5]),  # 2.4 frames, that is 2
    ("early_end", 40, RAMP, {}, [0, 0.1, 0.2, 0.3]),
    ("late_start", 80, RAMP[:1], {}, [0]),
    ("early_end", 80, RAMP[:1], {}, [0]),
    # moments 0, 1.5, 1, 3, 4.5, 5, put in order
    (
        "time_jitter",
        0.5,
        RAMP,
        {"standard_normal": np.array([-1, 1, -2, 0, 1, 3])},
        [0, 0.1, 0.15, 0.3, 0.45, 0.5],
    ),
    ("shift", 1, SIX, {"uniform": 0.0}, [[[0, 0.1, 0.2], [0, 0.4, 0.5]]]),  # to the right
    ("shift", 0.5, SIX, {"uniform": np.pi / 2}, [[[0.05, 0.1, 0.15], [0.25, 0.35, 0.45]]]),
    ("rotation", 90, TAPS, {"choice": 1}, np.rot90(TAPS, -1, (1, 2))),
    ("rotation", 90, TAPS, {"choice": -1}, np.rot90(TAPS, 1, (1, 2))),
    # Taxel (0, 2) reads 0.414 above the pressed taxel; (0, 1) and (1, 2) read beside it.
    (
        *("rotation", 45, np.pad([[[1.0]]], ((0, 0), (0, 2), (1, 1))), {"choice": 1}),
        [[[0, HALF * (1 - HALF), 2 - 2 * HALF], [0, 0, HALF * (1 - HALF)], [0, 0, 0]]],
    ),
    (
        "smaller_grid",
        50,
        np.ones((1, 4, 8)),
        {},
        np.pad(np.ones((1, 2, 4)), ((0, 0), (1, 1), (2, 2))),
    ),
    ("smaller_grid", 75, np.ones((1, 1, 2)), {}, [[[1, 0]]]),
    (
        "cover",
        0.5,
        np.pad([[[1.0]]], ((0, 0), (3, 3), (3, 3))),
        {},
        [np.outer(SIDE, SIDE) / SIDE.sum() ** 2],
    ),
    ("cover", 1, np.ones((1, 1, 2)), {}, [[[NEAR * NEAR * (1 + np.exp(-0.5))] * 2]]),
]


@pytest.mark.parametrize(
    ("name", "amount", "frames", "draws", "expected"), BY_HAND, ids=[one[0] for one in BY_HAND]
)
def test_a_fault_by_hand(name, amount, frames, draws, expected):
    frames, draws = np.asarray(frames, np.float32), dict(draws)
    time = {"rate_hz": draws.pop("rate_hz")} if "rate_hz" in draws else {}
    after = FAULTS[name].damage(frames, amount, Luck(**draws), **time)
    np.testing.assert_allclose(
        after, np.reshape(expected, (-1, *frames.shape[1:])), rtol=1e-5, atol=1e-6
    )


def test_gain_and_offset_drift_by_hand():
    taxels = np.array([[0.0, 1.0], [-1.0, 3.0]])

    class Drift(Luck):
        def standard_normal(self, size=None):
            return 1.0 if size is None else taxels

    frames = np.full((1, 2, 2), 0.25, np.float32)
    gained = FAULTS["gain_drift"].damage(frames, 40, Drift())
    assert np.allclose(gained, np.minimum(0.25 * np.exp(0.4 * (1 + taxels) / np.sqrt(2)), 1))
    moved = FAULTS["offset_drift"].damage(frames, 50, Drift())
    assert np.allclose(moved, [[[0.25 + 0.5 * HALF, 0.25 + HALF], [0.25, 1]]])


def test_every_fault_is_worked_out_by_hand():
    assert {one[0] for one in BY_HAND} | {"gain_drift", "offset_drift"} == {*FAULTS}


@pytest.mark.parametrize("one", ALL, ids=lambda f: f.name)
@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 5), st.integers(1, 5)),
    severity=st.integers(1, SEVERITIES),
    seed=st.integers(0, 2**16),
    levels=st.sampled_from([0, 1, 9]),
)
def test_any_grid_and_length_stays_a_capture(one, shape, severity, seed, levels):
    frames = (np.random.default_rng(seed).integers(0, levels + 1, shape) / max(levels, 1)).astype(
        np.float32
    )
    before = frames.copy()
    after = one.apply(frames, severity, str(seed), seed, 50.0)
    assert np.array_equal(frames, before)
    assert (
        after.dtype == np.float32
        and after.shape[1:] == shape[1:]
        and 1 <= len(after) <= 2 * len(frames)
    )
    assert one.shortens or one.moves or len(after) == len(frames)
    assert after.min() >= 0 and after.max() <= 1  # no nan either
    nothing = replace(one, amounts=(0,) * SEVERITIES)
    assert np.array_equal(nothing.apply(frames, severity, str(seed), seed, 50.0), frames)
    assert one.apply(frames, 0, str(seed), seed, 50.0) is frames and one.describe(0) == ""


@pytest.mark.parametrize("kind", ["uint16", "float32"])
def test_damage_depends_on_the_capture_alone_and_no_cache_knows_the_damaged_corpus(kind, tmp_path):
    corpus = random_corpus(full_scale=1023.0).with_fields(digest="abc", path=tmp_path)
    if kind == "float32":
        corpus = corpus.with_fields(frames=corpus.frames.astype(np.float32) / 7)
    corpus, test = corpus[np.arange(10, 36)], np.array([5, 2, 25])  # as where= leaves it
    for name, severity in (("noise", 0), ("dropped_frames", 5), ("dead_taxels", 3)):
        worse = damage_captures(corpus, test, as_shares(corpus, test), FAULTS[name], severity)
        assert not worse.digest and worse.path is None and worse.frames.dtype == kind
        assert np.array_equal(worse.index, corpus.index) and np.array_equal(
            worse.gestures, corpus.gestures
        )
        for i in map(int, test):
            shares = corpus[i].astype(np.float32) / np.float32(1023)
            expected = FAULTS[name].apply(
                shares, severity, corpus.subjects[i], i + 10, 100.0
            ) * np.float32(1023)
            assert np.array_equal(worse[i], np.rint(expected) if kind == "uint16" else expected)


def test_help_names_every_fault():
    assert [*fault_names.FAULT_NAMES] == [f.name for f in ALL if not f.later]
    assert [*fault_names.MORE_FAULT_NAMES] == [f.name for f in ALL if f.later]
    assert [*fault_names.SHORTENING_FAULTS] == [f.name for f in ALL if f.shortens]


def test_a_fault_of_ones_own_is_one_function(monkeypatch):
    monkeypatch.setattr(faults, "FAULTS", dict(FAULTS))

    @fault("% darker", 10, 20, 30, 40, 50)
    def dusk(frames, amount, rng):
        return frames * np.float32(1 - amount / 100)

    known = faults.FAULTS["dusk"]
    assert known.describe(2) == "20 % darker"
    assert known.apply(np.ones((1, 1, 1), np.float32), 2, "1", 1, 50.0) == pytest.approx(0.8)
