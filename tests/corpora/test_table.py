import zipfile

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.read.table import from_frame, read
from bench.errors import InputError


def rows(values=((1, 2, 3, 4, 5, 6), (7, 8, 9, 10, 11, 12), (0, 0, 0, 0, 0, 1)), origin=0):
    return pd.DataFrame(
        [
            ("ann", "pat", "arm", origin, *values[0]),
            ("ann", "pat", "arm", origin + 1, *values[1]),
            ("bob", "rub", "leg", origin, *values[2]),
        ],
        columns=["subject", "gesture", "place", "frame", *(f"x{i}" for i in range(6))],
    )


@pytest.mark.parametrize("origin", [0, 1])
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_any_grid_rate_and_conditions(tmp_path, kind, origin):
    path = tmp_path / f"my.{kind}"
    rows(origin=origin).to_csv(path, index=False) if kind == "csv" else rows(origin=origin).to_parquet(path)
    corpus = read(path, rate_hz=54.0, grid="2x3", full_scale=100.0)
    assert corpus.grid == (2, 3) and corpus.frames.dtype == np.uint16 and list(corpus.lengths) == [2, 1]
    assert corpus[0][1].tolist() == [[7, 8, 9], [10, 11, 12]]
    assert corpus.captures.to_dict("list") == {
        "subject": ["ann", "bob"],
        "gesture": ["pat", "rub"],
        "place": ["arm", "leg"],
    }
    assert (corpus.rate_hz, corpus.full_scale) == (54, 100)


@pytest.mark.parametrize("marks", [(1, 1), (True, True), ("true", "TRUE"), (0, 0), (False, True), ("1", "0")])
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_column_marks_generated_captures(tmp_path, kind, marks):
    path, table = tmp_path / f"my.{kind}", rows()
    table.insert(2, "synthetic", [marks[0], marks[0], marks[1]])
    table.to_csv(path, index=False) if kind == "csv" else table.to_parquet(path)
    corpus = read(path, rate_hz=54.0, grid="2x3")
    assert corpus.synthetic is (marks != (0, 0))
    assert ("synthetic" in corpus.captures) is (len({str(m).lower() for m in marks}) > 1)


def test_a_mark_that_says_neither_is_refused(tmp_path):
    table = rows()
    table.insert(2, "synthetic", ["true", "true", "perhaps"])
    table.to_csv(tmp_path / "my.csv", index=False)
    with pytest.raises(InputError, match="my.csv: synthetic is perhaps in capture 2; give true"):
        read(tmp_path / "my.csv", rate_hz=54.0, grid="2x3")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_decimals_are_kept(tmp_path, kind):
    table = rows(((0.25, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, 1.0), (0, 0, 0, 0, 0, 0.5)))
    path = tmp_path / f"my.{kind}"
    table.to_csv(path, index=False) if kind == "csv" else table.to_parquet(path)
    corpus = read(path, rate_hz=20.0, grid="1x6", full_scale=1.0)
    assert corpus.frames.dtype == np.float32 and corpus[0][0, 0, 0] == 0.25 and corpus[1][0, 0, 5] == 0.5


def test_npz(tmp_path):
    frames = np.arange(24).reshape(6, 2, 2)
    np.savez(tmp_path / "a.npz", frames=frames, offsets=[0, 2, 6], subject=[1, 2], gesture=["pat", "rub"], day=[3, 4])
    corpus = read(tmp_path / "a.npz", rate_hz=100.0)
    assert np.array_equal(corpus[1], frames[2:]) and corpus.captures.to_dict("list") == {
        "subject": ["1", "2"],
        "gesture": ["pat", "rub"],
        "day": [3, 4],
    }
    with pytest.raises(InputError, match="2x2, grid= says 4x1"):
        read(tmp_path / "a.npz", rate_hz=100.0, grid="4x1")


