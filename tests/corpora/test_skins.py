"""Captures brought to another skin: against averages and lines drawn by hand."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.skins import OWN, SOURCE, brought, joined, regridded, resampled, scaled, weights
from bench.errors import InputError
from tests.conftest import random_corpus


@given(st.integers(1, 30), st.integers(1, 30))
def test_what_is_the_same_everywhere_stays_so_and_no_weight_is_negative(count, wanted):
    found = weights(count, wanted)
    assert found.shape == (wanted, count) and (found >= 0).all()
    np.testing.assert_allclose(found.sum(axis=1), 1)
    if count == wanted:
        assert np.array_equal(found, np.eye(count))
    np.testing.assert_allclose(weights(count, wanted)[::-1, ::-1], found, atol=1e-12)  # no side is favoured


@given(st.integers(1, 12), st.integers(1, 5))
def test_fewer_values_are_means_and_nothing_is_lost_on_average(wanted, times):
    values = np.random.default_rng(wanted).random(wanted * times)
    np.testing.assert_allclose(weights(len(values), wanted) @ values, values.reshape(wanted, times).mean(axis=1))
    ragged = np.random.default_rng(times).random(wanted + times)
    np.testing.assert_allclose((weights(len(ragged), wanted) @ ragged).mean(), ragged.mean())


@given(st.integers(1, 12), st.integers(0, 20))
def test_more_values_lie_on_lines_between_the_middles(count, more):
    wanted = count + more
    values = np.random.default_rng(count).random(count)
    by_hand = np.interp((np.arange(wanted) + 0.5) / wanted, (np.arange(count) + 0.5) / count, values)
    np.testing.assert_allclose(weights(count, wanted) @ values, by_hand)


@given(st.integers(1, 40), st.floats(0.05, 8))
def test_frames_are_resampled_as_the_weights_say(count, times):
    frames = np.random.default_rng(count).random((count, 2, 3))
    found = resampled(frames, 1.0, times)
    expected = np.einsum("ij,jkl->ikl", weights(count, len(found)), frames)
    assert len(found) == max(1, round(count * times))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_long_capture_needs_no_more_memory_than_it_is():
    long = np.ones((200_000, 1, 1), dtype=np.float32)
    assert (resampled(long, 100.0, 54.0) == 1).all() and len(resampled(long, 100.0, 154.0)) == 308_000


def test_warnings_of_both_are_kept():
    own, source = random_corpus(3, 4, longest=30), other_skin()
    names = sorted(set(own.gestures))
    own.info["warnings"], source.info["warnings"] = ["own"], ["theirs"]
    assert joined(own, source, {"PAT": names[0], "rub": names[1]}).info["warnings"] == ["own", "other: theirs"]


def test_three_into_two_by_hand():
    np.testing.assert_allclose(weights(3, 2), [[2 / 3, 1 / 3, 0], [0, 1 / 3, 2 / 3]])


def test_a_rate_and_a_grid_by_hand():
    frames = np.arange(4 * 2 * 4, dtype=np.uint16).reshape(4, 2, 4)
    halved = resampled(frames, 100.0, 50.0)
    np.testing.assert_allclose(halved, frames.reshape(2, 2, 2, 4).mean(axis=1))
    assert halved.dtype == np.float32 and len(resampled(frames, 100.0, 1.0)) == 1
    coarse = regridded(frames, 1, 2)
    np.testing.assert_allclose(coarse, frames.reshape(4, 1, 2, 2, 2).mean(axis=(2, 4)))
    assert np.array_equal(regridded(frames, 2, 4), frames)
    np.testing.assert_allclose(scaled(frames, 31.0, 1.0).max(), 1.0)


def test_there_and_back_a_finer_skin_loses_nothing_but_corners():
    """Whole multiples: means of what lines have made of a slope are the slope again, but for the flat ends."""
    slope = np.linspace(0, 1, 20)[:, None, None] * np.ones((1, 2, 2))
    back = resampled(resampled(slope, 50.0, 100.0), 100.0, 50.0)
    np.testing.assert_allclose(back[1:-1], slope[1:-1], atol=1e-6)


def other_skin():
    """Two people whose classes are called otherwise, on 4 x 5 taxels at 40 Hz, up to 1."""
    rng = np.random.default_rng(0)
    about = [(who, name) for who in ("1", "2") for name in ("PAT", "rub", "knock")]
    arrays = [rng.random((n, 4, 5)).astype(np.float32) for n in (8, 9, 10, 11, 12, 13)]
    captures = pd.DataFrame(about, columns=["subject", "gesture"])
    return Corpus.from_captures(arrays, captures, 40.0, full_scale=1.0, name="other")


def test_both_are_brought_to_the_coarser_of_each():
    own = random_corpus(3, 4, longest=30).changed(rate_hz=100.0)
    names = sorted(set(own.gestures))
    source = other_skin()
    found = joined(own, source, {"PAT": names[0], "rub": names[1]})
    assert found.rate_hz == 40.0 and found.grid == (4, 5) and found.full_scale == own.full_scale
    mine = found.captures["skin"] == OWN
    kept = np.flatnonzero(np.isin(own.gestures, names[:2]))
    assert found.gestures[mine].tolist() == own.gestures[kept].tolist()
    assert found.subjects[mine].tolist() == own.subjects[kept].tolist()
    assert found.gestures[~mine].tolist() == [names[0], names[1]] * 2
    assert not set(found.subjects[mine]) & set(found.subjects[~mine])
    assert found.captures["skin"].tolist() == [OWN] * mine.sum() + [SOURCE] * 4
    first = found[int(np.flatnonzero(~mine)[0])]
    np.testing.assert_allclose(first, source[0] * own.full_scale, rtol=1e-6)
    np.testing.assert_allclose(found[0], brought(own[kept[:1]], 40.0, (4, 5), own.full_scale)[0])


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({}, "share 0 classes"),
        ({"PAT": "nothing"}, "has no 'nothing'"),
        ({"slap": "pat"}, "other has no 'slap'"),
    ],
)
def test_classes_that_are_not_there_are_one_line(names, said):
    own = random_corpus(3, 4, longest=30)
    source = other_skin()
    source.captures["gesture"] = source.captures["gesture"].replace("rub", "Rub")
    with pytest.raises(InputError, match=said):
        joined(own, source, names)


@pytest.mark.parametrize(
    ("kind", "full_scale"), [("uint16", 1023.0), ("float32", 1023.0), ("uint16", 4095.0), ("shares", 1.0)]
)
def test_a_recording_is_found_in_the_other_corpus_in_other_numbers(kind, full_scale):
    own, other = random_corpus(subjects=2), list(random_corpus(subjects=2, seed=5))
    other[5] = own[7]
    arrays = [(a / 1023).astype(np.float32) if kind == "shares" else a.astype(kind) for a in other]
    source = Corpus.from_captures(arrays, own.captures, 50.0, name="other", full_scale=full_scale)
    with pytest.raises(InputError) as refused:
        joined(own, source, {})
    assert str(refused.value) == (
        "protocol=transfer: random and other have the same captures: 1, such as capture 7 (subject 1, gesture tap) and "
        "capture 5 (subject 1, gesture rub); name another source"
    )


def test_no_touch_on_a_quiet_sensor_is_no_recording_that_both_have():
    still = np.zeros((20, 8, 8), np.uint16)
    corpora = [random_corpus(subjects=2, seed=seed) for seed in (0, 5)]
    own, source = (Corpus.from_captures([still, *list(c)[1:]], c.captures, 100.0) for c in corpora)
    assert len(joined(own, source, {})) == 36
