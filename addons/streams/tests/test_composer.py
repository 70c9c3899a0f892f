"""Recordings composed from captures, and captures cut from recordings."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from touchbench_streams.composer import composed, pieces
from touchbench_streams.recordings import Recordings, captures_in, event_table, recorded


def numbered(subjects=("a", "b"), rate_hz=10.0):
    """Captures whose frames tell which capture and frame they are: 1000 * capture + frame; one taxel."""
    rows = [(s, g, v) for s in subjects for g in ("pat", "rub", "none") for v in ("hard", "soft")]
    lengths = [70 if g == "none" else 35 + 5 * i for i, (_, g, _) in enumerate(rows)]
    arrays = [1000.0 * (i + 1) + np.arange(n, dtype=np.float32).reshape(-1, 1, 1) for i, n in enumerate(lengths)]
    return Corpus.from_captures(arrays, pd.DataFrame(rows, columns=["subject", "gesture", "cover"]), rate_hz, name="n")


def test_a_recording_is_made_of_excerpts_of_the_subject_alone():
    corpus = numbered(tuple("abcdef"))
    recordings = composed(*pieces(corpus, "none"))
    of = corpus.captures
    for i, subject in enumerate(recordings.subjects):
        frames = recordings.corpus[i][:, 0, 0]
        capture = (frames // 1000 - 1).astype(int)
        assert set(of["subject"][capture]) == {subject}
        events = recordings.events[recordings.events["recording"] == i]
        touched = np.zeros(len(frames), bool)
        used = []
        for start, end, gesture in events[["start", "end", "gesture"]].itertuples(index=False):
            assert (np.diff(frames[start:end]) == 1).all()  # one excerpt, in order
            assert of["gesture"][capture[start]] == gesture and 20 <= end - start <= 60
            assert of["cover"][capture[start - 1]] == of["cover"][capture[start]]  # its background has its conditions
            assert start >= 30 and not touched[start - 30 : start].any()  # at least 3 s of background before
            touched[start:end] = True
            used.append(capture[start])
        assert sorted(used) == sorted(np.flatnonzero((of["subject"] == subject) & (of["gesture"] != "none")))
        assert set(of["gesture"][capture[~touched]]) == {"none"}


def test_a_subject_has_the_same_recording_whoever_else_is_there():
    corpus = numbered()
    both = composed(*pieces(corpus, "none"))
    one = composed(*pieces(corpus[np.flatnonzero(corpus.subjects == "b")], "none"))
    assert np.array_equal(both.corpus[1], one.corpus[0])
    pd.testing.assert_frame_equal(both[[1]].events, one.events)


def test_quiet_ends_of_captures():
    pressure = np.array([0, 0, 1, 0, 9, 10, 2, 9, 0, 0, 0], dtype=np.float32).repeat(2).reshape(-1, 1, 1)
    table = pd.DataFrame({"subject": ["a"], "gesture": ["pat"]})
    corpus = Corpus.from_captures([pressure], table, rate_hz=16.0)
    touches, quiet = pieces(corpus, "quiet")
    # a tenth of the range is 1: frames 4 to 15 are touched (1 is not below a tenth); a quarter of a second is 4 frames
    assert touches[0][:, 0, 0].tolist() == pressure[4:16, 0, 0].tolist()
    assert [each[:, 0, 0].tolist() for each in quiet] == [[0, 0, 0, 0], [0, 0, 0, 0, 0, 0]]
    with pytest.raises(InputError, match="background=quiet"):
        pieces(corpus.changed(starts=np.array([4]), lengths=np.array([12])), "quiet")
    with pytest.raises(InputError, match="background=rub"):
        pieces(corpus, "rub")


def test_a_subject_without_background_is_refused():
    corpus = numbered()
    lacking = corpus[((corpus.subjects != "b") | (corpus.gestures != "none")).nonzero()[0]]
    with pytest.raises(InputError, match="subject b"):
        composed(*pieces(lacking, "none"))


@given(st.lists(st.lists(st.tuples(st.integers(1, 4), st.sampled_from(["", "pat", "rub"])), min_size=1), min_size=1))
def test_captures_of_recordings_are_their_frames_and_make_them_again(plans):
    arrays, rows, value = [], [], 0
    for number, plan in enumerate(plans):
        length = 0
        for frames, gesture in plan:
            if gesture:
                rows.append((number, length, length + frames, gesture))
            length += frames
        arrays.append(np.arange(value, value + length, dtype=np.float32).reshape(-1, 1, 1))
        value += length
    subjects = pd.DataFrame({"subject": [f"s{i % 2}" for i in range(len(plans))], "gesture": ""})
    recordings = Recordings(Corpus.from_captures(arrays, subjects, 10.0), event_table(rows))
    captures = captures_in(recordings)
    assert np.array_equal(np.concatenate([*captures])[:, 0, 0], np.arange(value))  # every frame once, in order
    touched = captures.captures[captures.captures["gesture"] != "background"]
    assert touched["gesture"].tolist() == recordings.events["gesture"].tolist()
    chosen = captures[captures.subjects == "s0"]
    again = recorded(chosen)
    expected = recordings[np.flatnonzero(recordings.subjects == "s0")]
    assert [a.tolist() for a in again.corpus] == [a.tolist() for a in expected.corpus]
    pd.testing.assert_frame_equal(again.events, expected.events)
