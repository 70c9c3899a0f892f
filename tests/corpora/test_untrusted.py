"""Files that look right and are not, and files that look wrong and are right: each in one line that can be read."""

import zipfile

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.corpora.read import cost, haart, table
from bench.corpora.read.cost import CHANNELS
from bench.errors import InputError
from tests.corpora.test_cost import file as cost_file
from tests.corpora.test_cost import line as cost_line
from tests.corpora.test_haart import test_part, training

test_part.__test__ = False
HEADER = "subject,gesture,frame,place,a,b\n"


def refused(message, read, *arguments, **options):
    with pytest.raises(InputError) as error:
        read(*arguments, **options)
    said = str(error.value)
    assert message in said and len(said) <= 300 and said.isprintable(), said


def read(path, **options):
    return table.read(path, **({"rate_hz": 50.0, "grid": "1x2", "full_scale": 1e9} | options))


def csv_file(folder, *rows, header=HEADER):
    (folder / "my.csv").write_bytes((header + "".join(row + "\n" for row in rows)).encode())
    return folder / "my.csv"


def parquet_file(folder, **columns):
    path = folder / "my.parquet"
    given = {"subject": ["ann"] * 2, "gesture": ["pat"] * 2, "frame": [0, 1]} | columns
    given |= {name: given.pop(name, values) for name, values in (("a", [1, 2]), ("b", [3, 4]))}
    pq.write_table(pa.table(given), path)
    return path


def npz_file(folder, **arrays):
    path = folder / "my.npz"
    given = {"frames": np.ones((3, 1, 2)), "offsets": [0, 2, 3], "subject": ["ann", "bob"], "gesture": ["pat", "rub"]}
    np.savez(path, **(given | arrays))
    return path


@pytest.mark.parametrize("scale", [1e300, 3.5e38, 1e-50, 0.0, -1.0, float("nan"), float("inf")])
def test_a_full_scale_that_frames_cannot_hold(tmp_path, scale):
    for path in (csv_file(tmp_path, "ann,pat,0,arm,1e200,2"), parquet_file(tmp_path), npz_file(tmp_path)):
        refused("full_scale=", read, path, full_scale=scale)


def test_values_beyond_what_frames_hold(tmp_path):
    refused(
        "line 2: a is 1e+39, not within 0 and the full scale 3e+38",
        read,
        csv_file(tmp_path, "ann,pat,0,arm,1e39,2"),
        full_scale=3e38,
    )
    refused("row 2: a is 1e+200", read, parquet_file(tmp_path, a=[1, 1e200]), full_scale=3e38)
    refused("frame 1: channel 1 is 1e+200", read, npz_file(tmp_path, frames=np.full((3, 1, 2), 1e200)), full_scale=3e38)


@pytest.mark.parametrize("cell", ["0xg", "1_0", "٣", "1e", "0b1", "1,0"])
def test_cells_that_are_no_decimal_numbers(tmp_path, cell):
    refused("line 3: ", read, csv_file(tmp_path, "ann,pat,0,arm,1,2", f"ann,pat,1,arm,{cell},2"))
    refused("line 3: ", read, csv_file(tmp_path, "ann,pat,0,arm,1,2", f"ann,pat,{cell},arm,1,2"))
    for at in (0, 1, 3, 4, 67):
        cells = cost_line(frame=2).split(",")
        cells[at] = cell
        refused("CoST.csv, line 3: ", cost.read, cost_file(tmp_path, cost_line(), ",".join(cells)))


def test_hexadecimal_words_are_labels_like_others(tmp_path):
    path = csv_file(tmp_path, "0x1f,pat,0,0x2,1e3,.5", "0x1f,pat,1,0x2,+1,0007")
    corpus = read(path)
    assert corpus.captures.iloc[0].tolist() == ["0x1f", "pat", "0x2"]
    assert corpus.frames.ravel().tolist() == [1000, 0.5, 1, 7]


def test_a_byte_order_mark_is_none_behind_the_header(tmp_path):
    refused("line 2: subject is", read, csv_file(tmp_path, "\ufeffann,pat,0,arm,1,2"))


@pytest.mark.parametrize("flaw", ["a\0b", "a\x1bb", "a\x7fb", "a\u2028b", "\ufeffa", "\x85 \x9f", "x" * 201])
def test_labels_that_cannot_be_read(tmp_path, flaw):
    good = "ann,pat,0,arm,1,2"
    for column, word in (("subject", "ann"), ("gesture", "pat"), ("place", "arm")):
        refused(f"line 3: {column} is", read, csv_file(tmp_path, good, good.replace(word, flaw)))
        if "\0" not in flaw:  # NumPy's text ends at a NUL
            refused(f"capture 2: {column} is", read, npz_file(tmp_path, **{column: ["ann", flaw]}))
        refused(
            f"row 2: {column} is",
            read,
            parquet_file(tmp_path, **{column: ["ann", flaw]}),
        )


