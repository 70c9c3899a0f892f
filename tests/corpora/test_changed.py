"""Changes of an import, seams, captures brought to another sensor, and several corpora as one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora import synth
from bench.corpora.cuts import align_frames, apply_changes
from bench.corpora.doubts import measure_seams
from bench.corpora.joined import (
    convert_captures,
    join_corpora,
    regrid,
    resample,
    resampling_weights,
    rescale,
)
from bench.errors import InputError
from tests.corpora.made import study
from tests.features.captures import corpus_of


def broken(frames, row, lag):
    """Frames as a file with a seam has them: `aligned` undone by a loop, without the rows at the ends."""
    rows, seam = frames.shape[1], frames.shape[1] - row
    released = np.zeros_like(frames[: len(frames) - abs(lag)])
    for t, r in np.ndindex(len(released), rows):
        below = r < row  # rows of the released frame that lie below in the sensor's
        late = (t - lag if below else t) + max(lag, 0)
        released[t, r] = frames[late, seam + r if below else r - row]
    return released


@given(st.integers(1, 4), st.sampled_from([-1, 0, 1]), st.integers(4, 9))
def test_frames_are_put_together_again(row, lag, count):
    frames = np.random.default_rng(row).integers(0, 1023, (count, 5, 3)).astype(np.uint16)
    mended = align_frames(broken(frames, row, lag), row, lag)
    places = [k for k in range(count) if len(mended) and (frames[k] == mended[0]).all()]
    assert len(mended) == count - 2 * abs(lag) and np.array_equal(
        mended, frames[places[0] :][: len(mended)]
    )


@pytest.mark.parametrize(("row", "lag"), [(2, 1), (6, -1), (3, 0)])
def test_a_seam_is_found_where_it_is_and_gone_when_mended(row, lag):
    whole = synth.generate(subjects=2, repetitions=1, variants=("normal",))
    assert not any(seam.is_cut for seam in measure_seams(whole))
    faulty = corpus_of([broken(frames, row, lag) for frames in whole if len(frames) > 20])
    rows, columns = measure_seams(faulty)
    assert (
        rows.is_cut and (rows.weakest, rows.lag) == (row, lag) and f"align={row}:{lag}" in str(rows)
    )
    assert not columns.is_cut
    assert not any(
        seam.is_cut
        for seam in measure_seams(apply_changes(faulty, "table", {"align": f"{row}:{lag}"}))
    )


@pytest.mark.parametrize(
    ("option", "value", "fact"),
    [
        ("align", "yes", "give ROW:LAG"),
        ("align", "5:1", "a row from 1 to 4"),
        ("frames", "0:9", "2 captures have fewer than 9"),
        ("crop", "6x6", "at most the whole grid 5x6"),
    ],
)
def test_changes_that_do_not_fit_are_refused(option, value, fact):
    with pytest.raises(InputError, match=fact):
        apply_changes(corpus_of([np.ones((4, 5, 6), np.uint16)] * 2), "table", {option: value})


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


def test_a_rate_and_a_grid_by_hand():
    np.testing.assert_allclose(resampling_weights(3, 2), [[2 / 3, 1 / 3, 0], [0, 1 / 3, 2 / 3]])
    np.testing.assert_allclose(
        resampling_weights(4, 2), [[1 / 2, 1 / 2, 0, 0], [0, 0, 1 / 2, 1 / 2]]
    )
    frames = np.arange(4 * 2 * 4, dtype=np.uint16).reshape(4, 2, 4)
    np.testing.assert_allclose(
        resample(frames, 100.0, 50.0), frames.reshape(2, 2, 2, 4).mean(axis=1)
    )
    assert len(resample(frames, 100.0, 1.0)) == 1
    np.testing.assert_allclose(
        regrid(frames, 1, 2), frames.reshape(4, 1, 2, 2, 2).mean(axis=(2, 4))
    )
    assert np.array_equal(regrid(frames, 2, 4), frames)
    np.testing.assert_allclose(rescale(frames, 31.0, 1.0).max(), 1.0)


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
