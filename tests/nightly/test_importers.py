"""Random damaged files of every format that is imported: refused in a line, or stored as what they say.

What a damaged one may hold is told by readers of Python, NumPy and pandas.
"""

import csv
import io
import struct
import zipfile

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.read import haart
from bench.corpora.read.cost import CHANNELS, LABELS
from tests.nightly.bounded import bounded, imported

pytestmark = pytest.mark.nightly
WORDS = [
    "ann",
    "bob",
    "ünïcode",
    "a b",
    "007",
    "null",
    "nan",
    "0x1f",
    "=1+1",
    "😀",
    "-",
    "TRUE",
    "x" * 200,
    'say "hi"',
    "x,y",
]
CELLS = """0 -1 -0 +1 1.5 1e3 1e39 1e400 nan inf -inf 0x10 0X1F 1_0 1,0 ٣ ½ 16777217 33554432 65536 1023 1024 00001 1.
.5 1e --1 0b1 9007199254740993 18446744073709551616 NaN TRUE null None '' " "" "a"b" "a subject frame""".split()
CELLS += ["", " ", "\t", "1 0", "a\0b", "\x1b[31m", "\u2028", "\ufeff", "\x85", "\u3000", '"a\nb"', "a\rb", "x" * 201]
CELLS += ["9" * 400, "0" * 5000, "x" * 200_000, "\udcff"]
NAMES = ["", " ", "a\0b", "x" * 201, '"a,b"', '"a', "capture", "fold", "p_pat", "index", "ch0", *LABELS, "synthetic"]
ENDS = ["\r", "\x0b", "\x85", ";\n", ",\n", "\0\n", ""]
OPTIONS = {"rate_hz": "54", "full_scale": "65535"}


@st.composite
def captures(draw):
    """Frames [total, rows, cols], lengths, and columns of the captures."""
    lengths = draw(st.lists(st.integers(1, 5), min_size=1, max_size=5))
    grid = draw(st.tuples(st.integers(1, 3), st.integers(1, 3)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    frames = rng.integers(0, 65536, (sum(lengths), *grid))
    if draw(st.booleans()):
        frames = frames / draw(st.sampled_from([7, 1e3, 1e9]))
    names = ["subject", "gesture", *draw(st.lists(st.sampled_from(["place", "the room", "x.y"]), unique=True))]
    words = st.lists(st.sampled_from(WORDS), min_size=len(lengths), max_size=len(lengths))
    return frames, lengths, {name: draw(words) for name in names}


def long_table(frames, lengths, columns):
    table = pd.DataFrame({name: np.repeat(np.array(words, object), lengths) for name, words in columns.items()})
    table["frame"] = np.concatenate([np.arange(n) for n in lengths])
    channels = frames.reshape(len(frames), -1)
    return pd.concat([table, pd.DataFrame(channels, columns=CHANNELS[: channels.shape[1]])], axis=1)


def text_of(table):
    return table.to_csv(index=False, quoting=csv.QUOTE_MINIMAL)


def packed(arrays):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.save(content, array, allow_pickle=True)
            archive.writestr(f"{name}.npy", content.getvalue())
    return buffer.getvalue()


def npz_of(frames, lengths, columns):
    return packed({"frames": frames.astype("<f8"), "offsets": np.cumsum([0, *lengths]), **columns})


def parquet_of(table):
    buffer = io.BytesIO()
    table.to_parquet(buffer, index=False)
    return buffer.getvalue()


def grid_of(frames):
    return OPTIONS | {"grid": f"{frames.shape[1]}x{frames.shape[2]}"}


def outcome(tmp_path, content, suffix, options):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content)
    return bounded(imported, "table", path, options, seconds=20)


def same(stored, frames, lengths, columns):
    assert not isinstance(stored, str), stored
    whole = bool((frames == np.floor(frames)).all()) and frames.max() <= 65535
    assert stored[0].dtype == (np.uint16 if whole else np.float32)
    assert np.array_equal(stored[0], frames.astype(stored[0].dtype)) and stored[1] == list(lengths)
    assert stored[2].to_dict("list") == {name: list(words) for name, words in columns.items()}


def plain_table(content, grid):
    """Captures of a CSV file by Python's own reader, as strict as the format is: any error means that it is none."""
    header, *rows = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""), strict=True)
    header, count = [name.strip().strip('"') for name in header], grid[0] * grid[1]
    while rows and not "".join(rows[-1]).strip():
        rows.pop()
    assert all(len(row) == len(header) for row in rows)
    cells = {name: [row[i].strip() for row in rows] for i, name in enumerate(header)}
    channels = [name for name in CHANNELS[:count] if name in cells]
    channels = channels if len(channels) == count else header[-count:]
    whole = lambda cell: int(cell, 16) if cell[:2] in ("0x", "0X") else int(cell)  # noqa: E731 - as pyarrow reads it
    frame = [whole(cell) for cell in cells.pop("frame")]
    frames = np.array([[float(cell) for cell in cells.pop(name)] for name in channels]).T.reshape(-1, *grid)
    starts = [i for i, number in enumerate(frame) if number == frame[0]]
    lengths = np.diff([*starts, len(frame)]).tolist()
    return frames, lengths, {name: [words[i] for i in starts] for name, words in cells.items() if name != "synthetic"}


