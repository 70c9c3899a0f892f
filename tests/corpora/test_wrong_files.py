"""Wrong files are refused in a line that names place and reason; nothing in them is run."""

import os
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.corpora.library import import_corpus, open_corpus
from bench.corpora.read import haart
from bench.errors import InputError
from bench.ground.scratch import data_folder
from tests.corpora import made
from tests.corpora.made import (
    GOOD,
    HEADER,
    RELEASE,
    SESSION,
    archive,
    csv,
    line,
    npz,
    parquet,
    raw,
    read,
)

UNSEEN = ["a\0b", "a\u2028b", "\ufeffa", "x" * 201, " "]


def assert_refused(kind, path, *facts, **options):
    """A reader refuses the file in one line with these facts in it."""
    with pytest.raises(InputError) as error:
        made.READERS[kind](path, **options)
    message = str(error.value)
    assert (
        len(message) <= 300 and message.isprintable() and all(fact in message for fact in facts)
    ), message


ROWS = [  # a second row of a table, and what the message names beside file and line
    *((f"ann,pat,1,arm,{cell},2", ["a"]) for cell in "0xg ٣ nan -8 1e39".split()),
    *((f"ann,pat,{cell},arm,1,2", ["frame"]) for cell in "1_0 1.5".split()),
    ("ann,pat,1,arm,1,0,2", ["7", "6"]),
    ("ann,pat,1,arm,1,2000000000", ["b", "2000000000", "1e+09"]),
    ("ann,pat,1,arm,1,16777217", ["b", "16777217"]),
    ("ann,pat,7,arm,1,2", ["7"]),
    ("ann,pat,1,leg,1,2", ["place changes within a capture; delete the column"]),
    ("\udcff,pat,1,arm,1,2", ["UTF-8"]),
    ("ann,pat,1,arm\r,1,2", []),
    ('ann,pat,1,"arm\n",1,2', ["place", "cannot be seen"]),
    *((f"{word},pat,0,arm,1,2", ["subject"]) for word in UNSEEN),
]
CONTENTS = [
    (b"\x89PNG\xff\xfe" * 20, ["UTF-8"]),
    (HEADER, ["no frames"]),
    (HEADER + '\nann,pat,0,arm,1,"2', ["quote"]),
    (HEADER.replace("place", ""), ["line 1", "column 4"]),
    (HEADER.replace("place", "frame"), ["line 1", "frame"]),
    (HEADER.replace("gesture", "label"), ["line 1", "gesture"]),
    (HEADER.replace("place", ",".join(f"c{i}" for i in range(300))), ["line 1", "303", "256"]),
    (HEADER.replace("place", "fold") + "\nann,pat,0,arm,1,2\n", ["fold"]),
    (
        HEADER.replace("place", "synthetic") + "\nann,pat,0,perhaps,1,2\n",
        ["synthetic", "perhaps", "1"],
    ),
    (
        HEADER.encode() + b"\n" + b"ann,pat,0,arm,1,2\n" * 3000 + b"ann,\xe9,0,arm,1,2\n",
        ["line 3002"],
    ),
]
ARRAYS = [
    *(
        ({"offsets": offsets}, ["offsets", "3"])
        for offsets in ([0, 2, 2], [0, 4, 3], [0.0, 2.0, 3.0])
    ),
    *(
        ({"frames": frames}, ["frames"])
        for frames in (np.zeros((3, 2)), np.ones((3, 1, 2), complex))
    ),
    *(({"frames": np.full((3, 1, 2), v)}, ["frame 1", "channel 1"]) for v in (-1, np.nan, 1e10)),
    ({"subject": ["1"]}, ["subject", "(1,)", "2"]),
    *(({"day": ["ann", word]}, ["capture 2", "day"]) for word in UNSEEN[1:]),
    ({"gesture": None}, ["gesture"]),
]
COLUMNS = [
    *(
        ({"b": values}, ["b"])
        for values in ([True, False], ["1", "2"], [[1], [2]], pa.array([1, 2], pa.duration("s")))
    ),
    *(
        ({"frame": frames}, ["row", "frame"])
        for frames in ([0, 1.5], [0, None], [0, 2.0**60], [0, 2], [7, 8])
    ),
    *(({"b": [1, value]}, ["row 2", "b"]) for value in (-1, None, np.inf)),
    *(({"place": ["ann", word]}, ["row 2", "place"]) for word in UNSEEN),
    ({"subject": [], "gesture": [], "frame": [], "a": [], "b": []}, []),
]
COST = [line(frame=f) for f in (1, 2, 3)]
COST_LINES = [
    (line(2, frame=7), ["7"]),
    (line(frame=3), ["frame 3"]),
    *((line(frame=4, values=[v, *range(63)]), ["ch1", repr(v)]) for v in ("x", "1.5", "99999", "")),
    (line(frame=4, values=[*range(63), 1024]), ["ch64", "1024", "1023"]),
    (line(frame=4)[:40], ["19", "68"]),
    (line(gesture=15), ["gesture", "15", "14"]),
]
COST_HEADERS = [
    ("subject, variant, gesture, frame, ch1", ["line 1", "ch2", "60 more"]),
    (made.COST_HEADER + ", extra", ["line 1", "extra"]),
]