def test_broken_npz(tmp_path):
    good = {"frames": np.zeros((6, 2, 2)), "offsets": [0, 2, 6], "subject": ["1", "2"], "gesture": ["a", "b"]}
    for change, message in [
        ({"offsets": [0, 2, 5]}, "offsets must rise from 0 to 6"),
        ({"offsets": [0, 2, 2, 6]}, "offsets must rise"),
        ({"offsets": [0.0, 2.0, 6.0]}, "offsets must rise"),
        ({"subject": ["1"]}, "subject has shape"),
        ({"frames": np.zeros((6, 4))}, "instead of"),
        ({"frames": np.full((6, 2, 2), -1)}, "frame 1: channel 1 is -1"),
        ({"frames": np.full((6, 2, 2), np.nan)}, "channel 1 is nan"),
        ({"gesture": np.array(["a", {}], dtype=object)}, "plain arrays"),
        ({"offsets": np.array([0, 7, 6], dtype=np.uint64)}, "offsets must rise"),
        ({"subject": np.array([1.5, np.nan])}, "subject is of type float64; save it as text or whole numbers"),
        ({"subject": ["1", ""]}, "capture 2: subject is empty"),
        ({"day": np.array([1j, 2])}, "day is of type complex128"),
        ({"frames": np.full((6, 2, 2), np.inf)}, "channel 1 is inf"),
        ({"frames": np.full((6, 2, 2), 1024)}, "channel 1 is 1024"),
    ]:
        np.savez(tmp_path / "b.npz", **(good | change))
        with pytest.raises(InputError, match=message):
            read(tmp_path / "b.npz", rate_hz=10.0)
    del good["gesture"]
    np.savez(tmp_path / "b.npz", **good)
    with pytest.raises(InputError, match="no array gesture"):
        read(tmp_path / "b.npz", rate_hz=10.0)
    (tmp_path / "c.npz").write_bytes(b"PK\x03\x04")
    with pytest.raises(InputError, match="plain arrays"):
        read(tmp_path / "c.npz", rate_hz=10.0)


def test_words_for_nothing_are_labels_like_others(tmp_path):
    (tmp_path / "my.csv").write_text("subject,gesture,frame,place,a\nnull,pat,0,NA,1\nnan,pat,0,n/a,2\n")
    captures = read(tmp_path / "my.csv", rate_hz=10.0, grid="1x1").captures
    assert captures["subject"].tolist() == ["null", "nan"] and captures["place"].tolist() == ["NA", "n/a"]


def test_files_that_are_not_npz(tmp_path):
    path = tmp_path / "d.npz"

    def refused(message):
        with pytest.raises(InputError, match=message) as error:
            read(path, rate_hz=10.0)
        assert "\n" not in str(error.value)

    path.write_bytes(b"")
    refused("plain arrays")
    np.save(tmp_path / "one.npy", np.zeros(3))
    (tmp_path / "one.npy").rename(path)
    refused("plain arrays")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("frames.txt", "hello")
    refused("frames.txt is not an array")
    np.savez_compressed(path, frames=np.random.default_rng(0).random((600, 2, 2)))
    content = bytearray(path.read_bytes())
    content[120:400] = bytes(280)
    path.write_bytes(content)
    refused("plain arrays")
    path.unlink()
    path.mkdir()
    refused("a folder")


def test_npz_labels_of_bytes_are_text(tmp_path):
    np.savez(tmp_path / "a.npz", frames=np.zeros((2, 1, 1)), offsets=[0, 2], subject=[b"ann"], gesture=["pat"])
    assert read(tmp_path / "a.npz", rate_hz=10.0).captures.iloc[0].tolist() == ["ann", "pat"]


def test_broken_parquet(tmp_path):
    path = tmp_path / "p.parquet"
    for change, message in [
        ({"frame": [0, 1.5, 0]}, "row 2: frame is 1.5, not a whole number"),
        ({"frame": ["a", "b", "c"]}, "frame is not a column of numbers"),
        ({"x2": ["a", "b", "c"]}, "x2 is not a column of numbers"),
        ({"x2": [1, -1, 1]}, "row 2: x2 is -1"),
        ({"place": [[1], [2], [3]]}, "place holds lists"),
        ({"place": ["arm", None, "leg"]}, "row 2: place is empty"),
        ({" place": ["arm", "arm", "leg"]}, "column 'place' stands twice"),
    ]:
        table = rows().assign(**change)
        labels = [c for c in table if c[0] != "x"]
        table[labels + [c for c in table if c not in labels]].to_parquet(path)
        with pytest.raises(InputError, match=message):
            read(path, rate_hz=54.0, grid="2x3")
    path.write_bytes(b"PAR1")
    with pytest.raises(InputError, match="not a readable parquet file"):
        read(path, rate_hz=54.0, grid="2x3")


