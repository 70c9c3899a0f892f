"""Good files of every format that is imported, of random shape: shapes, types, line ends, quotes, packings, orders."""

import io
import random
import struct
import warnings
import zipfile
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

KINDS = ("cost", "haart", "csv", "parquet", "npz")
WORDS = ["ann", "bob", "ünïcode", "a b", "007", "null", "nan", "0x1f", "1e5", "=1+1", "😀", "-", "TRUE", "x" * 200]
QUOTED = ["x,y", 'say "hi"', ",", "a;b"]
PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@dataclass
class Input:
    """A file and how to import it.

    Attributes:
        kind: one of KINDS.
        name: of the file.
        content: bytes of it.
        options: of the importer.
        damage: what was done to a good file, nothing for a good one.
    """

    kind: str
    name: str
    content: bytes
    options: dict
    damage: list = field(default_factory=list)

    @property
    def importer(self) -> str:
        return self.kind if self.kind in ("cost", "haart") else "table"


@dataclass
class Text:
    """A CSV file before it is written: the header and the lines, as cells."""

    header: list
    lines: list
    end: str = "\n"
    mark: bool = False
    last: str = "\n"

    def encoded(self) -> bytes:
        lines = [",".join(self.header), *(",".join(cells) for cells in self.lines)]
        text = self.end.join(lines) + self.last.replace("\n", self.end)
        return (b"\xef\xbb\xbf" if self.mark else b"") + text.encode("utf-8", "surrogatepass")


def text_of(rng: random.Random, header: list, lines: list) -> Text:
    ends = rng.choice(["\n", "\n", "\r\n"])
    return Text(header, lines, ends, rng.random() < 0.1, rng.choice(["\n", "\n", "", "\n\n", "\n \n\n\n", "\n\t"]))


def word(rng: random.Random) -> str:
    return rng.choice(WORDS)


def cell_of(rng: random.Random, text: str) -> str:
    """A label as a CSV file holds it."""
    if any(c in text for c in ',"') or rng.random() < 0.1:
        return '"' + text.replace('"', '""') + '"'
    return " " * rng.choice([0, 0, 0, 1]) + text + " " * rng.choice([0, 0, 0, 2])


def about(rng: random.Random, names: list) -> list:
    """Captures: labels by name, and a number of frames."""
    subjects, gestures = [word(rng) for _ in range(2)], [rng.choice([word(rng), rng.choice(QUOTED)]) for _ in range(2)]
    found = []
    for _ in range(rng.randint(1, 6)):
        labels = {name: word(rng) for name in names}
        labels |= {"subject": rng.choice(subjects), "gesture": rng.choice(gestures)}
        found.append((labels, rng.randint(1, 6)))
    return found


def value_of(rng: random.Random, style: str, scale: float) -> float:
    if style == "whole":
        return rng.randint(0, int(min(scale, 65535)))
    if style == "large":
        return rng.choice([0, 65535, 65536, 1 << 24, 1 << 25, 3 << 30]) if scale > 1e11 else rng.randint(0, int(scale))
    scale = min(scale, 1e6)
    return rng.choice([rng.random() * scale, 0.0, 1e-3 * scale, float(rng.randint(0, int(min(scale, 9))))])


def number(rng: random.Random, value: float) -> str:
    """A number as a CSV file may hold it."""
    plain = repr(value)
    forms = [plain, plain, plain, f" {plain}", f"{plain} ", f'"{plain}"', f"+{plain}", f"0{plain}", f"{value:.17e}"]
    if isinstance(value, int):
        forms += [f"{plain}.0", f"{plain}.", f"{value}e0"]
    return rng.choice(forms) if rng.random() < 0.1 else plain


def options_of(rng: random.Random, grid: tuple, scale: float) -> dict:
    options = {"rate_hz": rng.choice(["54", "135.0", "1e3", "0.5"]), "grid": f"{grid[0]}x{grid[1]}"}
    if scale != 1023.0 or rng.random() < 0.5:
        options["full_scale"] = repr(scale)
    return options


def shape(rng: random.Random) -> tuple:
    return rng.randint(1, 4), rng.randint(1, 4)


def scale_of(rng: random.Random) -> float:
    return rng.choice([1023.0, 1023.0, 1.0, 0.1, 65535.0, 1e6, 1e12, 3.4e38, 10.5])


def conditions(rng: random.Random) -> list:
    pool = ["place", "day", "the room", "Größe", "x.y", "x"]
    return rng.sample(pool, rng.randint(0, 3))