@given(captures(), st.data())
def test_a_damaged_text_is_refused_or_what_it_says(tmp_path, made, data):
    lines = [line.split(",") for line in text_of(long_table(*made)).split("\n")]
    end = "\n"
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(lines) - 1))
        j = data.draw(st.integers(0, max(0, len(lines[i]) - 1)))
        how = data.draw(
            st.sampled_from(["cell", "cell", "cell", "cut", "twice", "swap", "gone", "blank", "name", "ends"])
        )
        if how == "cell" and lines[i]:
            lines[i][j] = data.draw(st.sampled_from(CELLS))
        elif how == "cut":
            del lines[i][j:]
        elif how == "twice":
            lines.insert(i, list(lines[i]))
        elif how == "swap":
            lines[i], lines[-2] = lines[-2], lines[i]
        elif how == "gone" and len(lines) > 1:
            del lines[i]
        elif how == "blank":
            lines[i:i] = [[""]] * data.draw(st.sampled_from([1, 2, 1000]))
        elif how == "name" and lines[0]:
            lines[0][min(j, len(lines[0]) - 1)] = data.draw(st.sampled_from(NAMES))
        elif how == "ends":
            end = data.draw(st.sampled_from(ENDS))
    content = end.join(",".join(cells) for cells in lines).encode("utf-8", "surrogatepass")
    stored = outcome(tmp_path, content, "csv", grid_of(made[0]))
    if not isinstance(stored, str):
        same(
            (stored[0], stored[1], stored[2].drop(columns="synthetic", errors="ignore")),
            *plain_table(content, made[0].shape[1:]),
        )


def damaged(data, content):
    """Bytes flipped, put in, cut or doubled; the end is harmed as often as all before it."""
    raw = bytearray(content)
    for _ in range(data.draw(st.sampled_from([1, 1, 2, 8]))):
        if not raw:
            break
        end = data.draw(st.integers(1, min(len(raw), 400)))
        at = data.draw(st.sampled_from([data.draw(st.integers(0, len(raw) - 1)), len(raw) - end]))
        how, size = data.draw(st.integers(0, 5)), data.draw(st.sampled_from([1, 4, 100]))
        if how < 3:
            raw[at] ^= 1 << data.draw(st.integers(0, 7))
        elif how == 3:
            raw[at : at + size] = data.draw(st.binary(min_size=0, max_size=size))
        elif how == 4:
            raw[at:at] = raw[at : at + size]
        else:
            del raw[at:]
    return bytes(raw)


@given(captures(), st.sampled_from(["csv", "parquet", "npz"]), st.data())
def test_damaged_bytes_are_refused_or_what_they_say(tmp_path, made, suffix, data):
    table = long_table(*made)
    whole = {"csv": text_of(table).encode(), "npz": npz_of(*made), "parquet": parquet_of(table)}[suffix]
    content = damaged(data, whole)
    options = OPTIONS if suffix == "npz" else grid_of(made[0])
    stored = outcome(tmp_path, content, suffix, options)
    if isinstance(stored, str):
        assert content != whole, stored
    elif suffix == "csv":
        same(stored, *plain_table(content, made[0].shape[1:]))
    elif suffix == "npz":
        arrays = dict(np.load(io.BytesIO(content)))
        assert np.array_equal(stored[0], arrays["frames"].astype(stored[0].dtype))
        assert stored[1] == np.diff(arrays["offsets"]).tolist()
    else:
        again = pd.read_parquet(io.BytesIO(content))
        channels = again[CHANNELS[: made[0][0].size]].to_numpy()
        assert np.array_equal(stored[0].reshape(len(channels), -1), channels.astype(stored[0].dtype))


