import pickle
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import LeaveOneGroupOut, cross_validate

from bench.corpora.corpus import storage
from bench.corpora.folder import content_digest, open_folder, write_folder
from bench.errors import InputError
from tests.conftest import random_corpus
from tests.work.fakes import Level

GESTURES = ("pat", "rub", "tap")


@given(st.lists(st.integers(0, 35), min_size=1, max_size=60))
def test_a_slice_holds_the_frames_of_its_captures_and_shares_memory(chosen):
    corpus = random_corpus()
    some = corpus[np.array(chosen)]
    expected = [corpus.frames[corpus.starts[i] : corpus.starts[i] + corpus.lengths[i]] for i in chosen]
    assert some.shape == (len(some),) == (len(chosen),) and some.gestures.tolist() == corpus.gestures[chosen].tolist()
    assert all(map(np.array_equal, some, expected)) and storage(some)[0] is storage(corpus)[0]
    assert np.array_equal(some.frames, np.concatenate(expected))
    assert some.starts.tolist() == [0, *np.cumsum(some.lengths)[:-1]]
    assert np.array_equal(some[::-1].index, chosen[::-1])


def test_new_frames_of_a_slice_lie_as_its_frames_do(corpus):
    part = corpus[np.array([7, 2, 2])]
    louder = part.changed(frames=part.frames * 2)
    assert all(np.array_equal(new, 2 * old) for new, old in zip(louder, part, strict=True))
    assert np.array_equal(corpus[::-1].frames, np.concatenate([*corpus][::-1]))  # all captures, in another order


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


def test_a_replaced_corpus_is_not_mistaken_for_the_old_one(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    travelled = pickle.dumps(open_folder(tmp_path / "c"))
    (tmp_path / "c").rename(tmp_path / "old")
    write_folder(random_corpus(seed=1), tmp_path / "c")
    with pytest.raises(InputError, match="replaced"):
        pickle.loads(travelled)


@pytest.mark.parametrize("field", ["frames", "rate_hz", "full_scale", "captures", "lengths"])
def test_any_change_changes_the_digest(corpus, field):
    values = {
        "frames": corpus.frames + (np.arange(corpus.frames.size) == 0).astype(np.uint16).reshape(corpus.frames.shape),
        "rate_hz": 50.0,
        "full_scale": 4095.0,
        "captures": corpus.captures.assign(subject="1"),
        "lengths": np.roll(corpus.lengths, 1),
    }
    assert content_digest(corpus.changed(**{field: values[field]})) != content_digest(corpus)


def test_targets(corpus):
    assert set(corpus.with_target("gesture+repetition").gestures) == {f"{g} {r}" for g in GESTURES for r in (1, 2, 3)}
    for column in ("nothing", "subject+nothing", "cover"):
        with pytest.raises(InputError, match=f"target={re.escape(column)}.*subject, gesture, repetition"):
            corpus.changed(captures=corpus.captures.assign(cover=[None, *["x"] * 35])).with_target(column)


def test_scikit_learn_takes_a_corpus_as_it_takes_an_array(corpus):
    table = cross_validate(Level(), corpus, corpus.gestures, groups=corpus.subjects, cv=LeaveOneGroupOut())
    assert len(table["test_score"]) == 4 and table["test_score"].mean() > 0.9
