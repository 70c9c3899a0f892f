"""Changes of an import, and seams: generated captures with and without a fault, put together again."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora import synth
from bench.corpora.corpus import Corpus
from bench.corpora.cuts import aligned, cut
from bench.corpora.doubts import seams
from bench.errors import InputError


def corpus_of(arrays):
    table = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, table, 50.0, full_scale=1023, name="small")


def broken(frames, row, lag):
    """Frames as a file with a seam has them: `aligned` undone by a loop, without the rows at the ends."""
    rows, seam = frames.shape[1], frames.shape[1] - row
    released = np.zeros_like(frames[: len(frames) - abs(lag)])
    for t in range(len(released)):
        for r in range(rows):
            below = r < row  # rows of the released frame that lie below in the sensor's
            late = (t - lag if below else t) + max(lag, 0)
            released[t, r] = frames[late, seam + r if below else r - row]
    return released


@given(st.integers(1, 4), st.sampled_from([-1, 0, 1]), st.integers(4, 9))
def test_frames_are_put_together_again(row, lag, count):
    frames = np.random.default_rng(row).integers(0, 1023, (count, 5, 3)).astype(np.uint16)
    mended = aligned(broken(frames, row, lag), row, lag)
    places = [k for k in range(count) if len(mended) and (frames[k] == mended[0]).all()]
    assert len(mended) == count - 2 * abs(lag) and np.array_equal(mended, frames[places[0] :][: len(mended)])


@pytest.mark.parametrize(("row", "lag"), [(2, 1), (6, -1), (3, 0)])
def test_a_seam_is_found_where_it_is_and_gone_when_mended(row, lag):
    whole = synth.generate(subjects=2, repetitions=1, variants=("normal",))
    assert not any(seam.found for seam in seams(whole))
    faulty = corpus_of([broken(frames, row, lag) for frames in whole if len(frames) > 20])
    rows, columns = seams(faulty)
    assert rows.found and (rows.weakest, rows.lag) == (row, lag) and f"align={row}:{lag}" in str(rows)
    assert not columns.found
    assert not any(seam.found for seam in seams(cut(faulty, "table", {"align": f"{row}:{lag}"})))


@pytest.mark.parametrize(
    ("options", "fact"),
    [
        ({"align": "yes"}, "give ROW:LAG"),
        ({"align": "5:1"}, "a row from 1 to 4"),
        ({"frames": "0:9"}, "2 captures have fewer than 9"),
        ({"crop": "6x6"}, "at most the whole grid 5x6"),
    ],
)
def test_changes_that_do_not_fit_are_refused(options, fact):
    with pytest.raises(InputError, match=fact):
        cut(corpus_of([np.ones((4, 5, 6), np.uint16)] * 2), "table", options)