def test_spaces_in_the_header_of_parquet(tmp_path):
    rows().rename(columns=lambda name: f" {name}").to_parquet(tmp_path / "p.parquet")
    assert list(read(tmp_path / "p.parquet", rate_hz=54.0, grid="2x3").captures) == ["subject", "gesture", "place"]


@given(st.lists(st.integers(1, 9), min_size=1, max_size=12), st.integers(0, 2**32), st.sampled_from([0, 1]))
def test_ragged_captures_are_the_same_from_every_kind_of_file(tmp_path, lengths, seed, origin):
    rng = np.random.default_rng(seed)
    frames = rng.integers(0, 1024, (sum(lengths), 2, 3))
    labels = {
        "subject": [f"s{i % 3}" for i in range(len(lengths))],
        "gesture": rng.choice(["pat", "rub"], len(lengths)),
        "place": rng.choice(["arm", "leg"], len(lengths)),
    }
    table = pd.DataFrame({name: np.repeat(values, lengths) for name, values in labels.items()})
    table["frame"] = np.concatenate([np.arange(origin, origin + n) for n in lengths])
    table = pd.concat([table, pd.DataFrame(frames.reshape(-1, 6)).add_prefix("x")], axis=1)
    table.to_csv(tmp_path / "a.csv", index=False)
    table.to_parquet(tmp_path / "a.parquet")
    np.savez(tmp_path / "a.npz", frames=frames, offsets=np.cumsum([0, *lengths]), **labels)
    for kind in ("csv", "parquet", "npz"):
        corpus = read(tmp_path / f"a.{kind}", rate_hz=54.0, grid="2x3")
        assert np.array_equal(corpus.frames, frames) and corpus.frames.dtype == np.uint16
        assert list(corpus.lengths) == lengths
        assert corpus.captures.to_dict("list") == {name: list(values) for name, values in labels.items()}


def test_broken_tables(tmp_path):
    path = tmp_path / "my.csv"

    def refused(message, text=None, **options):
        if text is not None:
            path.write_text(text)
        with pytest.raises(InputError, match=message) as error:
            read(path, **({"rate_hz": 54.0, "grid": "2x3", "full_scale": 100.0} | options))
        assert "\n" not in str(error.value)

    refused("no such file", rate_hz=1.0)
    good = rows().to_csv(index=False)
    refused("give the grid", good, grid="")
    refused("grid=2by3", good, grid="2by3")
    refused("rate_hz=0", good, rate_hz=0.0)
    refused("cannot hold", good, grid="3x3")
    refused("no column gesture", good.replace("gesture", "label"))
    refused("line 3: x1 is 101, not within 0 and the full scale 100", good.replace("7,8,", "7,101,"))
    refused("line 3: x1 is inf, not within", good.replace("7,8,", "7,inf,"))
    refused("line 3: x1 is nan, not within", good.replace("7,8,", "7,nan,"))
    refused("line 3: x1 is 'abc', not a number", good.replace("7,8,", "7,abc,"))
    refused("line 3: x1 is -8, not within 0", good.replace("7,8,", "7,-8,"))
    refused("line 2: a capture starts at frame 7", good.replace("arm,0,", "arm,7,"))
    refused("line 4: a capture starts at frame 7", good.replace("leg,0,", "leg,7,"))
    refused("line 3: a capture starts at frame 1", good.replace("arm,1,", "leg,1,"))  # another place, no restart
    refused("line 3: frame is '1.5', not a whole number", good.replace("arm,1,", "arm,1.5,"))
    refused("rate_hz=inf", good, rate_hz=float("inf"))
    refused("cannot be called p_hand", good.replace("place", "p_hand"))
    refused("cannot be called fold", good.replace("place", "fold"))
    refused("line 3: place is empty", good.replace("arm,1,", ",1,"))
    rows().assign(x3=[1, None, 2]).to_parquet(tmp_path / "p.parquet")
    with pytest.raises(InputError, match="row 2: x3 is nan"):
        read(tmp_path / "p.parquet", rate_hz=54.0, grid="2x3")


