import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.read import cost
from bench.corpora.read.cost import CHANNELS, GESTURES, read, write
from bench.errors import InputError

HEADER = "subject, variant, gesture, frame, " + ", ".join(CHANNELS)


def line(subject=1, variant=1, gesture=1, frame=1, values=None):
    return ",".join(map(str, [subject, variant, gesture, frame, *(values or range(64))]))


def file(tmp_path, *lines, end="\n", name="CoST.csv"):
    path = tmp_path / name
    path.write_text(end.join([HEADER, *lines]) + end)
    return path


def test_a_small_file_by_hand(tmp_path):
    path = file(tmp_path, line(frame=1), line(frame=2, values=[9] * 64), line(frame=1), line(7, 3, 12, 1, [1023] * 64))
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
    corpus = read(file(tmp_path, line()))
    warnings = corpus.info["warnings"]
    assert "captures: 1 here, 7805 published" in warnings
    assert "captures of gesture stroke: 0 here, 556 published" in warnings
    assert "captures of variant gentle: 1 here, 2601 published" in warnings
    assert "subjects: 1 here, 31 published" in warnings
    assert any(w.startswith("MD5 of the file") for w in warnings)
    assert any("challenge split cannot be recovered" in w for w in warnings) and "split" not in corpus.captures


def test_captures_that_are_marked_as_generated_do_not_pass_for_published_ones(tmp_path):
    marked = [",".join(["1", "1", "1", "1", mark, *map(str, range(64))]) for mark in "10"]
    path = tmp_path / "CoST.csv"
    head = HEADER.replace("frame, ", "frame, synthetic, ")
    path.write_text(f"{head}\n{marked[0]}\n")
    corpus = read(path)
    assert corpus.synthetic and "4TU" not in corpus.info["source"] and "synthetic" not in corpus.captures
    assert any(w.startswith("MD5 of the file") for w in corpus.info["warnings"])
    path.write_text(f"{head}\n{marked[0]}\n{marked[1]}\n")
    with pytest.raises(InputError, match="CoST.csv, line 3: synthetic is not 1"):
        read(path)


def test_published_counts_add_up():
    assert sum(cost.PUBLISHED_GESTURES.values()) == sum(cost.PUBLISHED_VARIANTS.values()) == 7805


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
    assert (tmp_path / "out.csv").read_text().splitlines()[0] == HEADER


def test_other_line_ends_and_a_byte_order_mark_are_fine(tmp_path):
    path = file(tmp_path, line(), line(frame=2), end="\r\n")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert list(read(path).lengths) == [2]
    path.write_bytes(path.read_bytes().rstrip())  # no newline after the last line
    assert list(read(path).lengths) == [2]


