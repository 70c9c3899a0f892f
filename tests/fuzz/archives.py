"""Zip archives, arrays and parquet, read a second time; parquet is decoded by pyarrow, as nothing else here could."""

import ast
import io
import json
import math
import re
import struct
import zipfile
from fractions import Fraction
from pathlib import Path

from tests.fuzz.cells import (
    MOST_CONDITIONS,
    Content,
    Invalid,
    column_names,
    label,
    layout,
    lengths_of,
    long_table,
    need,
    sensor,
)


def members(path: Path) -> dict:
    """Contents of the files of a zip, without what macOS adds; each name once."""
    found: dict = {}
    raw = path.read_bytes()
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            files = [m for m in archive.infolist() if not m.filename.endswith("/") and not by_macos(m.filename)]
            need(sum(m.file_size for m in files) <= max(16 << 20, 100 * len(raw)), "unpacks to too much")
            for member in files:
                need(member.filename not in found, "a member twice")
                need(member.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED), "another packing")
                found[member.filename] = archive.read(member)
    except Invalid:
        raise
    except Exception as e:  # damaged in one of many ways
        raise Invalid(f"not a zip: {e!r}") from e
    return found


def by_macos(name: str) -> bool:
    return "__MACOSX" in name.split("/")[:-1] or name.rsplit("/", 1)[-1].startswith("._")


def haart_files(path: Path) -> dict:
    """The two files by their names in lower case; of several the one nearest to the top, and then only one."""
    if path.is_dir():
        files = {str(p.relative_to(path)): p for p in path.rglob("*") if p.is_file()}
        everything = {n: p for n, p in files.items() if n.count("/") < 2 and not by_macos(n)}
    else:
        everything = members(path)
    found: dict = {}
    for name in everything:
        found.setdefault(name.rsplit("/", 1)[-1].lower(), []).append((name.count("/"), name))
    chosen = {}
    for name in ("training.csv", "testwithlabels.csv"):
        best = sorted(found.get(name, []))
        if best:
            need(sum(depth == best[0][0] for depth, _ in best) == 1, f"{name} twice")
            content = everything[best[0][1]]
            chosen[name] = content.read_bytes() if isinstance(content, Path) else content
    return chosen


CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q"}
CODES |= {"f2": "e", "f4": "f", "f8": "d"}


def npy(content: bytes) -> tuple:
    """Shape, kind and values (in C order) of a ``.npy`` file."""
    need(content[:6] == b"\x93NUMPY" and content[6] in (1, 2) and content[7] == 0, "not an array")
    width = 2 if content[6] == 1 else 4
    length = int.from_bytes(content[8 : 8 + width], "little")
    need(length <= 10_000, "a long header")
    data = content[8 + width + length :]
    try:
        header = ast.literal_eval(content[8 + width : 8 + width + length].decode("latin1").strip())
        descr, fortran, shape = header["descr"], header["fortran_order"], header["shape"]
        need(len(header) == 3 and isinstance(fortran, bool) and isinstance(shape, tuple), "a header")
        need(all(type(n) is int and n >= 0 for n in shape) and isinstance(descr, str), "a header")
        order, kind, size = re.fullmatch(r"([<>|=])([a-zA-Z])([0-9]*)", descr).groups()
        size = int(size or 0)
    except Invalid:
        raise
    except Exception as e:  # damaged in one of many ways
        raise Invalid(f"a header: {e!r}") from e
    need(kind in "iufbSUc", f"arrays of {descr}")
    count, width = math.prod(shape), size * 4 if kind == "U" else size
    need(count * width == len(data), "another size than it says")
    need(width, "an array of nothing")
    order = ">" if order == ">" else "<"
    cells = [data[i : i + width] for i in range(0, len(data), width)]
    try:
        values = [_cell(cell, kind, size, order) for cell in cells]
    except (ValueError, struct.error, KeyError) as e:
        raise Invalid(f"a cell: {e!r}") from e
    if fortran and len(shape) > 1:
        values = _turned(values, shape)
    return shape, kind, values


def _cell(cell: bytes, kind: str, size: int, order: str) -> object:
    if kind == "S":
        return cell.rstrip(b"\0").decode()
    if kind == "U":
        codes = struct.unpack(f"{order}{size}I", cell)
        return "".join(map(chr, codes)).rstrip("\0")
    if kind == "b":
        return bool(cell[0])
    if kind == "c":
        return complex
    if kind == "f" and size == 16:  # 80 bits of an x86: a whole mantissa, an exponent and a sign
        mantissa, power = struct.unpack("<QH", (cell if order == "<" else cell[::-1])[:10])
        if power & 0x7FFF == 0x7FFF:
            return math.nan if mantissa << 1 & (1 << 64) - 1 else math.copysign(math.inf, 0.5 - (power >> 15))
        exact = Fraction(mantissa) * Fraction(2) ** ((power & 0x7FFF) - 16446 + (0 if power & 0x7FFF else 1))
        return -exact if power >> 15 else exact
    return struct.unpack(order + CODES[f"{kind}{size}"], cell)[0]