# Time and memory in proportion to the file


HEADER = "subject,gesture,frame,a,b\n"


def refused(path, *facts, kind="table", **options):
    options = {} if kind != "table" else {"rate_hz": "50", "grid": "1x2"} | options
    message = bounded(imported, kind, path, options)
    assert isinstance(message, str) and all(fact in message for fact in (path.name, *facts)), message


def right(path, **options):
    message = bounded(imported, "table", path, {"rate_hz": "50", "grid": "1x2"} | options)
    assert not isinstance(message, str), message


def written(path, text):
    path.write_text(text, newline="")
    return path


def test_a_header_of_a_megabyte(tmp_path):
    path = tmp_path / "a.csv"
    names = ",".join(f"c{i}" for i in range(150_000))
    cost = f"subject,variant,gesture,frame,{','.join(CHANNELS)},"
    refused(written(path, cost + names + "\n"), "line 1", "c0", kind="cost")
    refused(written(path, cost + "," * 1_000_000), "line 1", "column 69", kind="cost")
    refused(written(path, f"subject,gesture,frame,{names}\nann,pat,0{',7' * 150_000}\n"), "line 1", "149995 more")
    for cell in ("0x1", "-1"):
        text = f"subject,gesture,frame,{names}\nann,pat,0{',7' * 149_999},{cell}\n"
        refused(written(path, text), "line 2", "c149999", grid="300x500")
    names = ",".join(f"c{i}" for i in range(40_000))
    right(written(path, f"subject,gesture,frame,{names}\nann,pat,0{',7' * 40_000}\n"), grid="200x200")
    refused(written(path, HEADER.replace("a,b", "a," + "b" * 200_000) + "ann,pat,0,1,2\n"), "line 1")


@pytest.mark.parametrize("end", ["\n", "\r\n", " \n"])
def test_blank_lines_by_the_million(tmp_path, end):
    rows, blank = ["ann,pat,0,1,2\n", "ann,pat,1,1,2\n"], end * 8_000_000
    right(written(tmp_path / "a.csv", HEADER + rows[0] + blank))
    refused(written(tmp_path / "a.csv", HEADER + rows[0] + blank + rows[1]), "line 3")
    refused(written(tmp_path / "a.csv", HEADER + blank), "no frames")


def npz(path, packing=zipfile.ZIP_STORED, captures=1, **members):
    """An archive of arrays whose headers and contents need not fit."""
    word = ("<U1", (1,), ["a".encode("utf-32-le")])
    offsets = ("<i8", (2,), [np.array([0, captures], dtype="<i8").tobytes()])
    with zipfile.ZipFile(path, "w", packing) as archive:
        for name, (descr, shape, parts) in ({"offsets": offsets, "subject": word, "gesture": word} | members).items():
            head = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}}}".encode().ljust(117) + b"\n"
            with archive.open(f"{name}.npy", "w") as file:
                file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)
                for part in parts:
                    file.write(part)
    return path


def test_archives_that_claim_or_hold_too_much(tmp_path):
    two = ("|u1", (2, 1, 1), [b"\1\2"])
    refused(npz(tmp_path / "a.npz", frames=("<f8", (10**12, 8, 8), [bytes(64)])))
    refused(npz(tmp_path / "a.npz", captures=2, frames=two, subject=("<U9000", (10**9,), [])))
    right(npz(tmp_path / "a.npz", captures=2, frames=two), grid="1x1")
    zeros = ("|u1", (300 << 20, 1, 1), [bytes(1 << 20)] * 300)
    refused(npz(tmp_path / "a.npz", zipfile.ZIP_DEFLATED, captures=300 << 20, frames=zeros), "300 MiB")
    header = f"ParticipantNo,Substrate,Cover,Gesture,{','.join(haart.CELLS)}\n"
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("training.csv", header + "\n" * 200_000_000)
        archive.writestr("testWITHLABELS.csv", header)
    refused(tmp_path / "a.zip", "unpacks to", kind="haart")
