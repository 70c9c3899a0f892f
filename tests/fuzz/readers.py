"""A second reader of every format that is imported, written from the formats and not from the importers.

Slow and plain on purpose: lists, `csv`, `zipfile` and `struct`. It says what a file holds, or why it cannot be right;
messages, lines and speed are not its business.
"""

import csv
import math
import re
from collections import Counter
from pathlib import Path

from tests.fuzz.archives import haart_files, npz, parquet
from tests.fuzz.cells import (
    MOST_CONDITIONS,
    Content,
    Invalid,
    captures,
    column_names,
    decimal,
    integer,
    label,
    layout,
    lengths_of,
    long_table,
    need,
    single,
)

COST_GESTURES = "grab hit massage pat pinch poke press rub scratch slap squeeze stroke tap tickle".split()
HAART_GESTURES = {"constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle"}
NOT_A_CONDITION = {"fold", "capture", "start", "frames", "true", "predicted"}


def read(kind: str, path: Path, options: dict) -> Content:
    """What the file holds.

    Raises:
        Invalid: it cannot be right.
    """
    if kind == "cost":
        return cost(path)
    if kind == "haart":
        return haart(path)
    rate, scale = float(options["rate_hz"]), float(options.get("full_scale", "1023"))
    need(0 < rate < math.inf, "the rate")
    need(2.0**-126 <= scale and single(scale) < math.inf, "the full scale")
    grid = None
    if "grid" in options:
        need(re.fullmatch("[1-9][0-9]{0,6}x[1-9][0-9]{0,6}", options["grid"]), "the grid")
        grid = tuple(map(int, options["grid"].split("x")))
    suffix = path.suffix.lower()
    need(grid or suffix == ".npz", "no grid")
    highest = max(scale, single(scale))
    content = {".npz": npz, ".parquet": parquet}.get(suffix, table)(path, grid, highest)
    for name in content.columns:
        if name not in ("subject", "gesture"):
            need(name not in NOT_A_CONDITION and not name.startswith("p_"), f"a condition called {name}")
    need(len(content.columns) <= MOST_CONDITIONS, "too many conditions")
    for name in ("subject", "gesture"):
        content.columns[name] = [str(v) for v in content.columns[name]]
    return content


