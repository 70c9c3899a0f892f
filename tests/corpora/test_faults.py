"""Each fault against numbers worked out by hand, and what all of them must keep."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench import words
from bench.corpora import faults
from bench.corpora.faults import FAULTS, SEVERITIES, as_shares, damaged, fault
from tests.conftest import random_corpus

ALL = list(FAULTS.values())


class Luck:
    """A generator that draws what a test wants."""

    def __init__(self, **draws):
        self.draws = draws

    def __getattr__(self, name):
        return lambda *_, **__: self.draws[name]


def ramp(frames=4, rows=2, cols=2):
    """Frame t has t/10 + 0.01 per taxel in reading order."""
    taxels = np.arange(rows * cols).reshape(rows, cols) / 100
    return (np.arange(frames)[:, None, None] / 10 + taxels).astype(np.float32)


def under(name, frames, amount, **draws):
    time = {"rate_hz": draws.pop("rate_hz")} if "rate_hz" in draws else {}
    return FAULTS[name].damage(np.asarray(frames, np.float32), amount, Luck(**draws), **time)


def test_dead_and_stuck_taxels():
    frames = ramp()
    dead = under("dead_taxels", frames, 40, permutation=np.array([2, 0, 1, 3]))  # 40 % of 4 rounds up to 2
    assert np.array_equal(dead[1], np.float32([[0, 0.11], [0, 0.13]]))
    stuck = under("stuck_taxels", frames, 1, permutation=np.array([3, 0, 1, 2]))  # never less than one
    assert np.array_equal(stuck[1], np.float32([[0.1, 0.11], [0.12, 1]]))


def test_dead_lines():
    lines = under("dead_lines", ramp(1, 2, 3) + 0.5, 40, permutation=np.array([1, 4, 0, 2, 3]))  # row 1 and column 2
    assert np.allclose(lines, [[[0.5, 0.51, 0], [0, 0, 0]]])


def test_gain_and_offset_drift():
    taxels = np.array([[0.0, 1.0], [-1.0, 3.0]])

    class Drift(Luck):
        def standard_normal(self, size=None):
            return 1.0 if size is None else taxels

    frames = np.full((1, 2, 2), 0.25, np.float32)
    gained = FAULTS["gain_drift"].damage(frames, 40, Drift())
    assert np.allclose(gained, np.minimum(0.25 * np.exp(0.4 * (1 + taxels) / np.sqrt(2)), 1))
    moved = FAULTS["offset_drift"].damage(frames, 50, Drift())
    assert np.allclose(moved, [[[0.25 + 0.5 / np.sqrt(2), 0.25 + 1 / np.sqrt(2)], [0.25, 1]]])


def test_saturation_noise_and_fewer_bits():
    frames = [[[0.05, 0.1], [0.2, 1]]]
    assert np.allclose(under("saturation", frames, 90), [[[0.05, 0.1], [0.1, 0.1]]])
    noisy = under("noise", frames, 10, standard_normal=np.float32([[[-1, 1], [2, 1]]]))
    assert np.allclose(noisy, [[[0, 0.2], [0.4, 1]]])
    coarse = under("fewer_bits", [[[0, 0.16, 0.17, 0.5, 0.84, 1]]], 2)
    assert np.allclose(coarse, [[[0, 0, 1 / 3, 2 / 3, 1, 1]]])


def test_vibration_drift_and_a_noisy_region():
    still = np.full((5, 1, 2), 0.5)
    swung = under("vibration", still, 10, random=0.0, rate_hz=12.0)[:, 0, 1]  # a quarter of a period a frame
    assert np.allclose(swung, [0.5, 0.6, 0.5, 0.4, 0.5], atol=1e-6)
    risen = under("drift", still, 36, rate_hz=0.1)[:, 0, 1]  # 0.1 % in the ten seconds of a frame
    assert np.allclose(risen, [0.5, 0.501, 0.502, 0.503, 0.504], atol=1e-6)
    wide = np.full((1, 4, 8), 0.5)  # a quarter of the taxels is half of each side; it begins at row 0, column 4
    noisy = under("noisy_region", wide, 25, random=[0.2, 0.99], standard_normal=np.ones((1, 4, 8), np.float32))
    expected = wide.copy()
    expected[:, :2, 4:] += 0.02
    assert np.allclose(noisy, expected)


def test_faults_in_time():
    frames = ramp(6, 1, 1)  # 0, 0.1, ... 0.5
    luck = np.array([0.9, 0.1, 0.39, 0.4, 0.5, 0.0])

    def values(name, amount, frames=frames, **draws):
        return under(name, frames, amount, **draws).ravel().round(6).tolist()

    assert values("dropped_frames", 40, random=luck) == pytest.approx([0, 0.3, 0.4])
    assert values("dropped_frames", 60, random=luck / 2) == pytest.approx([0])  # the luckiest one arrives
    assert values("lower_rate", 4) == pytest.approx([0, 0, 0, 0, 0.4, 0.4])
    assert values("late_start", 40) == pytest.approx([0.2, 0.3, 0.4, 0.5])  # 2.4 frames, that is 2
    assert values("early_end", 40) == pytest.approx([0, 0.1, 0.2, 0.3])
    assert values("late_start", 80, frames[:1]) == values("early_end", 80, frames[:1]) == [0]
    jittered = values("time_jitter", 0.5, standard_normal=np.array([-1, 1, -2, 0, 1, 3]))
    assert jittered == pytest.approx([0, 0.1, 0.15, 0.3, 0.45, 0.5])  # moments 0, 1.5, 1, 3, 4.5, 5, put in order


def test_shift_and_rotation():
    frames = np.float32([[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]])
    assert np.allclose(under("shift", frames, 1, uniform=0.0), [[[0, 0.1, 0.2], [0, 0.4, 0.5]]])  # to the right
    down = under("shift", frames, 0.5, uniform=np.pi / 2)
    assert np.allclose(down, [[[0.05, 0.1, 0.15], [0.25, 0.35, 0.45]]])
    square = np.float32([[[0.1, 0.2], [0.3, 0.4]]])
    assert np.allclose(under("rotation", square, 90, choice=1), np.rot90(square, -1, (1, 2)))
    assert np.allclose(under("rotation", square, 90, choice=-1), np.rot90(square, 1, (1, 2)))
    corner = under("rotation", [[[0, 1, 0], [0, 0, 0], [0, 0, 0]]], 45, choice=1)
    # Taxel (0, 2) reads 0.414 above the taxel pressed, beyond the edge; (0, 1) and (1, 2) read beside it.
    half = np.sqrt(0.5)
    beside = half * (1 - half)
    assert np.allclose(corner, [[[0, beside, 2 - 2 * half], [0, 0, beside], [0, 0, 0]]], atol=1e-6)


def test_a_smaller_grid_and_a_cover():
    middle = np.pad(np.ones((2, 4)), ((1, 1), (2, 2)))
    assert np.array_equal(under("smaller_grid", np.ones((1, 4, 8)), 50)[0], middle)
    assert under("smaller_grid", np.ones((1, 1, 2)), 75).sum() == 1
    spread = under("cover", np.pad(np.ones((1, 1, 1)), ((0, 0), (3, 3), (3, 3))), 0.5)[0]
    side = np.exp(-(np.arange(-3, 4.0) ** 2) / 0.5)
    side /= side.sum()  # 3 taxels are 6 SD: nothing is left beyond
    assert np.allclose(spread, np.outer(side, side), atol=1e-6)
    lost = under("cover", np.ones((1, 1, 2)), 1)[0, 0]
    near = 1 / np.exp(-(np.arange(-9, 10.0) ** 2) / 2).sum()
    assert np.allclose(lost, near * near * (1 + np.exp(-0.5)))  # a row of one taxel keeps the share `near`


@pytest.mark.parametrize("one", ALL, ids=lambda f: f.name)
@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 5), st.integers(1, 5)),
    severity=st.integers(1, SEVERITIES),
    seed=st.integers(0, 2**16),
    levels=st.sampled_from([0, 1, 9]),
)
def test_any_grid_and_length_stays_a_capture(one, shape, severity, seed, levels):
    frames = (np.random.default_rng(seed).integers(0, levels + 1, shape) / max(levels, 1)).astype(np.float32)
    before = frames.copy()
    after = one.apply(frames, severity, str(seed), seed, 50.0)
    assert np.array_equal(frames, before)
    assert after.dtype == np.float32 and after.shape[1:] == shape[1:] and 1 <= len(after) <= len(frames)
    assert one.shortens or len(after) == len(frames)
    assert after.min() >= 0 and after.max() <= 1  # no nan either
    nothing = replace(one, amounts=(0,) * SEVERITIES)
    assert np.array_equal(nothing.apply(frames, severity, str(seed), seed, 50.0), frames)
    assert one.apply(frames, 0, str(seed), seed, 50.0) is frames and one.describe(0) == ""


@pytest.mark.parametrize("one", ALL, ids=lambda f: f.name)
def test_a_capture_meets_the_same_damage_in_any_company(one):
    corpus = random_corpus()

    def frames_of(corpus, test, position):
        return damaged(corpus, test, as_shares(corpus, test), one, 3)[position]

    together = frames_of(corpus, np.array([30, 4, 17, 5]), 17)
    part = corpus[np.arange(10, 36)]  # as where= leaves it
    assert np.array_equal(together, frames_of(part, np.array([7]), 7))


@pytest.mark.parametrize("kind", ["uint16", "float32"])
def test_a_damaged_corpus_is_one_that_no_cache_knows(kind, tmp_path):
    corpus = random_corpus(full_scale=1023.0).changed(digest="abc", path=tmp_path)
    if kind == "float32":
        corpus = corpus.changed(frames=corpus.frames.astype(np.float32) / 7)
    test = np.array([5, 2, 35])
    for name, severity in (("noise", 0), ("dropped_frames", 5)):
        worse = damaged(corpus, test, as_shares(corpus, test), FAULTS[name], severity)
        assert not worse.digest and worse.path is None and worse.frames.dtype == kind
        assert np.array_equal(worse.index, corpus.index) and np.array_equal(worse.gestures, corpus.gestures)
        for i in map(int, test):
            shares = corpus[i].astype(np.float32) / np.float32(1023)
            expected = FAULTS[name].apply(shares, severity, corpus.subjects[i], i, corpus.rate_hz) * np.float32(1023)
            assert np.array_equal(worse[i], np.rint(expected) if kind == "uint16" else expected)


def test_help_names_every_fault():
    assert words.FAULTS.split() == [f.name for f in ALL if not f.later]
    assert words.LATER.split() == [f.name for f in ALL if f.later]
    assert words.LOSSY.split() == [f.name for f in ALL if f.shortens]


def test_a_fault_of_ones_own_is_one_function(monkeypatch):
    monkeypatch.setattr(faults, "FAULTS", dict(FAULTS))

    @fault("% darker", 10, 20, 30, 40, 50)
    def dusk(frames, amount, rng):
        return frames * np.float32(1 - amount / 100)

    assert list(faults.all_faults()) == [*FAULTS, "dusk"]
    known = faults.all_faults()["dusk"]
    assert known.describe(2) == "20 % darker"
    assert known.apply(np.ones((1, 1, 1), np.float32), 2, "1", 1, 50.0) == pytest.approx(0.8)
