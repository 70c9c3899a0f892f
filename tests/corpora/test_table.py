"""Tables and arrays of any grid, rate and conditions; files that look wrong and are right."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.folder import content_digest
from bench.corpora.read.table import corpus_from_table, read
from bench.errors import InputError
from tests.corpora import made


def stored(table, folder, kind):
    path = folder / f"my.{kind}"
    table.to_csv(path, index=False) if kind == "csv" else table.to_parquet(path)
    return path


@pytest.mark.parametrize("marks", [(1, 1), ("true", "TRUE"), (0, 0), (False, True)])
def test_a_column_marks_generated_captures(tmp_path, marks):
    labels = {
        "subject": ["ann", "ann", "bob"],
        "gesture": ["pat", "pat", "rub"],
        "frame": [0, 1, 0],
    }
    table = pd.DataFrame(labels | {"synthetic": [marks[0], *marks], "x": 1})
    corpus = read(stored(table, tmp_path, "csv"), 54.0, "1x1")
    assert corpus.synthetic is (marks != (0, 0))
    assert ("synthetic" in corpus.captures) is (len({str(m).lower() for m in marks}) > 1)


HIGHEST = {1023: np.uint16, 65535: np.uint16, 65536: np.float32, 2**62: np.float32, 9.5: np.float32}


@given(
    st.lists(st.integers(1, 9), min_size=1, max_size=12),
    st.integers(0, 2**32),
    st.sampled_from([0, 1]),
    st.sampled_from([*HIGHEST]),
)
def test_ragged_captures_are_the_same_from_every_kind_of_file(
    tmp_path, lengths, seed, origin, highest
):
    rng = np.random.default_rng(seed)
    frames = rng.random((sum(lengths), 2, 3)) * min(highest, 2**20)
    frames = frames if isinstance(highest, float) else frames.astype(np.int64)
    frames[0, 0, 0] = highest
    labels = {
        "subject": [f"s{i % 3}" for i in range(len(lengths))],
        "gesture": rng.choice(["pat", "rub"], len(lengths)),
        "place": rng.choice(["arm", "leg"], len(lengths)),
    }
    table = pd.DataFrame({name: np.repeat(values, lengths) for name, values in labels.items()})
    table["frame"] = np.concatenate([np.arange(origin, origin + n) for n in lengths])
    table = pd.concat([table, pd.DataFrame(frames.reshape(-1, 6)).add_prefix("x")], axis=1)
    np.savez(tmp_path / "my.npz", frames=frames, offsets=np.cumsum([0, *lengths]), **labels)
    for path in (
        stored(table, tmp_path, "csv"),
        stored(table, tmp_path, "parquet"),
        tmp_path / "my.npz",
    ):
        corpus, kind = read(path, rate_hz=54.0, grid="2x3", full_scale=1e30), HIGHEST[highest]
        assert np.array_equal(corpus.frames, frames.astype(kind)) and corpus.frames.dtype == kind
        assert list(corpus.lengths) == lengths
        assert corpus.captures.to_dict("list") == {
            name: list(values) for name, values in labels.items()
        }


def test_labels_are_text_of_one_spelling_from_every_kind_of_file(tmp_path):
    labels = {"subject": [1, 10], "gesture": [0, 1], "take": [3, 12], "weight": [1.5, 2.0]}
    table = pd.DataFrame(labels | {"is_left": [True, False], "frame": 0, "x": [5, 6]})
    corpora = [read(stored(table, tmp_path, kind), 54.0, "1x1") for kind in ("csv", "parquet")]
    arrays = {name: table[name].to_numpy() for name in table if name not in ("frame", "x")}
    arrays |= {"frames": table[["x"]].to_numpy()[:, None], "offsets": np.arange(3)}
    np.savez(tmp_path / "my.npz", **arrays)
    corpora.append(read(tmp_path / "my.npz", 54.0))
    assert len({content_digest(corpus) for corpus in corpora}) == 1
    for corpus in corpora:
        assert corpus.captures.iloc[1].tolist() == ["10", "1", "12", "2.0", "False"]
        assert corpus.select("take > '2' and weight != '1.5' or take == '12'").subjects == ["10"]


@pytest.mark.parametrize(("end", "blank"), [("\n", ["", "", ""]), ("\r\n", ["\t", " "])])
def test_line_ends_blank_lines_at_the_end_and_a_byte_order_mark(tmp_path, end, blank):
    path = made.csv(tmp_path, *made.GOOD, *blank, end=end)
    assert made.read(path).lengths.tolist() == [2]
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().rstrip())
    assert made.read(path).frames.ravel().tolist() == [1, 2, 3, 4]


def test_words_and_numbers_of_any_kind(tmp_path):
    rows = ["0x1f, pat ,0,0x2,1e3,.5", "0x1f,pat,1,0x2,+1,0007", "null,NA,0,nan, 2 ,3"]
    corpus = made.read(
        made.csv(tmp_path, *rows, header=made.HEADER.replace("place", '"the, place"'))
    )
    assert corpus.captures.to_dict("list") == {
        "subject": ["0x1f", "null"],
        "gesture": ["pat", "NA"],
        "the, place": ["0x2", "nan"],
    }
    assert corpus.frames.ravel().tolist() == [1000, 0.5, 1, 7, 2, 3]
    for make in (made.parquet, made.npz):
        assert set(made.read(make(tmp_path, subject=[" ann", "ann "])).subjects) == {"ann"}
        assert set(made.read(make(tmp_path, subject=["jürgen".encode()] * 2)).subjects) == {
            "jürgen"
        }


def square(*names, **columns):
    """A frame of 2 x 2 taxels; the value of a channel is the number in its name."""
    values = [int("".join(c for c in name if c.isdecimal()) or 0) for name in names]
    table = pd.DataFrame(
        [["ann", "pat", 0, *values]], columns=["subject", "gesture", "frame", *names]
    )
    return table.assign(**columns)


@pytest.mark.parametrize(
    ("names", "conditions", "warned"),
    [
        ("ch1 ch2 ch3 ch4", [], False),
        ("ch3 ch1 ch4 ch2", [], True),
        ("ch1 ch2 ch3 ch4 temp7", ["temp7"], False),
        ("cell04 cell03 cell02 cell01", [], True),
        ("room a1z b2z a3z b4z", ["room"], False),  # numbers that are not at the end: file order
    ],
)
def test_numbered_channels_go_by_their_numbers(tmp_path, names, conditions, warned):
    corpus = read(stored(square(*names.split()), tmp_path, "csv"), rate_hz=54.0, grid="2x2")
    assert corpus[0][0].tolist() == [[1, 2], [3, 4]]
    assert list(corpus.captures) == ["subject", "gesture", *conditions]
    assert any("order of their numbers" in w for w in corpus.info["warnings"]) is warned


FOUR = ["ch1", "ch2", "ch3", "ch4"]


@pytest.mark.parametrize(
    ("table", "facts"),
    [
        (square(*FOUR, "ch5"), ["extra: ch5"]),
        (square("ch1", "ch2", "ch4"), ["missing: ch3"]),
        (square(*FOUR).drop(columns="frame"), ["capture", "frame"]),
        (square(*FOUR)[:0], ["no frames"]),
        (square(*FOUR, ch2=np.nan), ["row 1", "ch2", "nan"]),
        (square(*FOUR, capture=None), ["capture"]),
        (square(*FOUR, frame=7), ["row 1", "7"]),
    ],
)
def test_a_frame_that_does_not_fit_the_model_is_refused(table, facts):
    with pytest.raises(InputError) as error:
        corpus_from_table(table, FOUR, 54.0, (2, 2), 1023.0, "input")
    message = str(error.value)
    assert (
        message.startswith("input")
        and "\n" not in message
        and all(fact in message for fact in facts)
    ), message


def test_captures_of_a_frame_with_or_without_names_and_numbers():
    table = pd.concat([square(*FOUR[::-1])] * 3, ignore_index=True).assign(
        capture=[3, 3, 7], frame=[0, 1, 0]
    )
    for part, names, lengths in (
        (table, ["3", "7"], [2, 1]),
        (table.drop(columns="frame"), ["3", "7"], [2, 1]),
        (table.drop(columns="capture"), ["1", "2"], [2, 1]),
        (table.assign(frame=0.0), ["3", "3", "7"], [1, 1, 1]),
    ):
        corpus = corpus_from_table(part, FOUR, 54.0, (2, 2), 1023.0, "input")
        assert corpus.captures["capture"].tolist() == names and corpus.lengths.tolist() == lengths
        assert corpus[0][0].tolist() == [[1, 2], [3, 4]] and corpus.frames.dtype == np.uint16