def good_csv(rng: random.Random) -> tuple:
    grid, scale = shape(rng), scale_of(rng)
    style, origin = rng.choice(["whole", "whole", "decimal", "large"]), rng.choice([0, 1])
    names = ["subject", "gesture", "frame", *conditions(rng)]
    rng.shuffle(names)
    lines = []
    for labels, length in about(rng, [n for n in names if n != "frame"]):
        for frame in range(origin, origin + length):
            cells = [str(frame) if n == "frame" else cell_of(rng, labels[n]) for n in names]
            cells += [number(rng, value_of(rng, style, scale)) for _ in range(grid[0] * grid[1])]
            lines.append(cells)
    header = [cell_of(rng, n) for n in [*names, *(f"ch{i}" for i in range(1, grid[0] * grid[1] + 1))]]
    if rng.random() < 0.2:
        order = rng.sample(range(len(header)), len(header))
        header, lines = [header[i] for i in order], [[cells[i] for i in order] for cells in lines]
    return text_of(rng, header, lines), options_of(rng, grid, scale)


def good_cost(rng: random.Random) -> Text:
    names = ["subject", "variant", "gesture", "frame", *(f"ch{i}" for i in range(1, 65))]
    if rng.random() < 0.2:
        rng.shuffle(names)
    lines = []
    for _ in range(rng.randint(1, 5)):
        labels = {"subject": rng.randint(0, 99), "variant": rng.randint(1, 3), "gesture": rng.randint(1, 14)}
        for frame in range(1, rng.randint(2, 5)):
            row = labels | {"frame": frame}
            lines.append([str(row[n]) if n in row else str(rng.randint(0, 1023)) for n in names])
    return text_of(rng, [f" {n}" if i else n for i, n in enumerate(names)], lines)


def good_haart(rng: random.Random) -> dict:
    gestures = ["constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle"]
    found = {}
    for name, who in (("training.csv", "ParticipantNo"), ("testWITHLABELS.csv", "ParticipantID")):
        names = [who, "Substrate", "Cover", "Gesture", *(["Sequence"] if who.endswith("D") else [])]
        names += [f"cell{i}" for i in range(1, 65)]
        lines = []
        for _ in range(rng.randint(1, 2)):
            labels = [f"{rng.choice(['P', 'T', ''])}{rng.randint(1, 10)}", word(rng), word(rng), rng.choice(gestures)]
            cells = [str(rng.randint(0, 1023)) for _ in range(64)]
            for i in range(1, 433):
                cells[rng.randrange(64)] = str(rng.randint(0, 1023))
                lines.append([*labels, *([str(i)] if who.endswith("D") else []), *cells])
        header = [f' "{n}"' if 0 < i < 4 else n for i, n in enumerate(names)]
        found[name] = text_of(rng, header, lines)
    return found


def packed(rng: random.Random, members: dict, packing: int | None = None) -> bytes:
    """A zip archive, with what file managers add to it."""
    packing = rng.choice(PACKINGS) if packing is None else packing
    buffer = io.BytesIO()
    items = list(members.items())
    rng.shuffle(items)
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", packing) as archive:
        warnings.simplefilter("ignore")
        if rng.random() < 0.2:
            archive.writestr("__MACOSX/", "")
            archive.writestr(f"__MACOSX/{rng.choice(['._', ''])}{items[0][0]}", "Mac OS X")
        if rng.random() < 0.1:
            archive.writestr("folder/", "")
        for name, content in items:
            archive.writestr(name, content)
    return buffer.getvalue()


def good_npz(rng: random.Random) -> tuple:
    """Arrays by name, and options."""
    grid, scale = shape(rng), scale_of(rng)
    captures = about(rng, names := conditions(rng))
    lengths = [length for _, length in captures]
    style = rng.choice(["whole", "decimal", "large"])
    frames = [[value_of(rng, style, scale) for _ in range(grid[0] * grid[1])] for _ in range(sum(lengths))]
    types = ["<f8", ">f8", "<f4", "g"] if style == "decimal" else ["<i8", ">i8", "<u8", "<f8", ">u4", "g"]
    types += ["<u2", ">u2"] if style == "whole" else []
    dtype = np.dtype(rng.choice(types))
    top = max(max(row) for row in frames)
    if dtype.kind in "iu" and top > np.iinfo(dtype).max:
        dtype = np.dtype("<u8")
    frames = np.array(frames).astype(dtype).reshape(-1, *grid)
    arrays = {"frames": np.asfortranarray(frames) if rng.random() < 0.2 else frames}
    arrays["offsets"] = np.cumsum([0, *lengths]).astype(rng.choice(["<i8", ">i4", "<u8", "<u2", "|u1"]))
    for name in ("subject", "gesture"):
        arrays[name] = condition(rng, [labels[name] for labels, _ in captures], ["U", "S", ">U", "i8", ">u2"])
    for name in names:
        kinds = ["U", "S", "i8", ">f4", "<f2", "g", "?", "<u8", "|i1", "nan"]
        arrays[name] = condition(rng, [labels[name] for labels, _ in captures], kinds)
    options = options_of(rng, grid, scale)
    if rng.random() < 0.5:
        del options["grid"]
    return arrays, options