def square(*names, before=()):
    """One capture of one frame on 2 x 2 taxels; the value of a channel is the number in its name."""
    values = [int("".join(c for c in name if c.isdecimal()) or 0) for name in names]
    labels = {"subject": "ann", "gesture": "pat", **dict.fromkeys(before, 9), "frame": 0}
    return pd.DataFrame([[*labels.values(), *values]], columns=[*labels, *names])


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("names", "conditions", "warned"),
    [
        (("ch1", "ch2", "ch3", "ch4"), [], False),
        (("ch3", "ch1", "ch4", "ch2"), [], True),
        (("ch1", "ch2", "room", "ch3", "ch4"), ["room"], False),
        (("ch1", "ch2", "ch3", "ch4", "temp7"), ["temp7"], False),
        (("cell04", "cell03", "cell02", "cell01"), [], True),
        (("1", "2", "3", "4", "room"), ["room"], False),
    ],
)
def test_numbered_channels_go_by_their_numbers(tmp_path, kind, names, conditions, warned):
    path, table = tmp_path / f"my.{kind}", square(*names)
    table.to_csv(path, index=False) if kind == "csv" else table.to_parquet(path)
    corpus = read(path, rate_hz=54.0, grid="2x2")
    assert corpus[0][0].tolist() == [[1, 2], [3, 4]]
    assert list(corpus.captures) == ["subject", "gesture", *conditions]
    assert any("order of their numbers" in w for w in corpus.info["warnings"]) is warned


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("ch1", "ch2", "ch3", "ch4", "ch5"), "2x2 has 4 channels, ch1 to ch4: ch5 is extra"),
        (("ch0", "ch1", "ch2", "ch3", "ch4"), "ch0 to ch3: ch4 is extra"),
        (("ch2", "ch3", "ch4", "ch5"), "ch1 to ch4: ch1 is missing, ch5 is extra"),
        (("ch1", "ch2", "ch4", "temp"), "ch1 to ch4: ch3 is missing"),
        (("cell1", "cell2", "cell4", "cell8"), "cell1 to cell4: cell3 is missing, cell8 is extra"),
        (("cell1", "cell2", "cell3", "temp", "cell4", "cell5"), "cell1 to cell4: cell5 is extra"),
        (("ch1", "ch01", "ch2", "ch3", "ch4"), "ch1 to ch4: ch01 is extra"),
        (("ch1",), "ch1 to ch4: ch2, ch3, ch4 are missing"),
        (tuple(f"ch{i}" for i in range(1, 12)), "ch5, ch6, ch7 and 4 more are extra"),
    ],
)
def test_numbered_channels_that_are_missing_or_extra_are_named(tmp_path, kind, names, message):
    path, table = tmp_path / f"my.{kind}", square(*names)
    table.to_csv(path, index=False) if kind == "csv" else table.to_parquet(path)
    with pytest.raises(InputError, match=message):
        read(path, rate_hz=54.0, grid="2x2")


def test_names_with_two_numbers_stay_in_file_order(tmp_path):
    names = ["x0y0", "x1y0", "x0y1", "x1y1"]
    square(*names).assign(**dict(zip(names, range(4), strict=True))).to_csv(tmp_path / "my.csv", index=False)
    assert read(tmp_path / "my.csv", rate_hz=54.0, grid="2x2")[0][0].tolist() == [[0, 1], [2, 3]]


def test_a_frame_with_other_channels_than_the_model_is_refused():
    channels = ["ch1", "ch2", "ch3", "ch4"]
    for names, message in (
        (("ch1", "ch2", "ch3", "ch4", "ch5"), "input: a grid of 2x2 has 4 channels, ch1 to ch4: ch5 is extra"),
        (("ch1", "ch2", "ch4"), "ch3 is missing"),
        (("ch0", "ch1", "ch2", "ch3"), "no column ch4"),
        (("a", "b", "c", "d"), "no column ch1"),
    ):
        with pytest.raises(InputError, match=message):
            from_frame(square(*names), channels, 54.0, (2, 2), 1023.0, "input")
    assert from_frame(square(*channels[::-1]), channels, 54.0, (2, 2), 1023.0, "input")[0][0].tolist() == [
        [1, 2],
        [3, 4],
    ]