def grid_of_cells(content: bytes) -> list:
    """The cells of every line, the header first."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise Invalid("not UTF-8") from e
    text = text.replace("\r\n", "\n").rstrip(" \t\n")
    need(text, "an empty file")
    lines = text.split("\n")
    csv.field_size_limit(1 << 30)
    found = []
    for line in lines:
        need(line.strip(" \t"), "a blank line")
        need("\r" not in line, "a carriage return alone")
        cells = next(csv.reader([line], skipinitialspace=not found))
        need(not (cells[-1:] and _quote_open(line, not found)), "a line break within quotes")
        found.append(cells)
    found[0] = column_names([cell.strip().strip('"') for cell in found[0]])
    need(len(found) > 1, "no frames")
    for cells in found[1:]:
        need(len(cells) == len(found[0]), "another number of cells")
        need(all(cell.strip() for cell in cells), "an empty cell")
    return found


def _quote_open(line: str, header: bool) -> bool:
    """Whether the last cell goes on in the next line."""
    return len(list(csv.reader([line + "\n", "x"], skipinitialspace=header))) == 1


def table(path: Path, grid: tuple, highest: float) -> Content:
    header, *lines = grid_of_cells(path.read_bytes())
    channels = grid[0] * grid[1]
    names, places = layout(header, channels)
    need(len(names) <= MOST_CONDITIONS, "too many conditions")
    rows, values = [], []
    for cells in lines:
        about = {name: cells[i] for name, i in names.items()}
        rows.append({n: integer(c) if n == "frame" else label(c) for n, c in about.items()})
        values.append([decimal(cells[i], highest) for i in places])
    return long_table(rows, values, grid)


def cost(path: Path) -> Content:
    header, *lines = grid_of_cells(path.read_bytes())
    channels = [f"ch{i}" for i in range(1, 65)]
    about = ["subject", "variant", "gesture", "frame"]
    need(set(header) == {*about, *channels}, "other columns")
    rows, values = [], []
    for cells in lines:
        row = dict(zip(header, cells, strict=True))
        rows.append({name: integer(row[name]) for name in about})
        need(1 <= rows[-1]["variant"] <= 3 and 1 <= rows[-1]["gesture"] <= 14, "an unknown code")
        frame = [integer(row[name]) for name in channels]
        need("-" not in "".join(row[name] for name in channels), "a sign")
        need(max(frame) <= 1023, "a value beyond the full scale")
        values.append([v for r in range(7, -1, -1) for v in frame[8 * r : 8 * r + 8]])  # channel 1 is in the last row
    starts = captures(rows, about[:3], 1)
    seen: Counter = Counter()
    columns: dict = {"subject": [], "variant": [], "gesture": [], "repetition": []}
    for i in starts:
        key = tuple(rows[i][name] for name in about[:3])
        seen[key] += 1
        columns["subject"].append(str(key[0]))
        columns["variant"].append(("gentle", "normal", "rough")[key[1] - 1])
        columns["gesture"].append(COST_GESTURES[key[2] - 1])
        columns["repetition"].append(seen[key])
    return Content(values, lengths_of(starts, len(rows)), columns, (8, 8))


def haart(path: Path) -> Content:
    contents = haart_files(path)
    values: list = []
    columns: dict = {n: [] for n in ("subject", "gesture", "substrate", "cover", "split")}
    for name, split in (("training.csv", "train"), ("testwithlabels.csv", "test")):
        need(name in contents, f"no {name}")
        header, *lines = grid_of_cells(contents[name])
        about = ["ParticipantNo" if split == "train" else "ParticipantID", "Substrate", "Cover", "Gesture"]
        cells_64 = [f"cell{i}" for i in range(1, 65)]
        counted = ["Sequence"] if split == "test" else []
        need(set(header) >= {*about, *cells_64, *counted}, "a column is missing")
        need(len(header) - 64 <= MOST_CONDITIONS, "too many conditions")
        rows = []
        for i, cells in enumerate(lines):
            row = dict(zip(header, cells, strict=True))
            rows.append({n: label(c) for n, c in row.items() if n not in {*cells_64, *counted}})
            rows[-1]["frame"] = integer(row["Sequence"]) if counted else i % 432 + 1
            frame = [integer(row[n]) for n in cells_64]
            need("-" not in "".join(row[n] for n in cells_64), "a sign")
            need(max(frame) <= 1023, "a value beyond the full scale")
            values.append(frame)
        starts = captures(rows, about, 1)
        need(set(lengths_of(starts, len(rows))) == {432}, "a capture of another length")
        for i in starts:
            who, substrate, cover, gesture = (rows[i][n] for n in about)
            need(re.fullmatch("[PT]?[1-9][0-9]{0,8}", who), "an unknown participant")
            need(gesture in HAART_GESTURES, "an unknown gesture")
            for column, value in zip(columns, (who.lstrip("PT"), gesture, substrate, cover, split), strict=True):
                columns[column].append(value)
    return Content(values, [432] * len(columns["split"]), columns, (8, 8))


def difference(expected: Content, corpus: object) -> str:
    """In words, or nothing where the corpus holds what the file does."""
    if tuple(corpus.grid) != tuple(expected.grid):
        return f"grid {corpus.grid}, not {expected.grid}"
    if corpus.lengths.tolist() != expected.lengths:
        return f"lengths {corpus.lengths.tolist()[:9]}, not {expected.lengths[:9]}"
    whole = all(v == int(v) and v <= 65535 for row in expected.rows for v in row)
    kind = "uint16" if whole else "float32"
    if corpus.frames.dtype != kind:
        return f"frames of {corpus.frames.dtype}, not {kind}"
    stored = corpus.frames.reshape(len(expected.rows), -1).tolist()
    for i, (here, there) in enumerate(zip(stored, expected.rows, strict=True)):
        for channel, (a, b) in enumerate(zip(here, there, strict=True)):
            if a != b and a != single(b):
                return f"frame {i}, channel {channel}: {a}, not {b}"
    if set(corpus.captures) != set(expected.columns):
        return f"columns {list(corpus.captures)}, not {list(expected.columns)}"
    for name, values in expected.columns.items():
        for i, (a, b) in enumerate(zip(corpus.captures[name].tolist(), values, strict=True)):
            if not (a == b or (a != a and b != b)) or isinstance(a, str) != isinstance(b, str):
                return f"capture {i}: {name} is {a!r}, not {b!r}"
    return ""
