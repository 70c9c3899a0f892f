"""What can be wrong with archives, arrays and parquet files, in what they hold and in what they say of it."""

import json
import random
import struct
import zlib
from collections.abc import Callable

import numpy as np
import pyarrow as pa

from tests.fuzz import inputs

FIELDS = [  # of a zip's directory and a member's own header: flags, packing, checksum, sizes, lengths of names, place
    *[((8, 6), "<H"), ((10, 8), "<H"), ((16, 14), "<L"), ((20, 18), "<L"), ((24, 22), "<L")],
    *[((28, 26), "<H"), ((30, 28), "<H"), ((42, 10), "<L")],
]
NASTY = {
    "f": [np.nan, np.inf, -1, -0.0, 1e39, 1e200, 16777217, 2.0**53, 1e-300],
    "i": [-1, 2**7 - 1, 16777217, 2**53 + 1],
    "u": [0, 2**8 - 1, 16777217, 2**53 + 1, 2**63, 2**64 - 1],
    "U": ["", " ", "a\0b", "\0a", "\ud800", "\u2028", "x" * 300, "\x1b"],
    "S": [b"", b" ", b"\xff", b"a\0b", b"x" * 300, "\u3000".encode()],
    "b": [True],
}


def changed_haart(rng: random.Random, often: int, damage: list, changed: Callable) -> bytes:
    """A release as a zip file; ``changed`` does something to one of its CSV files."""
    parts = inputs.good_haart(rng)
    zipped = rng.choice([0, 1]) if often else 0
    for _ in range(often - zipped):
        changed(rng, parts[rng.choice(list(parts))], damage)
    folder = rng.choice(["", "HAART DataSet/", "a/b/"])
    members = {f"{folder}{name}": part.encoded() for name, part in parts.items()}
    return _packed(rng, members, zipped, damage)


def _packed(rng: random.Random, members: dict, zipped: int, damage: list) -> bytes:
    """An archive, with something wrong about it if ``zipped``."""
    which = rng.random()
    if zipped and which < 0.5:
        _members(rng, members, damage)
    content = inputs.packed(rng, members)
    return _archive(rng, content, damage) if zipped and which >= 0.5 else content


def _members(rng: random.Random, members: dict, damage: list) -> None:
    name = rng.choice(list(members))
    base = name.rsplit("/", 1)[-1]
    what = rng.choice(["gone", "renamed", "beside", "deeper", "bomb", "empty", "folder", "many"])
    if what in ("gone", "renamed"):
        content = members.pop(name)
        if what == "renamed":
            other = [name.upper(), name + "~", "../" + name, "/" + name, "x\n" + name, "é/" + name, "._" + name]
            members[rng.choice(other)] = content
    elif what == "beside":
        members[f"other/{base}"] = members[name]
    elif what == "deeper":
        members[f"{name}/old/{base}"] = b"x"
    elif what == "bomb":
        more = rng.choice([b"\n", b",", b"\0"]) * rng.choice([10**6, 10**8])
        members[rng.choice([name, "z" + name])] = members[name] + more
    elif what == "empty":
        members[name] = b""
    elif what == "folder":
        members[name + "/"] = b""
    else:
        members |= {f"{i}.npy": b"x" for i in range(2000)}
    damage.append(f"member {what}")


