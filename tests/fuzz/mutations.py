"""Inputs of the importers: good files, and what chance, programs and attackers make of them."""

import random

from tests.fuzz import inputs
from tests.fuzz.inputs import KINDS, Input, Text
from tests.fuzz.mutations_packed import changed_haart, changed_npz, changed_parquet

NUMBERS = """0 -1 -0 +1 1.5 1e3 1e39 1e200 1e400 1e-50 nan inf -inf 0x10 0X1F 1_0 1,0 ٣ ½ 𝟏 16777217 33554432 65536
1023 1024 2 3 00001 1. .5 1e e1 --1 0b1 1d5 9007199254740993 18446744073709551616 9223372036854775807
-9223372036854775808
1111111111111111111"""
LABELS = """NaN TRUE null None ' =1+1 @a 🙂 P1 T9 pat rub subject gesture frame " "" "a a" "a"b" "a""b" """
ODD = [
    " ",
    "\t",
    "1 0",
    "a\0b",
    "\0",
    "\x1b[31m",
    "\u2028",
    "\ufeff",
    "\x85",
    "\u3000",
    '"a\nb"',
    ' "a"',
    "a\rb",
    "a\x0bb",
]
LONG = ["9" * 400, "9" * 5000, "0" * 5000, "0." + "3" * 5000, "x" * 201, "x" * 200_000]
CELLS = ["", *NUMBERS.split(), *LABELS.split(), *ODD, *LONG, "\udcff"]
SLY = [*"0x10 0X1F 0x1 0x0 16777217 33554432 9007199254740993 1_0 +1 1e3 .5 -0 nan inf 1e39 ٣".split()]  # nearly good
SLY += ["\ufeffann", "a\0b", "\u3000", '"a\nb"', "a\u2028b", "ann\x85", "x" * 201, '"ann" ', "ann\0"]
NAMES = ["", " ", "a\0b", "x" * 201, "x" * 140_000, '"a,b"', '"a', "ü"]
NAMES += "subject gesture frame capture fold p_pat index ch1 cell1".split()


def example(seed: int, number: int) -> Input:
    """The input of this number; about one in seven is good."""
    rng = random.Random(f"{seed}-{number}")
    kind = KINDS[number % len(KINDS)]
    often = rng.choice([0, 1, 1, 1, 2, 2, 3])
    damage: list = []
    if kind in ("cost", "csv"):
        content, options = _text(rng, kind, often, damage)
    elif kind == "haart":
        content, options = changed_haart(rng, often, damage, changed), {}
    else:
        content, options = {"npz": changed_npz, "parquet": changed_parquet}[kind](rng, often, damage)
    if often and (not damage or rng.random() < 0.1):
        content = flipped(rng, content, damage)
    if often and options and rng.random() < 0.15:
        _options(rng, options, damage)
    suffix = {"haart": ".zip", "npz": ".npz", "parquet": ".parquet"}.get(kind, ".csv")
    name = rng.choice(["a", "a", "b c", "ü", "n" * 100]) + (suffix.upper() if rng.random() < 0.1 else suffix)
    return Input(kind, name, content, options, damage)


def _text(rng: random.Random, kind: str, often: int, damage: list) -> tuple:
    text, options = (inputs.good_cost(rng), {}) if kind == "cost" else inputs.good_csv(rng)
    for _ in range(often):
        changed(rng, text, damage)
    content = text.encoded()
    if often and rng.random() < 0.15:
        form = rng.choice(["utf-16", "utf-16-le", "latin-1", "utf-8-sig", "cp037"])
        content = content.decode(errors="replace").encode(form, "replace")
        damage.append(form)
    return content, options


def changed(rng: random.Random, text: Text, damage: list) -> None:
    """Do one thing to a CSV file."""
    rng.choice((_cell, _cell, _cell, _column, _lines, _lines, _blank, _header, _wider, _ends))(rng, text, damage)


def _line(rng: random.Random, text: Text) -> int:
    return rng.randrange(len(text.lines))


def _of_all(rng: random.Random, text: Text) -> str:
    """A cell for every line, short where there are many."""
    return rng.choice([c for c in [*CELLS, *SLY] if len(c) * len(text.lines) < 10_000_000])


def _cell(rng: random.Random, text: Text, damage: list) -> None:
    cells = text.lines[_line(rng, text)] if text.lines else []
    if cells:
        at = rng.randrange(min(len(cells), rng.choice([6, len(cells)])))
        cells[at] = rng.choice(rng.choice([CELLS, SLY]))
        damage.append(f"cell {cells[at][:20]!r}")


