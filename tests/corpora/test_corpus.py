import pickle
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import LeaveOneGroupOut, cross_validate

from bench.corpora.corpus import shared_frames
from bench.corpora.folder import content_digest, open_folder, write_folder
from bench.errors import InputError
from tests.conftest import random_corpus
from tests.running.fakes import Level

WHOLE = random_corpus()


@given(st.lists(st.integers(0, 35), min_size=1, max_size=60))
def test_a_slice_holds_the_frames_of_its_captures_and_shares_memory(chosen):
    some = WHOLE[np.array(chosen)]
    expected = [WHOLE.frames[WHOLE.starts[i] : WHOLE.starts[i] + WHOLE.lengths[i]] for i in chosen]
    assert (
        some.shape == (len(some),) == (len(chosen),)
        and some.gestures.tolist() == WHOLE.gestures[chosen].tolist()
    )
    assert (
        all(map(np.array_equal, some, expected))
        and shared_frames(some)[0] is shared_frames(WHOLE)[0]
    )
    assert np.array_equal(some.frames, np.concatenate(expected))
    assert some.starts.tolist() == [0, *np.cumsum(some.lengths)[:-1]]
    assert np.array_equal(some[::-1].index, chosen[::-1])
    louder = some.with_fields(frames=some.frames * 2)
    assert all(np.array_equal(new, 2 * old) for new, old in zip(louder, some, strict=True))


def test_stored_and_mapped_again(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    again = open_folder(tmp_path / "c")
    assert np.array_equal(again.frames, corpus.frames) and isinstance(again.frames.base, np.memmap)
    assert again.captures.astype(str).equals(corpus.captures.astype(str))
    assert again.digest == content_digest(corpus)
    travelled = pickle.dumps(again[np.array([5, 2])])
    assert len(travelled) < 2000  # frames do not travel
    assert np.array_equal(pickle.loads(travelled)[0], corpus[5])
    in_memory = pickle.loads(pickle.dumps(corpus[3:5]))
    assert np.array_equal(in_memory[1], corpus[4])
    (tmp_path / "c").rename(tmp_path / "old")
    write_folder(random_corpus(seed=1), tmp_path / "c")
    with pytest.raises(InputError, match="replaced"):
        pickle.loads(travelled)


@pytest.mark.parametrize("field", ["frames", "rate_hz", "full_scale", "captures", "lengths"])
def test_any_change_changes_the_digest(corpus, field):
    values = {
        "frames": corpus.frames
        + (np.arange(corpus.frames.size) == 0).astype(np.uint16).reshape(corpus.frames.shape),
        "rate_hz": 50.0,
        "full_scale": 4095.0,
        "captures": corpus.captures.assign(subject="1"),
        "lengths": np.roll(corpus.lengths, 1),
    }
    assert content_digest(corpus.with_fields(**{field: values[field]})) != content_digest(corpus)


@pytest.mark.parametrize("column", ["nothing", "subject+nothing", "cover"])
def test_a_target_that_some_captures_lack_is_refused(corpus, column):
    with pytest.raises(
        InputError, match=f"target={re.escape(column)}.*subject, gesture, repetition"
    ):
        corpus.with_fields(captures=corpus.captures.assign(cover=[None, *["x"] * 35])).with_target(
            column
        )


def test_scikit_learn_takes_a_corpus_as_it_takes_an_array(corpus):
    table = cross_validate(
        Level(), corpus, corpus.gestures, groups=corpus.subjects, cv=LeaveOneGroupOut()
    )
    assert len(table["test_score"]) == 4 and table["test_score"].mean() > 0.9