def test_a_line_break_within_quotes(tmp_path):
    for broken in ('"an\nn",pat,0,arm,1,2', 'ann,pat,0,arm,1,"2\n"', 'ann,pat,0,"arm,1,2'):
        refused("line 3: ", read, csv_file(tmp_path, "ann,pat,0,arm,1,2", broken, "ann,pat,1,arm,1,2"))


def test_names_of_columns_that_cannot_be(tmp_path):
    row = "ann,pat,0,arm,1,2"
    for name in ("", " ", "pl\0ace", "x" * 201):
        header = HEADER.replace("place", name)
        refused("line 1: column ", read, csv_file(tmp_path, row, header=header))
        refused("my.parquet: column ", read, parquet_file(tmp_path, **{name: ["arm"] * 2}))
    refused("my.npz: ", read, npz_file(tmp_path, **{"x" * 201: [1, 2]}))
    header = HEADER.replace("place", '"the, place"')  # a comma within quotes is part of the name
    assert "the, place" in read(csv_file(tmp_path, row, header=header)).captures
    many = ",".join(f"c{i}" for i in range(300))
    refused(
        "line 1: 303 columns before the channels", read, csv_file(tmp_path, row, header=HEADER.replace("place", many))
    )


def test_whole_numbers_are_stored_as_they_are_or_not_at_all(tmp_path):
    for value in (16777217, 2**53 + 1, 2**62 + 1, 2**64 - 1):
        options = {"full_scale": 1e30}
        if value < 2**53:  # from there on a CSV file's numbers are read as float64 has them
            refused(f"line 2: b is {value}, ", read, csv_file(tmp_path, f"ann,pat,0,arm,1,{value}"), **options)
        for kind in {np.uint64, np.int64 if value < 2**63 else np.uint64}:
            frames = np.array([1, value, 1, 1, 1, 1], kind).reshape(3, 1, 2)
            refused("frame 1: channel 2 is ", read, npz_file(tmp_path, frames=frames), **options)
            refused(
                "row 2: b is ",
                read,
                parquet_file(tmp_path, b=pa.array([1, value], pa.from_numpy_dtype(kind))),
                **options,
            )
        frames = np.full((3, 1, 2), float(value))
        if int(float(value)) == value:
            refused("frame 1: channel 1 is ", read, npz_file(tmp_path, frames=frames), **options)
    for value in (16777216, 16777218, 2**25, 2**62):  # a float32 holds these
        for path in (
            csv_file(tmp_path, f"ann,pat,0,arm,0,{value}"),
            parquet_file(tmp_path, a=[0, 0], b=[value, 0]),
            npz_file(tmp_path, frames=np.array([0, value, 0, 0, 0, 0]).reshape(3, 1, 2)),
        ):
            corpus = read(path, full_scale=1e30)
            assert corpus.frames.dtype == np.float32 and int(corpus.frames.ravel()[1]) == value


def test_the_same_values_are_the_same_frames_from_every_kind_of_file(tmp_path):
    for values, kind in (
        ([1, 65535], np.uint16),
        ([1, 65536], np.float32),
        ([0.1, 2], np.float32),
        ([1.0, 2.0], np.uint16),
    ):
        cells = ",".join(map(str, values))
        frames = np.array([*values, *values]).reshape(2, 1, 2)
        for path in (
            csv_file(tmp_path, f"ann,pat,0,arm,{cells}", f"ann,pat,1,arm,{cells}"),
            parquet_file(tmp_path, a=[values[0]] * 2, b=[values[1]] * 2),
            npz_file(tmp_path, frames=frames, offsets=[0, 2], subject=["ann"], gesture=["pat"]),
        ):
            corpus = read(path)
            assert corpus.frames.dtype == kind and np.array_equal(corpus.frames, frames.astype(kind)), path


def test_a_full_scale_that_float32_rounds_is_still_reached(tmp_path):
    for scale in (0.1, 0.3, 0.7):
        for path in (
            csv_file(tmp_path, f"ann,pat,0,arm,{scale},0"),
            parquet_file(tmp_path, a=pa.array([scale, 0], pa.float32()), b=[0, 0]),
            npz_file(tmp_path, frames=np.full((3, 1, 2), scale, np.float32)),
        ):
            assert read(path, full_scale=scale).frames.max() == np.float32(scale)


