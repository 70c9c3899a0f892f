"""Importing takes time and memory in proportion to the file, whatever it says; measured in a process of its own."""

import struct
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.corpora.read.cost import CHANNELS
from bench.corpora.read.haart import CELLS
from tests.fuzz.child import Child

TABLE = {"rate_hz": "50", "grid": "1x2"}
HEADER = "subject,gesture,frame,a,b\n"


@pytest.fixture(scope="module")
def child():
    with Child(seconds=90, mib=1400) as one:  # a busy machine is no failure; what is out of proportion takes minutes
        yield one


def refused(outcome, *words):
    assert outcome.kind == "refused" and all(word in outcome.message for word in words), outcome


def right(outcome):
    assert outcome.kind == "right", outcome


def test_a_header_of_a_megabyte(child, tmp_path):
    names = ",".join(f"c{i}" for i in range(150_000))
    (tmp_path / "a.csv").write_text(f"subject,variant,gesture,frame,{','.join(CHANNELS)},{names}\n")
    refused(child.run("cost", tmp_path / "a.csv", {}), "a.csv, line 1: column 'c0' is not one of CoST's")
    (tmp_path / "b.csv").write_text(f"subject,gesture,frame,{names}\nann,pat,0{',7' * 150_000}\n")
    refused(child.run("table", tmp_path / "b.csv", TABLE), "line 1: ", "c2, c3, c4 and 149995 more are extra")
    for cell in ("0x1", "-1"):
        (tmp_path / "b.csv").write_text(f"subject,gesture,frame,{names}\nann,pat,0{',7' * 149_999},{cell}\n")
        refused(child.run("table", tmp_path / "b.csv", TABLE | {"grid": "300x500"}), "line 2: c149999 is ")
    names = ",".join(f"c{i}" for i in range(40_000))
    (tmp_path / "b.csv").write_text(f"subject,gesture,frame,{names}\nann,pat,0{',7' * 40_000}\n")
    right(child.run("table", tmp_path / "b.csv", {"rate_hz": "50", "grid": "200x200"}))
    (tmp_path / "c.csv").write_text(HEADER.replace("a,b", "a," + "b" * 200_000) + "ann,pat,0,1,2\n")
    refused(child.run("table", tmp_path / "c.csv", TABLE), "c.csv, line 1: ")
    (tmp_path / "d.csv").write_text(f"subject,variant,gesture,frame,{','.join(CHANNELS)}" + "," * 1_000_000)
    refused(child.run("cost", tmp_path / "d.csv", {}), "d.csv, line 1: column 69 has no name")


@pytest.mark.parametrize("end", ["\n", "\r\n", " \n"])
def test_blank_lines_by_the_million(child, tmp_path, end):
    row = "ann,pat,{},1,2\n"
    blank = end * 8_000_000
    (tmp_path / "end.csv").write_text(HEADER + row.format(0) + blank, newline="")
    right(child.run("table", tmp_path / "end.csv", TABLE))
    (tmp_path / "amid.csv").write_text(HEADER + row.format(0) + blank + row.format(1), newline="")
    refused(child.run("table", tmp_path / "amid.csv", TABLE), "amid.csv, line 3: ", "blank")
    (tmp_path / "only.csv").write_text(HEADER + blank, newline="")
    refused(child.run("table", tmp_path / "only.csv", TABLE), "there are no frames in it")


def test_a_small_zip_of_many_blank_lines(child, tmp_path):
    header = f"ParticipantNo,Substrate,Cover,Gesture,{','.join(CELLS)}\n"
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("training.csv", header + "\n" * 200_000_000)
        archive.writestr("testWITHLABELS.csv", header)
    assert (tmp_path / "a.zip").stat().st_size < 300_000
    refused(child.run("haart", tmp_path / "a.zip", {}), "a.zip", "191 MiB", "at most ")


def test_a_line_without_an_end(child, tmp_path):
    for name, content in (("a.csv", HEADER + "a" * 50_000_000), ("b.csv", HEADER + '"' + "a,\n" * 9_000_000)):
        (tmp_path / name).write_text(content)
        refused(child.run("table", tmp_path / name, TABLE), f"{name}, line 2: ")
    (tmp_path / "c.csv").write_text("a" * 50_000_000)
    refused(child.run("cost", tmp_path / "c.csv", {}), "c.csv, line 1: column 1 is 'aaa")