def _turned(values: list, shape: tuple) -> list:
    """From Fortran's order to C's."""
    steps = [math.prod(shape[:i]) for i in range(len(shape))]
    places = [0]
    for n, step in zip(shape, steps, strict=True):
        places = [p + i * step for p in places for i in range(n)]
    return [values[p] for p in places]


def npz(path: Path, grid: tuple | None, highest: float) -> Content:
    arrays = {}
    for name, content in members(path).items():
        need(name.endswith(".npy"), "a member that is no array")
        arrays[label(name.removesuffix(".npy"))] = npy(content)
    need({"frames", "offsets", "subject", "gesture"} <= set(arrays), "an array is missing")
    shape, kind, flat = arrays.pop("frames")
    need(len(shape) == 3 and 0 not in shape and kind in "iuf", "frames")
    need(grid is None or shape[1:] == grid, "another grid")
    size, kind, offsets = arrays.pop("offsets")
    n = size[0] if len(size) == 1 else 0
    need(kind in "iu" and n > 1 and offsets[0] == 0 and offsets[-1] == shape[0], "offsets")
    lengths = lengths_of(offsets[:-1], offsets[-1])
    need(min(lengths) > 0, "an empty capture")
    columns = {}
    for name, (size, kind, values) in arrays.items():
        need(size == (n - 1,), "a condition of another length")
        need(kind in ("iuSU" if name in ("subject", "gesture", "frame") else "iufbSU"), "a condition of another type")
        columns[name] = [label(v) for v in values] if kind in "SU" else values
        need(all(math.isinf(v) or math.isnan(v) or float(v) == v for v in values if isinstance(v, Fraction)), "a float")
    channels = shape[1] * shape[2]
    flat = [sensor(v, highest) for v in flat]
    return Content([flat[i : i + channels] for i in range(0, len(flat), channels)], lengths, columns, shape[1:])


def parquet(path: Path, grid: tuple, highest: float) -> Content:
    import pyarrow as pa
    import pyarrow.parquet as pq

    channels = grid[0] * grid[1]
    try:
        metadata = pq.read_metadata(path)
        columns = [metadata.schema.column(i).physical_type for i in range(metadata.num_columns)]
        row = sum({"BYTE_ARRAY": 32, "INT32": 4, "FLOAT": 4, "BOOLEAN": 1, "INT96": 12}.get(c, 8) for c in columns)
        need(metadata.num_rows * row <= max(16 << 20, 100 * path.stat().st_size), "too much")
        read_in = pq.read_table(path)
        about = json.loads((read_in.schema.metadata or {}).get(b"pandas", b"{}"))
        index = [name for name in about.get("index_columns", []) if isinstance(name, str)]
        kinds = [field.type for field in read_in.schema if field.name not in index]
        cells = [read_in.column(i).to_pylist() for i, name in enumerate(read_in.column_names) if name not in index]
        names = [name for name in read_in.column_names if name not in index]
    except Invalid:
        raise
    except Exception as e:  # damaged in one of many ways
        raise Invalid(f"not parquet: {e!r}") from e
    need(names, "no columns")
    names = column_names(names)
    about, places = layout(names, channels)
    need(len(about) <= MOST_CONDITIONS, "too many conditions")
    need(cells[0], "no frames")
    columns = {}
    for name, i in about.items():
        kind, column = kinds[i], cells[i]
        need(not pa.types.is_nested(kind), "lists")
        need(None not in column and not any(v != v for v in column), "an empty cell")
        if name == "frame":
            need((pa.types.is_integer(kind) or pa.types.is_floating(kind)), "frame is no number")
            need(all(abs(v) < 2**53 and v == int(v) for v in column), "frame is no whole number")
        columns[name] = [text_of(v) for v in column] if name != "frame" else [int(v) for v in column]
    sensors = [cells[i] for i in places]
    for kind in (kinds[i] for i in places):
        need(pa.types.is_integer(kind) or pa.types.is_floating(kind), "channels that are no numbers")
    need(all(v is not None for column in sensors for v in column), "an empty cell")
    values = [
        [sensor(float(v) if isinstance(v, float) else v, highest) for v in row] for row in zip(*sensors, strict=True)
    ]
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return long_table(rows, values, grid)


def text_of(value: object) -> object:
    """A label as it is stored."""
    if isinstance(value, bytes):
        try:
            value = value.decode()
        except UnicodeDecodeError as e:
            raise Invalid("a label is not UTF-8") from e
    return label(value) if isinstance(value, str) else value