@pytest.mark.parametrize("empty", ["", " ", "\t", "\u3000"])
def test_empty_labels(tmp_path, empty):
    for name in ("subject", "gesture", "place"):
        path = parquet_file(tmp_path, **{name: ["ann", empty]})
        refused(f"row 2: {name} is empty", read, path)
        refused(f"capture 2: {name} is empty", read, npz_file(tmp_path, **{name: ["ann", empty]}))
        refused(f"capture 2: {name} is empty", read, npz_file(tmp_path, **{name: [b"ann", empty.encode()]}))


def test_labels_of_bytes(tmp_path):
    assert read(parquet_file(tmp_path, subject=["jürgen".encode()] * 2)).subjects.tolist() == ["jürgen"]
    refused("row 2: subject is not text in UTF-8", read, parquet_file(tmp_path, subject=[b"ann", b"\xff\xfe"]))
    refused("subject is not text in UTF-8", read, npz_file(tmp_path, subject=[b"ann", b"\xff\xfe"]))
    broken = np.array([[0x110000], [0xD800]], np.uint32).view("<U1").ravel()
    for i in (0, 1):
        refused("capture 1: subject is ", read, npz_file(tmp_path, subject=broken[[i, i]]))


def test_spaces_around_labels_are_no_part_of_them(tmp_path):
    for path in (
        csv_file(tmp_path, " ann,pat ,0,arm,1,2", "ann ,pat,1, arm,1,2"),
        parquet_file(tmp_path, subject=[" ann", "ann "]),
        npz_file(tmp_path, subject=[" ann", "ann "]),
    ):
        assert set(read(path).subjects) == {"ann"} and len(read(path)) == (2 if path.suffix == ".npz" else 1)


def test_channels_that_are_no_numbers(tmp_path):
    for values in (
        [True, False],
        ["1", "2"],
        [b"1", b"2"],
        [[1], [2]],
        pa.array([1, 2], pa.duration("s")),
        [None, None],
    ):
        refused("b is not a column of numbers", read, parquet_file(tmp_path, b=values))
        refused("my.parquet: frame ", read, parquet_file(tmp_path, frame=values))
    for kind in (bool, complex, "m8[s]", "U1"):
        refused("frames are of type", read, npz_file(tmp_path, frames=np.ones((3, 1, 2)).astype(kind)))
    about = pd.DataFrame({"frame": [0, 1], "a": [True, False], "b": [1, 2]})
    refused("input: a is not a column of numbers", table.from_frame, about, ["a", "b"], 50.0, (1, 2), 1023.0, "input")


@pytest.mark.parametrize(
    "offsets",
    [
        np.array([0, 2, 3], "m8[s]"),
        np.array([0, 2, 3], "M8[s]"),
        np.array([False, True, True]),
        np.array([0, 2**63 - 1, 2**63, 2**64 - 1, 3], np.uint64),  # each difference is above 0 if it wraps
        np.array([0, 4, 3]),
        np.array(3),
        np.array([], int),
    ],
)
def test_offsets_that_are_none(tmp_path, offsets):
    captures = max(1, offsets.size - 1)
    path = npz_file(tmp_path, offsets=offsets, subject=["ann"] * captures, gesture=["pat"] * captures)
    refused("my.npz: offsets must rise from 0 to 3", read, path)


@pytest.mark.parametrize("kind", ["<f2", ">f2", "<f4", ">f8", "i1", ">u8", "longdouble"])
@pytest.mark.filterwarnings("error")
def test_npz_frames_of_any_type_without_a_word(tmp_path, kind):
    assert read(npz_file(tmp_path, frames=np.full((3, 1, 2), 7).astype(kind))).frames.tolist() == 3 * [[[7, 7]]]


@pytest.mark.parametrize("kind", [">f4", ">f8", "<f2", ">i4", ">u2", "longdouble", "?", ">U3", "u8"])
def test_npz_conditions_of_any_plain_type(tmp_path, kind):
    from bench.corpora.library import import_corpus

    path = npz_file(tmp_path, day=np.array([1, 0]).astype(kind), subject=np.array([7, 8], ">i2"))
    corpus = import_corpus("table", path, {"rate_hz": "50"})
    assert corpus.captures["day"].astype(str).astype(object).replace({"True": "1", "False": "0"}).astype(
        float
    ).tolist() == [1, 0]
    assert corpus.subjects.tolist() == ["7", "8"]


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 60, reason="long doubles are doubles here")
def test_a_longdouble_that_would_change(tmp_path):
    exact = np.longdouble(1) + np.longdouble(2) ** -60
    refused("capture 2: day is", read, npz_file(tmp_path, day=np.array([1, exact])))
    assert read(npz_file(tmp_path, frames=np.full((3, 1, 2), exact))).frames.tolist() == np.ones((3, 1, 2)).tolist()


