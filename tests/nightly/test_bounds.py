"""Importing takes time and memory in proportion to the file, whatever it says."""

import struct
import zipfile

import numpy as np
import pytest

from bench.corpora.read.cost import CHANNELS
from bench.corpora.read.haart import CELLS
from tests.nightly.bounded import bounded, imported

pytestmark = pytest.mark.nightly
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
    header = f"ParticipantNo,Substrate,Cover,Gesture,{','.join(CELLS)}\n"
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("training.csv", header + "\n" * 200_000_000)
        archive.writestr("testWITHLABELS.csv", header)
    refused(tmp_path / "a.zip", "unpacks to", kind="haart")