def condition(rng: random.Random, words: list, kinds: list) -> np.ndarray:
    kind = rng.choice(kinds)
    if kind == "S":
        return np.array([w.encode() for w in words])
    if "U" in kind:
        array = np.array([" " * rng.choice([0, 0, 2]) + w for w in words])
        return array.astype(array.dtype.newbyteorder(">")) if kind == ">U" else array
    if kind == "nan":
        return np.array([rng.choice([np.nan, np.inf, 0.1]) for _ in words])
    return np.array([rng.randint(0, 1 if kind == "?" else 100) for _ in words]).astype(kind)


def npy_members(rng: random.Random, arrays: dict) -> dict:
    """The members of a ``.npz`` file."""
    members = {}
    for name, array in arrays.items():
        buffer = io.BytesIO()
        np.lib.format.write_array(buffer, array, rng.choice([None, (1, 0), (2, 0)]), allow_pickle=True)
        members[f"{name}.npy"] = buffer.getvalue()
    return members


def npy(descr: str, shape: str, content: bytes, fortran: str = "False") -> bytes:
    """An array whose header need not fit."""
    head = f"{{'descr': {descr}, 'fortran_order': {fortran}, 'shape': {shape}}}".encode("latin1", "replace") + b"\n"
    return b"\x93NUMPY\x02\x00" + struct.pack("<L", len(head)) + head + content


def good_parquet(rng: random.Random) -> tuple:
    """A table, and options."""
    grid, scale = shape(rng), scale_of(rng)
    style, origin = rng.choice(["whole", "decimal", "large"]), rng.choice([0, 1])
    names = ["subject", "gesture", *conditions(rng)]
    captures = about(rng, names)
    lengths = [length for _, length in captures]
    columns = {}
    for name in names:
        column = [labels[name] for labels, length in captures for _ in range(length)]
        columns[name] = label_column(rng, column, lengths, numbers=name not in ("subject", "gesture"))
    frame = pa.array([i for length in lengths for i in range(origin, origin + length)])
    columns["frame"] = frame.cast(rng.choice([pa.int64(), pa.int8(), pa.uint64(), pa.float64(), pa.float32()]))
    columns = dict(rng.sample(list(columns.items()), len(columns)))
    for i in range(grid[0] * grid[1]):
        values = [value_of(rng, style, scale) for _ in range(sum(lengths))]
        kinds = [pa.float64()] if style == "decimal" else [pa.int64(), pa.uint64(), pa.float64()]
        kinds += [pa.float32()] if style == "decimal" else []
        kinds += [pa.uint16()] if style == "whole" else []
        columns[f"ch{i}"] = pa.array(values).cast(rng.choice(kinds))
    return pa.table(columns), options_of(rng, grid, scale)


def label_column(rng: random.Random, words: list, lengths: list, numbers: bool) -> pa.Array:
    kind = rng.choice(
        ["text", "text", "large", "bytes", "coded", "spaces", "whole", *(["float", "truth"] if numbers else [])]
    )
    same = [i for i, length in enumerate(lengths) for _ in range(length)]
    if kind == "bytes":
        return pa.array([w.encode() for w in words])
    if kind == "coded":
        return pa.array(words).dictionary_encode()
    if kind == "spaces":
        return pa.array([" " * rng.randint(0, 1) + w for w in words])
    if kind in ("whole", "float", "truth"):
        return pa.array([{"whole": i, "float": i / 8, "truth": i % 2 == 0}[kind] for i in same])
    return pa.array(words, pa.large_string() if kind == "large" else pa.string())


def parquet_bytes(rng: random.Random, table: pa.Table) -> bytes:
    buffer = io.BytesIO()
    pq.write_table(
        table,
        buffer,
        row_group_size=rng.choice([1, 3, 1000]) if table.num_rows < 1000 else 1 << 20,
        version=rng.choice(["1.0", "2.4", "2.6"]),
        compression=rng.choice(["none", "snappy", "zstd", "gzip", "brotli", "lz4"]),
        use_dictionary=rng.random() < 0.7,
        data_page_version=rng.choice(["1.0", "2.0"]),
        write_statistics=rng.random() < 0.7,
        write_page_checksum=rng.random() < 0.2,
        store_schema=rng.random() < 0.8,
    )
    return buffer.getvalue()