def _column(rng: random.Random, text: Text, damage: list) -> None:
    at, cell = rng.randrange(len(text.header) or 1), _of_all(rng, text)
    for cells in text.lines:
        if at < len(cells):
            cells[at] = cell
    damage.append(f"column {at} of {cell[:20]!r}")


def _lines(rng: random.Random, text: Text, damage: list) -> None:
    if not text.lines:
        return
    i, j = _line(rng, text), _line(rng, text)
    what = rng.choice(["cut", "twice", "swapped", "gone", "half", "none"])
    if what == "cut":
        text.lines[i] = text.lines[i][: rng.randrange(len(text.lines[i]) + 1)]
    elif what == "twice":
        text.lines.insert(i, list(text.lines[i]))
    elif what == "swapped":
        text.lines[i], text.lines[j] = text.lines[j], text.lines[i]
    elif what == "gone":
        del text.lines[i]
    elif what == "half":
        del text.lines[i:]
    else:
        text.lines.clear()
    damage.append(f"line {what}")


def _blank(rng: random.Random, text: Text, damage: list) -> None:
    run = rng.choice([[""], ["", ""], [" "], ["\t", ""], [""] * 1000, [""] * 1_000_000])
    at = rng.choice([0, len(text.lines), rng.randrange(len(text.lines) + 1)])
    text.lines[at:at] = [[cell] for cell in run]
    damage.append(f"{len(run)} blank lines")


def _header(rng: random.Random, text: Text, damage: list) -> None:
    at, what = rng.randrange(len(text.header) or 1), rng.choice(["renamed", "gone", "more", "swapped", "many", "none"])
    if what == "renamed" and text.header:
        text.header[at] = rng.choice(NAMES)
    elif what == "gone" and text.header:
        del text.header[at]
    elif what == "more":
        text.header.insert(at, rng.choice(NAMES))
    elif what == "swapped" and text.header:
        text.header[at], text.header[0] = text.header[0], text.header[at]
    elif what == "many":
        count, twice = rng.choice([300, 100_000]), rng.choice([0, 7])
        text.header[at:at] = [f"c{i}" for i in range(count)] + ["c7"] * twice
    else:
        text.header.clear()
    damage.append(f"header {what}")


def _wider(rng: random.Random, text: Text, damage: list) -> None:
    name, cell = rng.choice(NAMES), _of_all(rng, text)
    at = rng.choice([0, len(text.header), rng.randrange(len(text.header) + 1)])
    text.header.insert(at, name)
    for cells in text.lines:
        cells.insert(at, cell)
    damage.append(f"column {name[:20]!r} of {cell[:20]!r} more")


def _ends(rng: random.Random, text: Text, damage: list) -> None:
    text.end = rng.choice(["\r", "\x0b", "\x85", "\u2028", ";\n", ",\n", "\0\n", ""])
    damage.append(f"ends of {text.end!r}")


def flipped(rng: random.Random, content: bytes, damage: list) -> bytes:
    """Bytes flipped, cut, doubled or put in; the end is harmed as often as all before it."""
    raw = bytearray(content)
    for _ in range(rng.choice([1, 1, 2, 8])):
        if not raw:
            break
        at = rng.choice([rng.randrange(len(raw)), len(raw) - 1 - rng.randrange(min(len(raw), 400))])
        what, size = rng.randrange(7), rng.choice([1, 4, 100])
        if what < 3:
            raw[at] ^= 1 << rng.randrange(8)
        elif what == 3:
            raw[at : at + size] = rng.randbytes(size)
        elif what == 4:
            del raw[at : at + size]
        elif what == 5:
            raw[at:at] = raw[at : at + size] if rng.random() < 0.5 else b"\xff" * size
        else:
            del raw[at:]
    damage.append("bytes")
    return bytes(raw)


def _options(rng: random.Random, options: dict, damage: list) -> None:
    values = {
        "grid": [*"1x1 8x8 0x1 1x 999999999x9 ٣x1 1x-1 1X1 1000x1000".split(), "9" * 5000 + "x1"],
        "full_scale": "1e300 3.5e38 nan inf -1 0 1e-50 0.5 1e12 16777217".split(),
        "rate_hz": "0 -1 nan inf 1e300 1e-300".split(),
    }
    key = rng.choice(list(values))
    options[key] = rng.choice(values[key])
    damage.append(f"{key}={options[key][:20]}")