FULL = [*range(63), 1024]
good = [line(frame=f) for f in (1, 2, 3)]
BROKEN = {
    "capture that starts at 7": ([*good, line(2, frame=7)], "line 5: a capture starts at frame 7"),
    "first capture starts at 7": ([line(frame=7)], "line 2: a capture starts at frame 7"),
    "duplicate frame": ([*good, line(frame=3)], "line 5: frame 3 stands twice"),
    "missing frame": ([*good, line(frame=5)], "line 5: frame 5 follows frame 3"),
    "no number": ([*good, line(frame=4, values=[1, "x", *range(62)])], "line 5: ch2 is 'x', not a whole number"),
    "decimals": ([*good, line(frame=4, values=[1.5, *range(63)])], "line 5: ch1 is '1.5', not a whole number"),
    "empty cell": ([*good, line(frame=4, values=["", *range(63)])], "line 5: ch1 is '', not a whole number"),
    "negative": ([*good, line(frame=4, values=[-1, *range(63)])], "line 5: ch1 is '-1', not a whole number from 0"),
    "above full scale": (
        [*good, line(frame=4, values=FULL)],
        "line 5: ch64 is 1024, not within 0 and",
    ),
    "far above": (
        [*good, line(frame=4, values=[*range(63), 99999])],
        "line 5: ch64 is '99999', not a whole",
    ),
    "truncated last line": ([*good, line(frame=4)[:40]], "line 5: 19 fields instead of 68"),
    "blank line inside": ([*good, "", line(frame=4)], "line 5: blank"),
    "unknown gesture": ([*good, line(gesture=15)], "line 5: gesture 15 is not one of 1 to 14"),
    "unknown variant": ([*good, line(variant=0)], "line 5: variant 0 is not one of 1 to 3"),
    "no subject": ([*good, line(subject="?")], "line 5: subject is '?', not a whole number"),
    "plus sign": ([*good, line(frame=4, values=["+1", *range(63)])], "line 5: ch1 is '+1', not a whole number"),
    "underscore": ([*good, line(frame=4, values=["1_0", *range(63)])], "line 5: ch1 is '1_0', not a whole number"),
    "two signs": ([*good, line(subject="--5")], "line 5: subject is '--5', not a whole number"),
    "open quote": ([*good, '"' + line(frame=4), line(frame=5)], "line 5: 1 fields instead of 68"),
    "no frames": ([], "there are no frames in it"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_refused_with_its_line(tmp_path, case):
    lines, message = BROKEN[case]
    with pytest.raises(InputError) as error:
        read(file(tmp_path, *lines))
    assert message in str(error.value) and str(error.value).startswith("CoST.csv")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("lines", [1, 5, 3000])
def test_bytes_that_are_not_text_are_found_in_their_line(tmp_path, lines):
    path = file(tmp_path, *(line(frame=f) for f in range(1, lines + 1)))
    path.write_bytes(path.read_bytes() + b"1,1,1,\xe9" + b",5" * 64 + b"\n" + line(frame=lines + 2).encode() + b"\n")
    with pytest.raises(InputError, match=f"CoST.csv, line {lines + 2}: not text in UTF-8"):
        read(path)


def test_a_header_without_a_line_end_has_no_frames(tmp_path):
    (tmp_path / "CoST.csv").write_text(HEADER)
    with pytest.raises(InputError, match="there are no frames in it"):
        read(tmp_path / "CoST.csv")


def test_files_that_are_not_cost(tmp_path):
    for name, content, message in [
        ("empty.csv", b"", "empty"),
        ("binary.csv", b"\x89PNG\xff\xfe" * 20, "not a text file"),
        ("other.csv", b"a,b\n1,2\n", "line 1: no column subject"),
        ("short.csv", b"subject, variant, gesture, frame, ch1\n", "no column ch2, ch3, ch4 and 60 more"),
        ("twice.csv", b"subject,subject\n", "stands twice"),
        ("more.csv", (HEADER + ", extra\n").encode(), "line 1: column 'extra'"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=message):
            read(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "missing.csv")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path)


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
    assert (
        cost.training_subjects(captures[captures["gesture"] != "rub"], lengths[captures["gesture"] != "rub"]) == set()
    )


def test_split_marks_gentle_and_normal_captures_only(tmp_path, monkeypatch):
    monkeypatch.setattr(cost, "CHALLENGE_FRAMES", {"pat": (5,), "rub": (7,)})
    monkeypatch.setattr(cost, "PUBLISHED_SUBJECTS", 2)
    lines = []
    for subject, variant, gesture, frames in [
        (1, 1, 4, 2),
        (1, 2, 4, 3),
        (1, 1, 8, 7),
        (1, 3, 8, 1),
        (2, 1, 4, 5),
        (2, 2, 8, 6),
    ]:
        lines += [line(subject, variant, gesture, f) for f in range(1, frames + 1)]
    corpus = read(file(tmp_path, *lines))
    assert corpus.captures["split"].tolist() == ["train", "train", "train", "", "test", "test"]
    assert not any("split" in w for w in corpus.info["warnings"])


def test_carried_sums_are_of_21_subjects_and_tell_them_apart():
    assert {len(sums) for sums in cost.CHALLENGE_FRAMES.values()} == {21}
    assert {len(set(sums)) for sums in cost.CHALLENGE_FRAMES.values()} == {21}


def one_capture(subject="1", frames=3, value=5):
    captures = pd.DataFrame({"subject": [subject], "variant": ["rough"], "gesture": ["tap"]})
    return Corpus.from_captures([np.full((frames, 8, 8), value, np.uint16)], captures, 135.0)


@pytest.mark.parametrize("subject, frames", [("70000", 3), ("0", 1), ("1", 65537)])
def test_large_subject_numbers_and_long_captures_are_written_as_they_are(tmp_path, subject, frames):
    write(one_capture(subject, frames), tmp_path / "out.csv")
    again = read(tmp_path / "out.csv")
    assert again.captures["subject"].tolist() == [subject] and list(again.lengths) == [frames]


def test_write_refuses_what_would_not_read_back_the_same(tmp_path):
    for corpus, message in [
        (one_capture("007"), "not '007'"),
        (one_capture("P4"), "not 'P4'"),
        (one_capture("-1"), "not '-1'"),
        (one_capture(value=1024), "up to 1023, the highest here is 1024"),
    ]:
        with pytest.raises(InputError, match=message):
            write(corpus, tmp_path / "out.csv")
    decimals = one_capture().changed(frames=np.zeros((3, 8, 8), np.float32))
    with pytest.raises(InputError, match="8x8 frames of whole numbers, these are 8x8 of float32"):
        write(decimals, tmp_path / "out.csv")
    assert not any(tmp_path.iterdir())


def test_an_unreadable_file_is_named(tmp_path, monkeypatch):
    path = file(tmp_path, line())

    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", denied)
    with pytest.raises(InputError, match=r"CoST.csv: cannot be read \(Permission denied\)"):
        read(path)


def test_write_refuses_what_the_format_cannot_hold(corpus, tmp_path):
    with pytest.raises(InputError, match="variant"):
        write(corpus, tmp_path / "out.csv")
    corpus.captures["variant"] = "gentle"
    wide = corpus.changed(frames=corpus.frames.reshape(-1, 4, 16))
    with pytest.raises(InputError, match="8x8"):
        write(wide, tmp_path / "out.csv")
    write(corpus, tmp_path / "out.csv")
    with pytest.raises(InputError, match="cannot be written"):
        write(corpus, tmp_path / "nowhere" / "out.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]
