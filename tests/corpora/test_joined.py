"""Captures converted to another sensor, and several corpora as one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.joined import (
    convert_captures,
    join_corpora,
    regrid,
    resample,
    resampling_weights,
)
from bench.errors import InputError
from tests.corpora.made import study


@given(st.integers(1, 30), st.integers(1, 30))
def test_no_weight_is_negative_and_no_side_is_favoured(count, wanted):
    table = resampling_weights(count, wanted)
    assert table.shape == (wanted, count) and (table >= 0).all()
    np.testing.assert_allclose(table.sum(axis=1), 1)
    np.testing.assert_allclose(table[::-1, ::-1], table, atol=1e-12)
    values = np.random.default_rng(count).random(count)
    if wanted <= count:  # means, of which nothing is lost on average
        np.testing.assert_allclose((table @ values).mean(), values.mean())
    else:  # lines between the middles
        by_hand = np.interp(
            (np.arange(wanted) + 0.5) / wanted, (np.arange(count) + 0.5) / count, values
        )
        np.testing.assert_allclose(table @ values, by_hand)
    frames = resample(values[:, None, None], count, wanted)
    assert frames.dtype == np.float32
    np.testing.assert_allclose(frames.ravel(), table @ values, rtol=1e-5)


def test_a_grid_by_hand():
    frames = np.arange(4 * 2 * 4, dtype=np.uint16).reshape(4, 2, 4)
    means = frames.reshape(4, 1, 2, 2, 2).mean(axis=(2, 4))
    np.testing.assert_allclose(regrid(frames, 1, 2), means)


def test_several_corpora_as_one_keep_people_apart_and_have_the_classes_and_conditions_of_all():
    one = study("one", classes=("pat", "rub", "tap"), cover="fur", motion="none")
    other = study("two", classes=("rub", "pat", "hug"), shape=(6, 3), rate_hz=20.0, cover="none")
    third = study("three", people=("2",), cover="none").with_fields(full_scale=4.0)
    joint = join_corpora([one, other, third])
    assert (
        joint.name == "one+two+three"
        and joint.grid == (4, 3)
        and joint.rate_hz == 20.0
        and joint.full_scale == 1.0
    )
    assert (
        list(joint.captures) == ["subject", "gesture", "cover", "corpus"]
        and len(joint) == 4 + 4 + 2
    )
    assert sorted(set(joint.subjects)) == ["one 1", "one 2", "three 2", "two 1", "two 2"]
    assert joint.captures["corpus"].tolist() == ["one"] * 4 + ["two"] * 4 + ["three"] * 2
    assert joint.gestures.tolist() == ["pat", "rub"] * 2 + ["rub", "pat"] * 2 + ["pat", "rub"]
    np.testing.assert_allclose(
        joint[2], convert_captures(one[3:4], 20.0, (4, 3), 1.0)[0]
    )  # "tap" is left out
    np.testing.assert_allclose(
        joint[9], convert_captures(third[1:2], 20.0, (4, 3), 4.0)[0] / 4, rtol=1e-6
    )


def test_the_same_people_are_not_joined():
    one = study("one").with_fields(digest="d" * 64)
    cut = study("two").with_fields(info={"format": "table", "unchanged": "d" * 64})
    with pytest.raises(
        InputError, match=r"data=one\+two: one and two are imports of the same recordings"
    ):
        join_corpora([one, cut])
    with pytest.raises(InputError, match="1 classes are in all"):
        join_corpora([one, study("three", classes=("pat", "hug"))])
    with pytest.raises(InputError, match="have the same captures: 4"):
        join_corpora([one, one.with_fields(name="four")])


def test_gestures_spelt_differently_are_joined_under_the_first_spelling_with_a_word():
    one = study("one", classes=("pat", "double tap"))
    other = study("two", classes=("Pat", "double-tap"))
    joint = join_corpora([one, other])
    assert set(joint.gestures) == {"pat", "double tap"} and len(joint) == len(one) + len(other)
    assert "gesture 'Pat' of two (2x) is read as 'pat'" in joint.info["warnings"]
