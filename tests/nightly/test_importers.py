"""Random damaged files of every format are refused in a line, or stored as what they say.

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
from bench.corpora.read.cost import CHANNELS
from tests.corpora import made
from tests.nightly.bounded import bounded, imported

pytestmark = pytest.mark.nightly
OPTIONS = {"rate_hz": "54", "full_scale": "65535"}


def plain_table(content):
    """Captures of a CSV file by Python's own reader; any error means that it is no table."""
    header, *rows = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""), strict=True)
    header = [name.strip().strip('"') for name in header]
    while rows and not "".join(rows[-1]).strip():
        rows.pop()
    assert all(len(row) == len(header) for row in rows)
    cells = {name: [row[i].strip() for row in rows] for i, name in enumerate(header)}
    frames = np.array([[float(cell) for cell in cells.pop(name)] for name in header[-2:]]).T
    frame = [
        int(cell, 16) if cell[:2] in ("0x", "0X") else int(cell) for cell in cells.pop("frame")
    ]
    starts = [i for i, number in enumerate(frame) if number == frame[0]]
    lengths = np.diff([*starts, len(frame)]).tolist()
    return frames, lengths, {name: [words[i] for i in starts] for name, words in cells.items()}


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


@given(st.sampled_from([made.csv, made.parquet, made.npz]), st.data())
def test_damaged_bytes_are_refused_or_what_they_say(tmp_path, make, data):
    path = make(tmp_path)
    whole = path.read_bytes()
    content = damaged(data, whole)
    path.write_bytes(content)
    options = OPTIONS if make is made.npz else OPTIONS | {"grid": "1x2"}
    stored = bounded(imported, "table", path, options, seconds=20)
    if isinstance(stored, str):
        assert content != whole, stored
        return
    frames, lengths, captures = stored
    if make is made.csv:
        expected, counts, columns = plain_table(content)
        assert lengths == counts and captures.to_dict("list") == columns
    elif make is made.npz:
        arrays = dict(np.load(io.BytesIO(content)))
        expected = arrays["frames"]
        assert lengths == np.diff(arrays["offsets"]).tolist()
    else:
        expected = pd.read_parquet(io.BytesIO(content))[["a", "b"]].to_numpy()
    assert np.array_equal(frames.reshape(expected.shape), expected.astype(frames.dtype))


# Time and memory in proportion to the file.
HEADER = "subject,gesture,frame,a,b\n"


def refused(path, *facts, kind="table", **options):
    options = {} if kind != "table" else {"rate_hz": "50", "grid": "1x2"} | options
    message = bounded(imported, kind, path, options)
    assert isinstance(message, str) and all(fact in message for fact in (path.name, *facts)), (
        message
    )


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
    refused(
        written(path, f"subject,gesture,frame,{names}\nann,pat,0{',7' * 150_000}\n"),
        "line 1",
        "149995 more",
    )
    text = f"subject,gesture,frame,{names}\nann,pat,0{',7' * 149_999},-1\n"
    refused(written(path, text), "line 2", "c149999", grid="300x500")
    names = ",".join(f"c{i}" for i in range(40_000))
    right(
        written(path, f"subject,gesture,frame,{names}\nann,pat,0{',7' * 40_000}\n"), grid="200x200"
    )


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
        for name, (descr, shape, parts) in (
            {"offsets": offsets, "subject": word, "gesture": word} | members
        ).items():
            head = (
                f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}}}".encode().ljust(
                    117
                )
                + b"\n"
            )
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
    refused(
        npz(tmp_path / "a.npz", zipfile.ZIP_DEFLATED, captures=300 << 20, frames=zeros), "300 MiB"
    )
    header = f"ParticipantNo,Substrate,Cover,Gesture,{','.join(haart.CELLS)}\n"
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("training.csv", header + "\n" * 200_000_000)
        archive.writestr("testWITHLABELS.csv", header)
    refused(tmp_path / "a.zip", "unpacks to", kind="haart")
