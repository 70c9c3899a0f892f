"""The Corpus of Social Touch: values by hand, published figures, the challenge, written and read again."""

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.read import cost
from bench.corpora.read.cost import GESTURES, read, write
from tests.corpora.made import COST_HEADER, cost_csv, line


def test_a_small_file_by_hand(tmp_path):
    path = cost_csv(
        tmp_path, line(frame=1), line(frame=2, values=[9] * 64), line(frame=1), line(7, 3, 12, 1, [1023] * 64)
    )
    corpus = read(path)
    assert list(corpus.lengths) == [2, 1, 1] and list(corpus.starts) == [0, 2, 3]
    assert corpus.captures.to_dict("list") == {
        "subject": ["1", "1", "7"],
        "variant": ["gentle", "gentle", "rough"],
        "gesture": ["grab", "grab", "stroke"],
        "repetition": [1, 2, 1],
    }
    assert (corpus.rate_hz, corpus.full_scale, corpus.grid) == (135, 1023, (8, 8))
    # ch1 to ch8 are the lowest row, ch57 to ch64 the top.
    assert list(corpus[0][0][7]) == list(range(8)) and list(corpus[0][0][0]) == list(range(56, 64))
    assert (corpus[0][1] == 9).all() and (corpus[2] == 1023).all()


def test_every_published_figure_that_differs_is_named(tmp_path):
    corpus = read(cost_csv(tmp_path, line()))
    warnings = corpus.info["warnings"]
    assert "captures: 1 here, 7805 published" in warnings
    assert "subjects: 1 here, 31 published" in warnings
    assert any("challenge split cannot be recovered" in w for w in warnings) and "split" not in corpus.captures


@given(
    st.lists(st.tuples(st.integers(1, 31), st.integers(0, 2), st.integers(0, 13), st.integers(1, 9)), min_size=1),
    st.integers(),
)
def test_written_and_read_again_is_identical(tmp_path, about, seed):
    rng = np.random.default_rng(abs(seed))
    arrays = [rng.integers(0, 1024, (n, 8, 8)).astype(np.uint16) for *_, n in about]
    captures = pd.DataFrame(
        [(str(s), cost.VARIANTS[v], GESTURES[g]) for s, v, g, _ in about], columns=["subject", "variant", "gesture"]
    )
    corpus = Corpus.from_captures(arrays, captures, 135.0)
    write(corpus, tmp_path / "out.csv")
    again = read(tmp_path / "out.csv")
    assert np.array_equal(again.frames, corpus.frames) and np.array_equal(again.starts, corpus.starts)
    assert again.captures[["subject", "variant", "gesture"]].values.tolist() == captures.values.tolist()
    assert (tmp_path / "out.csv").read_text().splitlines()[0] == COST_HEADER


def lengths_of_the_challenge():
    """31 subjects with one gentle and one normal capture each of the four gestures; 21 have the published sums."""
    rows, lengths = [], []
    for subject in range(31):
        for gesture, sums in cost.CHALLENGE_FRAMES.items():
            total = sums[(subject * 5) % 21] if subject < 21 else 50 + subject
            for variant, n in (("gentle", total // 3), ("normal", total - total // 3), ("rough", 17)):
                rows.append((str(subject + 1), variant, gesture))
                lengths.append(n)
    return pd.DataFrame(rows, columns=["subject", "variant", "gesture"]), np.array(lengths)


def test_the_training_subjects_of_the_challenge_are_recovered():
    captures, lengths = lengths_of_the_challenge()
    assert cost.training_subjects(captures, lengths) == {str(i) for i in range(1, 22)}
    shared = (captures["subject"] == "31") & (captures["gesture"] == "rub") & (captures["variant"] != "rough")
    lengths[shared] = cost.CHALLENGE_FRAMES["rub"][0] - 900, 900  # a test subject has one known sum by chance
    assert cost.training_subjects(captures, lengths) == {str(i) for i in range(1, 22)}
    lengths[0] += 1  # one subject no longer matches in one gesture
    assert cost.training_subjects(captures, lengths) == set()


def test_split_marks_gentle_and_normal_captures_only(tmp_path, monkeypatch):
    monkeypatch.setattr(cost, "CHALLENGE_FRAMES", {"pat": (5,), "rub": (7,)})
    monkeypatch.setattr(cost, "PUBLISHED_SUBJECTS", 2)
    captures = [(1, 1, 4, 2), (1, 2, 4, 3), (1, 1, 8, 7), (1, 3, 8, 1), (2, 1, 4, 5), (2, 2, 8, 6)]
    lines = [line(*labels, f) for *labels, frames in captures for f in range(1, frames + 1)]
    corpus = read(cost_csv(tmp_path, *lines))
    assert corpus.captures["split"].tolist() == ["train", "train", "train", "", "test", "test"]
    assert not any("split" in w for w in corpus.info["warnings"])