def without_line(text, at):
    return "\n".join([*text.splitlines()[:at], *text.splitlines()[at + 1 :]])


TRAINING, TESTING = RELEASE.values()
TWO = made.training_csv(("P4", "pat"), ("X10", "pat"))
RELEASES = [
    ({"training.csv": None}, ["training.csv"]),
    ({"training.csv": without_line(TRAINING, 432)}, ["training.csv, line 2", "431", "432"]),
    (
        {"training.csv": TRAINING.replace("pat", "wave")},
        ["training.csv, line 2", "Gesture", "wave"],
    ),
    ({"training.csv": TWO}, ["training.csv, line 434", "ParticipantNo", "X10"]),
    (
        {"testWITHLABELS.csv": without_line(TESTING, 10)},
        ["testWITHLABELS.csv, line 11", "frame 11", "frame 9"],
    ),
    (
        {"testWITHLABELS.csv": TESTING.replace("Sequence,", "")},
        ["testWITHLABELS.csv, line 1", "Sequence"],
    ),
    ({"old/training.csv": TRAINING}, ["training.csv", "twice"]),
]
RECORDING = b"1,2,3,4,5,6,7,8,9,10\n" * 5400
RECORDINGS = [
    ({SESSION: b"x" + RECORDING}, [f"{SESSION}, line 1", "not a whole number"]),
    ({SESSION: RECORDING[21:]}, [SESSION, "5399 lines", "5400"]),
    ({SESSION: b"1,2\n3,4\n"}, [SESSION, "2 fields instead of 10"]),
    ({f"{i}/{SESSION}": RECORDING for i in "12"}, [SESSION, "in it twice"]),
]


def release(folder, parts):
    return archive(folder, parts={name: text for name, text in (RELEASE | parts).items() if text})


def recordings(folder, files):
    return [raw(folder, name, content) for name, content in files.items()] and folder


def changed(path, change):
    return raw(path.parent, path.name, change(path.read_bytes()))


