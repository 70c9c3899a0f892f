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


PLACED = [
    "r0c0 r0c1 r1c0 r1c1",
    "r0_c9 r0_c10 r1_c9 r1_c10",
    "row1col1 row1col2 row2col1 row2col2",
    "c0r0 c1r0 c0r1 c1r1",
    "x0y0 x1y0 x0y1 x1y1",
    "p_0_0 p_0_1 p_1_0 p_1_1",
    "1_1 1_2 2_1 2_2",
    "taxel[0][0] taxel[0][1] taxel[1][0] taxel[1][1]",
    "(0;0) (0;1) (1;0) (1;1)",
    "R01C01 R01C02 R02C01 R02C02",
]


@pytest.mark.parametrize("names", PLACED)
@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 2, 1, 3), (3, 1, 0, 2)])
def test_channels_that_name_a_place_are_put_there(tmp_path, names, order):
    in_file = [names.split()[taxel] for taxel in order]
    labels = {"subject": ["ann"], "gesture": ["pat"], "frame": [0], "room_1_2": ["a"]}
    table = pd.DataFrame(labels | {name: [5 + t] for name, t in zip(in_file, order, strict=True)})
    corpus = read(stored(table, tmp_path, "csv"), rate_hz=54.0, grid="2x2")
    assert corpus[0][0].tolist() == [[5, 6], [7, 8]] and "room_1_2" in corpus.captures
    for grid in ("4x1", "1x4"):
        with pytest.raises(InputError, match=f"say a grid of 2x2, not {grid}; correct the names"):
            read(stored(table, tmp_path, "csv"), rate_hz=54.0, grid=grid)


@pytest.mark.parametrize(
    ("names", "reason"),
    [
        ("r0c0 r0c1 r1c0 r2c1", "say a grid of 3x2, not 2x2"),
        ("r0c0 r0c1 r01c01 r1c1", "lack row 1, column 0"),
        ("r0c0 r0c1 r1c0 r1c1 r01c01", "another column is, too"),
        ("b c d mean", "mean is one of the last 4 columns"),
        ("b c d p_max", "p_max is one of the last 4 columns"),
        ("b c d Sum", "Sum is one of the last 4 columns"),
    ],
)
def test_names_that_contradict_the_grid_are_refused(tmp_path, names, reason):
    labels = {"subject": ["ann"], "gesture": ["pat"], "frame": [0], "a": [0]}
    table = pd.DataFrame(labels | {name: [1] for name in names.split()})
    with pytest.raises(InputError, match=reason):
        read(stored(table, tmp_path, "csv"), rate_hz=54.0, grid="2x2")


def frames_table(lengths, counter, **columns):
    """A row for each frame; captures differ in ``take``, and ``counter`` numbers their frames."""
    take = np.repeat(np.arange(len(lengths)), lengths)
    frame = np.concatenate([[counter(i) for i in range(length)] for length in lengths])
    labels = {"subject": "ann", "gesture": "pat", "take": take, "frame": frame}
    return pd.DataFrame(labels | columns | {"x": np.arange(len(take)) % 7, "y": 1})


@given(
    st.integers(3, 80),
    st.integers(0, 1),
    st.lists(st.integers(1, 300), min_size=1, max_size=6),
)
def test_a_counter_that_wraps_is_joined_with_a_word(tmp_path, period, origin, lengths):
    table = frames_table(lengths, lambda i: i % period + origin)
    corpus = read(stored(table, tmp_path, "csv"), rate_hz=54.0, grid="1x2")
    cuts = sum((length - 1) // period for length in lengths)
    wrapped = [length for length in lengths if length > period]
    tells = sum(length % period > 0 for length in wrapped) > len(wrapped) / 2
    if cuts and tells and (cuts >= 3 or period == 64):
        assert corpus.lengths.tolist() == lengths
        (word,) = [w for w in corpus.info["warnings"] if "wraps" in w]
        assert f"again after {period - 1 + origin} {cuts} times" in word
    else:
        assert len(corpus) == len(lengths) + cuts
    assert np.array_equal(corpus.frames[:, 0, 0], table["x"])


def test_captures_of_one_length_or_of_several_are_no_counter_that_wraps(tmp_path):
    for lengths in ([30] * 6, [30, 20, 25, 30, 12], [256, 256], [30, 30, 30, 12]):
        table = frames_table(lengths, lambda i: i).drop(columns="take")
        table["gesture"] = np.where(np.arange(len(table)) < len(table) // 2, "pat", "rub")
        table["gesture"] = table["gesture"].where(table["frame"] == 0).ffill()
        corpus = read(stored(table, tmp_path, "csv"), rate_hz=54.0, grid="1x2")
        assert corpus.lengths.tolist() == lengths


@pytest.mark.parametrize("start", [0, 1, 7])
def test_a_column_that_changes_within_captures_is_named_before_frames_are(tmp_path, start):
    table = frames_table([4, 5], lambda i: i + start)
    table.insert(3, "time_ms", np.arange(9) * 20)
    table.insert(3, "total", np.arange(9) + 5)
    reason = r"line 3: (time_ms|total) changes within a capture \(so does .*\); delete the column"
    with pytest.raises(InputError, match=reason):
        read(stored(table, tmp_path, "csv"), rate_hz=54.0, grid="1x2")
    with pytest.raises(InputError, match="line 2: a capture starts at frame 7"):
        read(stored(frames_table([4], lambda i: i + 7), tmp_path, "csv"), 54.0, "1x2")


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
