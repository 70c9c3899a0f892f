"""Changes of an import: frames put together again, seams that show where they were cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora import synth
from bench.corpora.cuts import align_frames, apply_changes
from bench.corpora.doubts import measure_seams
from bench.errors import InputError
from tests.features.captures import corpus_of


def cut_wrongly(frames, row, lag):
    """Frames as a file with a seam has them: `align_frames` undone by a loop."""
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
    mended = align_frames(cut_wrongly(frames, row, lag), row, lag)
    places = [k for k in range(count) if len(mended) and (frames[k] == mended[0]).all()]
    assert len(mended) == count - 2 * abs(lag) and np.array_equal(
        mended, frames[places[0] :][: len(mended)]
    )


@pytest.mark.parametrize(("row", "lag"), [(2, 1), (6, -1), (3, 0)])
def test_a_seam_is_found_where_it_is_and_gone_when_mended(row, lag):
    whole = synth.generate(subjects=2, repetitions=1, variants=("normal",))
    assert not any(seam.is_cut for seam in measure_seams(whole))
    faulty = corpus_of([cut_wrongly(frames, row, lag) for frames in whole if len(frames) > 20])
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
