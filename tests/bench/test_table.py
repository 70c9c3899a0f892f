import numpy as np
import pandas as pd
import pytest

from bench.corpora.table import read
from bench.corpus import InputError


def rows(values=((1, 2, 3, 4, 5, 6), (7, 8, 9, 10, 11, 12), (0, 0, 0, 0, 0, 1)), origin=0):
    return pd.DataFrame(
        [("ann", "pat", "arm", origin, *values[0]), ("ann", "pat", "arm", origin + 1, *values[1]),
         ("bob", "rub", "leg", origin, *values[2])],
        columns=["subject", "gesture", "place", "frame", *(f"x{i}" for i in range(6))],
    )  # fmt: skip


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
        "subject": ["1", "2"], "gesture": ["pat", "rub"], "day": [3, 4]}  # fmt: skip
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
    refused("line 3: x1 is 101, above the full scale 100", good.replace("7,8,", "7,101,"))
    refused("line 3: x1 is 'inf'|line 3: x1 is inf", good.replace("7,8,", "7,inf,"))
    refused("line 3: x1 is 'abc', not a number", good.replace("7,8,", "7,abc,"))
    refused("line 3: x1 is -8, below 0", good.replace("7,8,", "7,-8,"))
    refused("line 2: a capture starts at frame 7", good.replace("arm,0,", "arm,7,"))
    refused("line 4: a capture starts at frame 7", good.replace("leg,0,", "leg,7,"))
    refused("cannot be called p_hand", good.replace("place", "p_hand"))
    refused("cannot be called fold", good.replace("place", "fold"))
    refused("line 3: place is empty", good.replace("arm,1,", ",1,"))
    rows().assign(x3=[1, None, 2]).to_parquet(tmp_path / "p.parquet")
    with pytest.raises(InputError, match="row 2: channel 4 is nan"):
        read(tmp_path / "p.parquet", rate_hz=54.0, grid="2x3")