ZIPS = [("haart", "b.zip"), ("table", "b.npz"), ("table", "b.parquet"), ("cost", "b.csv")]
STARTS = [b"", b"PK\x03\x04", b"PAR1", b"\x93NUMPY\x01\x00v\x00{'descr'"]
DAMAGE = [lambda c: c[:200] + bytes(200) + c[400:], lambda c: c[: len(c) // 2]]
PLACES = ["/dev/zero", "/dev/null", "nowhere", "."]
WRONG = [  # format, a function that writes the file, facts of the one line
    *(
        ("table", lambda p, r=r: csv(p, GOOD[0], r, GOOD[1]), ["my.csv, line 3", *f])
        for r, f in ROWS
    ),
    *(("table", lambda p, c=c: raw(p, "my.csv", c), ["my.csv", *f]) for c, f in CONTENTS),
    *(("table", lambda p, a=a: npz(p, **a), ["my.npz", *f]) for a, f in ARRAYS),
    *(("table", lambda p, c=c: parquet(p, **c), ["my.parquet", *f]) for c, f in COLUMNS),
    *(
        ("cost", lambda p, b=b: made.cost_csv(p, *COST, b, line(frame=4)), ["CoST.csv, line 5", *f])
        for b, f in COST_LINES
    ),
    *(("cost", lambda p, h=h: csv(p, line(), header=h), f) for h, f in COST_HEADERS),
    *(("haart", lambda p, a=a: release(p, a), f) for a, f in RELEASES),
    *(("cuddlebot", lambda p, r=r: recordings(p, r), f) for r, f in RECORDINGS),
    *((k, lambda p, n=n, c=c: raw(p, n, c), [n]) for k, n in ZIPS for c in STARTS),
    *(("haart", lambda p, d=d: changed(archive(p), d), ["r.zip"]) for d in DAMAGE),
    *(("table", lambda p, d=d: changed(npz(p), d), ["my.npz"]) for d in DAMAGE),
    *(
        ("haart", lambda p, k=k: archive(p, k), ["r.zip", "deflate"])
        for k in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    ),
    *((kind, lambda p, n=n: p / n, []) for kind in made.READERS for n in PLACES),
]


@pytest.mark.parametrize(("kind", "make", "facts"), WRONG, ids=range(len(WRONG)))
def test_a_file_that_cannot_be_is_refused_by_place_and_reason(tmp_path, kind, make, facts):
    assert_refused(kind, make(tmp_path), *facts)


OPTIONS = [
    *(("full_scale", value) for value in (1e300, 1e-50, -1.0, np.nan)),
    *(("rate_hz", value) for value in (0.0, np.nan, np.inf)),
    *(("grid", value) for value in ("2by3", "0x2", "٣x1", f"1x{'9' * 5000}", "1000000x1000000")),
]


@pytest.mark.parametrize(("key", "value"), OPTIONS)
def test_options_that_cannot_be(tmp_path, key, value):
    assert_refused("table", csv(tmp_path), key, **{key: value})


def test_lines_are_counted_across_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.corpora.read.rows.BLOCK", 40)
    for count in (1, 60):
        assert_refused("table", csv(tmp_path, GOOD[0], *[""] * count, GOOD[1]), "line 3")
        assert read(csv(tmp_path, *GOOD, *[""] * count)).lengths.tolist() == [2]
    assert_refused("table", csv(tmp_path, *GOOD, "ann,pat,0,arm,-1,2"), "line 4", "a")
    assert_refused("table", parquet(tmp_path, a=[1, -1]), "row 2", "a")
    assert_refused(
        "table",
        csv(tmp_path, GOOD[0], "ann,pat,0,leg,1,2", "ann,pat,1,arm,1,2"),
        "line 4",
        "place changes",
    )


def test_files_that_are_too_large_or_unpack_to_too_much(tmp_path, monkeypatch):
    assert_refused(
        "haart", release(tmp_path, {"training.csv": TRAINING + "\n" * (17 << 20)}), "r.zip", "MiB"
    )
    zeros = pa.array(np.zeros(1 << 20, np.int8))
    pq.write_table(
        pa.table({n: zeros for n in ("subject", "gesture", "frame", "a", "b")}),
        tmp_path / "bomb.parquet",
    )
    assert_refused("table", tmp_path / "bomb.parquet", "bomb.parquet", "MiB")
    monkeypatch.setattr(haart, "LARGEST", 4096)
    assert_refused("haart", archive(tmp_path), "larger")


class Stealing:
    def __reduce__(self):
        return os.mkdir, ("stolen",)


def test_an_array_that_is_pickled_or_not_of_the_size_that_its_header_says(tmp_path):
    for old, new in ((b"(3, 1, 2)", b"(9, 1, 2)"), (b"<f8", b"|O8")):
        with zipfile.ZipFile(npz(tmp_path, offsets=[0, 1, 2])) as packed:
            parts = {name: packed.read(name).replace(old, new) for name in packed.namelist()}
        assert_refused("table", archive(tmp_path, name="my.npz", parts=parts), "my.npz")
    assert_refused(
        "table", npz(tmp_path, gesture=np.array(["pat", Stealing()], dtype=object)), "my.npz"
    )
    assert not os.path.exists("stolen")


def test_a_refused_import_leaves_the_earlier_corpus(tmp_path):
    options = {"name": "arm", "rate_hz": "50", "grid": "1x2"}
    import_corpus("table", csv(tmp_path), options)
    before = sorted(str(path) for path in (data_folder() / "corpora").rglob("*"))
    with pytest.raises(InputError, match="my.parquet"):
        import_corpus("table", parquet(tmp_path, b=[1, -1]), options)
    assert open_corpus("arm", {}).frames.ravel().tolist() == [1, 2, 3, 4]
    assert sorted(str(path) for path in (data_folder() / "corpora").rglob("*")) == before