@pytest.mark.parametrize("name", ["a\x1b[31m.csv", "a\nb.csv", "\udcff.csv", "\u202egpj.csv"])
def test_what_a_file_is_called_can_be_shown_for_ever_after(tmp_path, name):
    path = csv_file(tmp_path, "ann,pat,0,arm,1,2").rename(tmp_path / name)
    assert read(path).info["source"].isprintable()


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("blank", ["{}", "{0}{0}{0}", "  {}", "\t", " {0} {0}"])
def test_blank_lines_at_the_end(tmp_path, end, blank):
    rows = ["subject,gesture,frame,place,a,b", "ann,pat,0,arm,1,2", "ann,pat,1,arm,1,2"]
    (tmp_path / "my.csv").write_text(end.join(rows) + end + blank.format(end), newline="")
    assert list(read(tmp_path / "my.csv").lengths) == [2]
    rows.insert(2, blank.format(end).strip("\r\n"))
    (tmp_path / "my.csv").write_text(end.join(rows) + end, newline="")
    refused("my.csv, line 3: ", read, tmp_path / "my.csv")


def test_line_ends_of_old_macs(tmp_path):
    (tmp_path / "my.csv").write_text(HEADER.strip() + "\rann,pat,0,arm,1,2\r", newline="")
    refused("my.csv, line 1: not a header; give a CSV file whose lines end with line feeds", read, tmp_path / "my.csv")


def test_a_file_that_begins_with_a_blank_line(tmp_path):
    refused("line 1: blank", read, csv_file(tmp_path, "ann,pat,0,arm,1,2", header="\n" + HEADER))