def _archive(rng: random.Random, content: bytes, damage: list) -> bytes:
    """What the archive says of a member is changed."""
    raw = bytearray(content)
    at = rng.choice([i for i in range(len(raw) - 46) if raw[i : i + 4] == b"PK\x01\x02"])
    (local,) = struct.unpack_from("<L", raw, at + 42)
    where, form = rng.choice(FIELDS)
    (old,) = struct.unpack_from(form, raw, at + where[0])
    new = rng.choice([old + 1, old - 1, old // 2, 0, 1, 0xFFFF, 0xFFFFFFFF, 1 << 30, old ^ 1, rng.randrange(1 << 16)])
    new &= (1 << 8 * struct.calcsize(form)) - 1
    struct.pack_into(form, raw, at + where[0], new)
    if rng.random() < 0.7:
        struct.pack_into(form, raw, local + where[1], new)
    if where[0] == 24 and rng.random() < 0.7:  # another size, with the checksum of as much
        name, extra = struct.unpack_from("<HH", raw, local + 26)
        data = bytes(raw[local + 30 + name + extra :])
        try:
            data = zlib.decompressobj(-15).decompress(data)
        except zlib.error:
            pass
        for place in (at + 16, local + 14):
            struct.pack_into("<L", raw, place, zlib.crc32(data[:new]))
    damage.append(f"zip field {where[0]}: {old} to {new}")
    return bytes(raw)


def changed_npz(rng: random.Random, often: int, damage: list) -> tuple:
    """A ``.npz`` file and its options."""
    arrays, options = inputs.good_npz(rng)
    zipped = rng.choice([0, 0, 1]) if often else 0
    claims: dict = {}
    for _ in range(often - zipped):
        rng.choice([_array, _array, _claim])(rng, arrays, claims, damage)
    members = inputs.npy_members(rng, arrays) | claims
    return _packed(rng, members, zipped, damage), options


def _array(rng: random.Random, arrays: dict, claims: dict, damage: list) -> None:
    """Another value, type or shape of an array."""
    name = rng.choice(["frames", "offsets", "subject", "gesture", rng.choice(list(arrays) or ["frames"])])
    array = arrays.get(name)
    if array is None or not array.size:
        return
    what = rng.choice(["value", "value", "type", "shape", "gone", "more", "objects"])
    with np.errstate(all="ignore"):
        if what == "value" and array.dtype.kind in NASTY:
            array = array.astype(f"{array.dtype.kind}300") if array.dtype.kind in "US" else np.array(array)
            value = rng.choice(NASTY[array.dtype.kind])
            array.flat[rng.randrange(array.size)] = np.array(value).astype(array.dtype)
        elif what == "type":
            try:
                array = array.astype(rng.choice("? c16 m8[s] M8[D] S3 U3 f2 g i1 V4 u8 >f4".split()))
            except (TypeError, ValueError):
                return
        elif what == "shape":
            others = [array.ravel(), array[..., None], array[:-1], array[:0], np.repeat(array, 2, axis=0), array[0]]
            array = np.asarray(rng.choice(others))
        elif what == "objects":
            array = array.astype(object)
    if what == "gone":
        del arrays[name]
    elif what == "more":
        arrays[rng.choice(["p_x", "fold", "capture", "frame", "n" * 250, "é", "x\ny", "a/b"])] = array
    else:
        arrays[name] = array
    damage.append(f"{name}: {what}")


def _claim(rng: random.Random, arrays: dict, claims: dict, damage: list) -> None:
    """A header that says what is not so."""
    if not arrays:
        return
    name = rng.choice(list(arrays))
    array = arrays[name]
    descrs = ["'|O'", "'<U0'", "'<f16'", "'<U99999999'", "[('a', '<f8')]", "'('", "None", "'<f8' * 9", "'>i8'", "'<u8'"]
    descr = rng.choice([repr(array.dtype.str)] * 8 + descrs)
    shapes = [
        (10**12, 8, 8),
        (2**63,),
        (-1, 2, 2),
        (10**30,),
        "(" * 500,
        "()",
        (0,),
        "(1,",
        f"(9{'9' * 5000},)",
        (True,),
    ]
    shape = rng.choice([array.shape] * 8 + shapes)
    content = b"" if array.dtype.hasobject else array.tobytes()
    content = rng.choice([content, content, content[:-1], content + b"\0", content * 2])
    fortran = rng.choice(["False", "True", "1", "'no'"])
    claims[f"{name}.npy"] = inputs.npy(descr, shape if isinstance(shape, str) else repr(shape), content, fortran)
    damage.append(f"{name} claims {descr[:30]} {str(shape)[:30]}")


def changed_parquet(rng: random.Random, often: int, damage: list) -> tuple:
    """A parquet file and its options; where nothing is wrong with the table, bytes are to be."""
    table, options = inputs.good_parquet(rng)
    for _ in range(often - rng.choice([0, 1]) if often else 0):
        if 0 < table.num_rows < 1000 and table.num_columns:
            table = _table(rng, table, damage)
    return inputs.parquet_bytes(rng, table), options


def _table(rng: random.Random, table: pa.Table, damage: list) -> pa.Table:
    """Another value, type, name or place of a column."""
    i = rng.choice([rng.randrange(table.num_columns), rng.randrange(min(4, table.num_columns))])
    name, column = table.column_names[i], table.column(i).to_pylist()
    what = rng.choice(["value", "value", "type", "name", "gone", "swapped", "rows", "many", "index"])
    damage.append(f"{name}: {what}")
    if what == "value":
        odd = [None, "", " ", "a\0b", "\u2028", "x" * 300, "\u3000", b"\xff", b"a", "x" * 100_000]
        numbers = [None, -1, 16777217, 2**53 + 1, 2**63 - 1, 0.5, 1e39, 1e200, float("nan"), float("inf"), 2**40]
        column[rng.randrange(len(column))] = rng.choice(odd if isinstance(column[0], (str, bytes)) else numbers)
        return table.set_column(i, name, _as_array(column))
    if what == "type":
        return table.set_column(i, name, _of_another_type(rng, len(column)))
    if what == "name":
        other = ["", " ", "subject", "gesture", "frame", "capture", "p_x", "a\0b", "x" * 201, "a.b", " ch0", "ü"]
        return table.rename_columns([rng.choice(other) if n == name else n for n in table.column_names])
    if what == "gone":
        return table.remove_column(i)
    if what == "swapped":
        return table.select(rng.sample(range(table.num_columns), table.num_columns))
    if what == "rows":
        return table.slice(0, 0)
    if what == "many":
        return _long(table, rng.choice([10_000, 2_000_000]))
    about = [
        json.dumps({"index_columns": [name]}),
        "{",
        "[]",
        '{"index_columns": null}',
        '{"index_columns": [{}]}',
        "\xff",
    ]  # noqa: UP031
    return table.replace_schema_metadata({"pandas": rng.choice(about)})


def _of_another_type(rng: random.Random, n: int) -> pa.Array:
    kinds = [
        pa.duration("s"),
        pa.timestamp("s"),
        pa.date32(),
        pa.time32("s"),
        pa.decimal128(5, 1),
        pa.int8(),
        pa.uint64(),
    ]
    others = [
        pa.array([True] * n),
        pa.array([[1]] * n),
        pa.array([{"a": 1}] * n),
        pa.array([None] * n),
        pa.array(["1"] * n),
        pa.array([1] * n).dictionary_encode(),
        pa.array([b"ab"] * n, pa.binary(2)),
        pa.array(np.ones(n, np.float16)),
    ]
    return rng.choice([*others, *(pa.array([1] * n, kind) for kind in kinds)])


def _long(table: pa.Table, count: int) -> pa.Table:
    """A few columns of very many equal rows, which pack to nearly nothing."""
    zeros = pa.array(np.zeros(count, np.int8))
    columns = {}
    for i, name in enumerate(table.column_names[:6]):  # two columns may have one name
        one = table.column(i)[:1].combine_chunks()
        columns[name] = pa.DictionaryArray.from_arrays(zeros, one) if pa.types.is_string(one.type) else zeros
    return pa.table(columns)


def _as_array(column: list) -> pa.Array:
    """Values of mixed types in the first type that takes them."""
    for kind in (None, pa.uint64(), pa.float64(), pa.string(), pa.binary()):
        try:
            return pa.array(column, kind)
        except (pa.ArrowException, TypeError, OverflowError, ValueError):
            continue
    return pa.array([str(v) for v in column])
