"""Several corpora as one, and captures brought to another sensor: against averages and lines drawn by hand."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.joined import brought, regridded, resampled, scaled, together, weights
from bench.errors import InputError


@given(st.integers(1, 30), st.integers(1, 30))
def test_no_weight_is_negative_and_no_side_is_favoured(count, wanted):
    table = weights(count, wanted)
    assert table.shape == (wanted, count) and (table >= 0).all()
    np.testing.assert_allclose(table.sum(axis=1), 1)
    np.testing.assert_allclose(table[::-1, ::-1], table, atol=1e-12)
    values = np.random.default_rng(count).random(count)
    if wanted <= count:  # means, of which nothing is lost on average
        np.testing.assert_allclose((table @ values).mean(), values.mean())
    else:  # lines between the middles
        by_hand = np.interp((np.arange(wanted) + 0.5) / wanted, (np.arange(count) + 0.5) / count, values)
        np.testing.assert_allclose(table @ values, by_hand)


def test_fewer_values_by_hand():
    np.testing.assert_allclose(weights(3, 2), [[2 / 3, 1 / 3, 0], [0, 1 / 3, 2 / 3]])
    np.testing.assert_allclose(weights(4, 2), [[1 / 2, 1 / 2, 0, 0], [0, 0, 1 / 2, 1 / 2]])
    assert np.array_equal(weights(3, 3), np.eye(3))


def test_a_rate_and_a_grid_by_hand():
    frames = np.arange(4 * 2 * 4, dtype=np.uint16).reshape(4, 2, 4)
    halved = resampled(frames, 100.0, 50.0)
    np.testing.assert_allclose(halved, frames.reshape(2, 2, 2, 4).mean(axis=1))
    assert halved.dtype == np.float32 and len(resampled(frames, 100.0, 1.0)) == 1
    coarse = regridded(frames, 1, 2)
    np.testing.assert_allclose(coarse, frames.reshape(4, 1, 2, 2, 2).mean(axis=(2, 4)))
    assert np.array_equal(regridded(frames, 2, 4), frames)
    np.testing.assert_allclose(scaled(frames, 31.0, 1.0).max(), 1.0)


def other_sensor():
    """Two people whose classes are called otherwise, on 4 x 5 taxels at 40 Hz, up to 1."""
    rng = np.random.default_rng(0)
    labels = [(who, name) for who in ("1", "2") for name in ("PAT", "rub", "knock")]
    arrays = [rng.random((n, 4, 5)).astype(np.float32) for n in (8, 9, 10, 11, 12, 13)]
    captures = pd.DataFrame(labels, columns=["subject", "gesture"])
    return Corpus.from_captures(arrays, captures, 40.0, full_scale=1.0, name="other")


def study(name, people=("1", "2"), classes=("pat", "rub"), shape=(4, 5), rate_hz=40.0, **columns):
    """A corpus of one capture of each class and person, up to 1."""
    rng = np.random.default_rng([ord(letter) for letter in name])
    rows = [(who, what) for who in people for what in classes]
    captures = pd.DataFrame(rows, columns=["subject", "gesture"]).assign(**columns)
    arrays = [rng.random((8 + i, *shape)).astype(np.float32) for i in range(len(rows))]
    return Corpus.from_captures(arrays, captures, rate_hz, full_scale=1.0, name=name, info={"format": "table"})


def test_several_corpora_as_one_keep_people_apart_and_have_the_classes_and_conditions_of_all():
    one = study("one", classes=("pat", "rub", "tap"), cover="fur", motion="none")
    other = study("two", classes=("rub", "pat", "hug"), shape=(6, 3), rate_hz=20.0, cover="none")
    third = study("three", people=("2",), cover="none").changed(full_scale=4.0)
    joint = together([one, other, third])
    assert joint.name == "one+two+three" and joint.grid == (4, 3) and joint.rate_hz == 20.0 and joint.full_scale == 1.0
    assert list(joint.captures) == ["subject", "gesture", "cover", "corpus"] and len(joint) == 4 + 4 + 2
    assert sorted(set(joint.subjects)) == ["one 1", "one 2", "three 2", "two 1", "two 2"]
    assert joint.captures["corpus"].tolist() == ["one"] * 4 + ["two"] * 4 + ["three"] * 2
    assert joint.gestures.tolist() == ["pat", "rub"] * 2 + ["rub", "pat"] * 2 + ["pat", "rub"]
    np.testing.assert_allclose(joint[2], brought(one[3:4], 20.0, (4, 3), 1.0)[0])  # "tap" is left out
    np.testing.assert_allclose(joint[9], brought(third[1:2], 20.0, (4, 3), 4.0)[0] / 4, rtol=1e-6)


def test_the_same_people_are_not_joined():
    one = study("one").changed(digest="d" * 64)
    cut = study("two").changed(info={"format": "table", "unchanged": "d" * 64})
    with pytest.raises(InputError, match=r"data=one\+two: one and two are imports of the same recordings"):
        together([one, cut])
    with pytest.raises(InputError, match="1 classes are in all"):
        together([one, study("three", classes=("pat", "hug"))])
    with pytest.raises(InputError, match="have the same captures: 4"):
        together([one, one.changed(name="four")])