@pytest.mark.parametrize("digits", [400, 5_000, 1_000_000])
def test_numbers_of_many_digits(child, tmp_path, digits):
    nines = "9" * digits
    for row, words in [
        (f"ann,pat,0,{nines},2", ["line 2: a is "]),
        (f"ann,pat,{nines},1,2", ["line 2: "]),
        (f"ann,{nines},0,1,2", ["line 2: gesture is", "longer than 200 characters"]),
    ]:
        (tmp_path / "a.csv").write_text(HEADER + row + "\n")
        refused(child.run("table", tmp_path / "a.csv", TABLE), *words)
    (tmp_path / "a.csv").write_text(f"{HEADER}ann,pat,{'0' * digits}1,{'0' * digits}1,0.{'1' * digits}\n")
    right(child.run("table", tmp_path / "a.csv", TABLE))
    refused(child.run("table", tmp_path / "a.csv", TABLE | {"grid": f"1x{nines}"}), "rows and columns")


def npz(path, packing=zipfile.ZIP_STORED, **members):
    """An archive of arrays whose headers and contents need not fit."""
    with zipfile.ZipFile(path, "w", packing) as archive:
        for name, (descr, shape, content) in members.items():
            head = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}}}".encode().ljust(117) + b"\n"
            with archive.open(f"{name}.npy", "w") as f:
                f.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)
                for part in content if isinstance(content, list) else [content]:
                    f.write(part)


def labels(captures=1):
    offsets = np.array([0, captures], dtype="<i8").tobytes()
    word = ("<U1", (1,), "a".encode("utf-32-le"))
    return {"offsets": ("<i8", (2,), offsets), "subject": word, "gesture": word}


def test_an_npz_header_that_claims_too_much(child, tmp_path):
    path = tmp_path / "a.npz"
    npz(path, frames=("<f8", (10**12, 8, 8), bytes(64)), **labels())
    refused(child.run("table", path, {"rate_hz": "9"}), "a.npz: not a .npz file of plain arrays")
    npz(path, frames=("|u1", (2, 1, 1), b"\1\2"), **labels(2) | {"subject": ("<U9000", (10**9,), b"")})
    refused(child.run("table", path, {"rate_hz": "9"}), "a.npz: not a .npz file of plain arrays")
    npz(path, frames=("|u1", (2, 1, 1), b"\1\2"), **labels(2))
    right(child.run("table", path, {"rate_hz": "9"}))


def test_a_small_npz_of_many_zeros(child, tmp_path):
    frames = ("|u1", (300 << 20, 1, 1), [bytes(1 << 20)] * 300)
    npz(tmp_path / "a.npz", zipfile.ZIP_DEFLATED, frames=frames, **labels(300 << 20))
    assert (tmp_path / "a.npz").stat().st_size < 400_000
    refused(child.run("table", tmp_path / "a.npz", {"rate_hz": "9"}), "a.npz: unpacks to 300 MiB", "at most ")


def test_a_small_parquet_file_of_many_rows(child, tmp_path):
    n = 30_000_000
    same = pa.DictionaryArray.from_arrays(pa.array(np.zeros(n, np.int8)), pa.array(["a"]))
    zeros = pa.array(np.zeros(n, np.int8))
    columns = {"subject": same, "gesture": same, "frame": zeros, "a": zeros, "b": zeros}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet", compression="zstd")
    assert (tmp_path / "a.parquet").stat().st_size < 600_000
    refused(child.run("table", tmp_path / "a.parquet", TABLE), "a.parquet: unpacks to ", "at most 48 MiB")


def test_a_parquet_page_of_a_long_text(child, tmp_path):
    path = tmp_path / "a.parquet"
    columns = {"subject": ["x" * (100 << 20)], "gesture": ["a"], "frame": [0], "a": [1], "b": [2]}
    pq.write_table(pa.table(columns), path, compression="zstd", write_statistics=False)
    assert path.stat().st_size < 100_000
    refused(child.run("table", path, TABLE), "a.parquet: unpacks to", "at most ")