def release(folder, add=(), rename=None):
    parts = {"training.csv": training([("P4", "pat")]), "testWITHLABELS.csv": test_part([("T9", "rub")])}
    with zipfile.ZipFile(folder / "r.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in add:
            archive.writestr(name, content)
        for name, content in parts.items():
            archive.writestr((rename or "{}").format(name), content)
    return folder / "r.zip"


def test_a_zip_that_a_mac_or_a_file_manager_made(tmp_path):
    plain = haart.read(release(tmp_path)).frames
    for add in (
        [("__MACOSX/", ""), ("__MACOSX/training.csv", "x"), ("__MACOSX/HAART DataSet/._training.csv", "x")],
        [("HAART DataSet/", ""), ("training.csv/", ""), ("._training.csv", "\0")],
        [("readme.txt", "x")],
    ):
        assert np.array_equal(haart.read(release(tmp_path, add)).frames, plain)
    assert np.array_equal(haart.read(release(tmp_path, [("old/testing/training.csv", "x")])).frames, plain)
    refused("training.csv is in it twice", haart.read, release(tmp_path, [("a/training.csv", "x")], rename="b/{}"))
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = release(tmp_path, [("training.csv", "x")])
    refused("training.csv is in it twice", haart.read, path)


def test_a_member_without_a_name(tmp_path):
    for path in (release(tmp_path, [("a", "x")]), _with_member(npz_file(tmp_path).parent, "a")):
        raw = bytearray(path.read_bytes())
        for signature, at in ((b"PK\x03\x04", 26), (b"PK\x01\x02", 28)):
            place = raw.find(signature)
            while raw[place + at : place + at + 2] != b"\1\0":
                place = raw.find(signature, place + 1)
            raw[place + at : place + at + 4] = b"\0\0\1\0"  # the name becomes an extra field
        path.write_bytes(raw)
    assert len(haart.read(tmp_path / "r.zip")) == 2
    refused("my.npz: ", read, tmp_path / "my.npz")


def test_an_npz_that_was_packed_again_by_a_mac(tmp_path):
    path = npz_file(tmp_path)
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(tmp_path / "b.npz", "w") as new:
        new.writestr("__MACOSX/._frames.npy", "x")
        new.writestr("empty/", "")
        for name in old.namelist():
            new.writestr(name, old.read(name))
    assert np.array_equal(read(tmp_path / "b.npz").frames, read(path).frames)


def test_suffixes_in_capitals(tmp_path):
    for path in (csv_file(tmp_path, "ann,pat,0,arm,1,2"), parquet_file(tmp_path), npz_file(tmp_path)):
        plain = read(path).frames
        assert np.array_equal(read(path.rename(path.with_name(path.name.upper()))).frames, plain)
    folder = tmp_path / "release"
    folder.mkdir()
    with zipfile.ZipFile(release(tmp_path, rename="{}")) as archive:
        archive.extractall(folder)
    plain = haart.read(folder).frames
    for file in list(folder.iterdir()):
        file.rename(file.with_name(file.name.upper()))
    (folder / "__MACOSX").mkdir()
    (folder / "__MACOSX" / "training.csv").write_text("x")
    assert np.array_equal(haart.read(folder).frames, plain)


def test_parquet_with_an_index_or_none(tmp_path):
    about = pd.DataFrame({"subject": ["ann"] * 2, "gesture": ["pat"] * 2, "frame": [0, 1], "a": [1, 2], "b": [3, 4]})
    for index in ([5, 3], pd.Index(["x", "y"], name="id"), pd.MultiIndex.from_tuples([(1, 2), (3, 4)])):
        about.set_index(pd.Index(index) if isinstance(index, list) else index).to_parquet(tmp_path / "my.parquet")
        assert read(tmp_path / "my.parquet").frames.ravel().tolist() == [1, 3, 2, 4]
    for about in (
        b"",
        b"{",
        b"[]",
        b'{"index_columns": 3}',
        b'{"index_columns": ["nothing", {"kind": "range"}]}',
        b"\xff",
    ):
        written = pq.read_table(parquet_file(tmp_path)).replace_schema_metadata({b"pandas": about})
        pq.write_table(written, tmp_path / "my.parquet")
        try:
            assert read(tmp_path / "my.parquet").frames.ravel().tolist() == [1, 3, 2, 4]
        except InputError as e:
            assert len(str(e)) <= 300


def test_parquet_with_flipped_bits(tmp_path):
    path = parquet_file(tmp_path, place=["arm"] * 2, a=[1, 1], b=[1, 1])
    raw, rng = path.read_bytes(), np.random.default_rng(0)
    said = set()
    for _ in range(300):
        damaged = bytearray(raw)
        damaged[int(rng.integers(len(raw)))] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            read(path)
        except InputError as e:
            said.add(str(e))
            assert len(str(e)) <= 300 and str(e).isprintable() and str(e).startswith("my.parquet")
    assert len(said) > 5


def test_messages_fit_in_a_line_whatever_names_and_values_are(tmp_path):
    long, odd = "n" * 240, "new\nline\x1b[31m"
    for name in (long, odd):
        for suffix, make in (
            (".csv", lambda p: p.write_text(HEADER + "ann,pat,0,arm,1,-2\n")),
            (".npz", lambda p: np.savez(p, a=1)),
            (".parquet", lambda p: p.write_bytes(b"PAR1")),
        ):
            path = tmp_path / f"{name}{suffix}"
            make(path)
            refused("", read, path)
            refused("", cost.read, path)
            refused("", haart.read, path)
            path.unlink()
            refused("no such file", read, path)
            refused("cannot be read", cost.read, path)
            refused("no such file", haart.read, path)
    x = "x" * 20_000
    for row in (
        f"{x},pat,0,arm,1,2",
        f"ann,pat,{x},arm,1,2",
        f"ann,pat,0,arm,{x},2",
        "ann,pat,0,arm,1,2," + x,
        f"ann,pat,0,arm,1,-{'1' * 5000}",
    ):
        refused("line 2: ", read, csv_file(tmp_path, row))
        refused("line 1: ", read, csv_file(tmp_path, row, header=HEADER.replace("place", f"place,{x}")))
    refused(
        "line 1: ",
        read,
        csv_file(tmp_path, "ann,pat,0,arm,1,2", header=HEADER.replace("place", "\\" * 150 + "," + "\\" * 150)),
    )
    refused(
        "column",
        cost.read,
        csv_file(tmp_path, "1", header=", ".join([*cost.LABELS, *CHANNELS, "\U000e0001" * 199]) + "\n"),
    )
    refused("grid=", read, csv_file(tmp_path), grid=x)
    refused(
        "cannot be called",
        read,
        csv_file(tmp_path, "ann,pat,0,arm,1,2", header=HEADER.replace("place", "p_" + "y" * 190)),
    )
    refused("is not an array", read, npz_file(tmp_path, **{"y" * 30: [1, 2]}) and _with_member(tmp_path, "z" * 60_000))


def _with_member(folder, name):
    with zipfile.ZipFile(folder / "my.npz", "a") as archive:
        archive.writestr(name, "x")
    return folder / "my.npz"


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null"])
def test_files_that_are_no_files(path):
    refused("cannot be read", cost.read, path)
    refused("", haart.read, path)
    refused("", read, path)
