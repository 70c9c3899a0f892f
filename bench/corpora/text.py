"""Long CSV files of touch frames: read fast when they are good, explained to the line when they are not."""

from __future__ import annotations

import csv
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NoReturn

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv

from bench.corpora.labels import Words
from bench.corpora.limits import check_conditions, check_names, flaw, quoted, short
from bench.corpora.values import EXACT, highest_of, smallest, unfit, why
from bench.errors import InputError

BLOCK = 8 << 20  # bytes that are parsed at once
_BLANK = b" \t\n"
MOST_LINE = 4 << 20  # bytes
DOUBLE = 1 << 53  # float64 holds every whole number up to here
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_INTEGER = re.compile("-?[0-9]+")


@dataclass
class _Wanted:
    """What is read of each line: columns of whole numbers, columns of sensor values, and what these may be."""

    whole: list[str]
    channels: list[str]
    full_scale: float
    fractions: bool

    def __post_init__(self) -> None:
        self.highest = highest_of(self.full_scale)


@dataclass
class _Block:
    """What was read of some lines: sensor values [rows, channels], and by name whole numbers or words and codes."""

    values: np.ndarray
    labels: dict[str, np.ndarray | tuple[list[str], np.ndarray]]


@dataclass
class _Lines:
    """Number of the first line, how many there are, and their bytes; lines end with line feeds, the last one may."""

    first: int
    count: int
    content: bytes


class _Unfit(Exception):
    """Something in a block does not fit; what, is found by a slower look."""


class FrameFile:
    """A CSV file with one frame per row.

    Text in UTF-8, a header, as many cells in every line, no line breaks within cells, and blank lines only at the end.
    Lines are parsed in blocks, so what is no table costs a block, whatever it would expand to.

    Args:
        source: path, or what gives the content in parts, from the beginning at each call.
        label: what messages call it.

    Attributes:
        columns: header names without spaces and quotes.

    Raises:
        InputError: the file is missing, empty or not text.
    """

    def __init__(self, source: Path | Callable[[], Iterable[bytes]], label: str) -> None:
        self.source = partial(_parts, source, label) if isinstance(source, Path) else source
        self.label = label
        lines = next(self._blocks(), None)
        if lines is None:
            raise InputError(f"{label}: the file is empty; give a file with a header line and one line per frame")
        try:
            header = lines.content.partition(b"\n")[0].decode("utf-8-sig")
        except UnicodeDecodeError as e:
            raise InputError(f"{label}: not a text file in UTF-8; give the CSV file itself") from e
        if not header.strip():
            raise InputError(f"{label}, line 1: blank; begin the file with its header")
        self.columns = [name.strip().strip('"').strip() for name in _cells(header, header=True)]
        check_names(self.columns, f"{label}, line 1")

    def require(self, names: list[str]) -> None:
        """Raise an `InputError` that names the columns that are missing."""
        here = set(self.columns)
        if missing := [n for n in names if n not in here]:
            more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
            begin = quoted(", ".join(self.columns[:20])[:60], 70)
            raise InputError(
                f"{self.label}, line 1: no column {', '.join(missing[:3])}{more}; the line begins with {begin}"
            )

    def read(
        self, whole: list[str], channels: list[str], full_scale: float, fractions: bool = False
    ) -> tuple[pd.DataFrame, np.ndarray]:
        """Labels and sensor values of every row.

        Args:
            whole: label columns that hold whole numbers; the other label columns are text.
            channels: columns of sensor values, 0..full_scale.
            full_scale: largest value allowed.
            fractions: whether values may have decimals.

        Returns:
            Labels [rows], all columns but the channels in file order, and values [rows, channels], uint16 when every
            value is a whole number up to 65535, else float32.

        Raises:
            InputError: a cell that does not fit, with its line and column.
        """
        check_conditions(len(self.columns) - len(channels), f"{self.label}, line 1")
        wanted = _Wanted(whole, channels, full_scale, fractions)
        values, numbers, words = [], {name: [] for name in whole}, {}
        for block in _ahead(self._reader(wanted), self._rows()):
            values.append(block.values)
            for name, column in block.labels.items():
                if name in numbers:
                    numbers[name].append(column)
                else:
                    words.setdefault(name, Words()).add(*column)
        if not values:
            raise InputError(f"{self.label}: a header and no frames; give a file with one line per frame")
        labels = {n: np.concatenate(numbers[n]) if n in numbers else words[n].column() for n in block.labels}
        return pd.DataFrame(labels), np.concatenate(values)

    def _blocks(self) -> Iterator[_Lines]:
        """The file in parts of whole lines, without the blank lines at its end."""
        first, blank, rest = 1, 0, b""
        for part in chain(self.source(), [None]):
            if part is None:
                content, rest = rest, b""
            elif end := part.rfind(b"\n") + 1:
                content, rest = b"".join((rest, memoryview(part)[:end])), part[end:]
            else:  # as old Macs end lines; the last byte may be half of another line end
                rest += part
                end = rest.rfind(b"\r", 0, -1) + 1
                content, rest = rest[:end], rest[end:]
                if len(rest) > MOST_LINE:
                    line = blank or first
                    raise InputError(
                        f"{self.label}, line {line}: longer than {MOST_LINE >> 20} MiB; this is not a table"
                    )
            if b"\r" in content:
                content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            ended = content.count(b"\n")
            full = ended + (not content.endswith(b"\n"))
            if content[-2:].removesuffix(b"\n")[-1:] in (b"", b" ", b"\t", b"\n"):  # else a copy is spared
                content = content.rstrip(_BLANK)
                full = content.count(b"\n") + 1 if content else 0
            if content and blank:
                raise InputError(f"{self.label}, line {blank}: blank, but not at the end; delete the line")
            if content:
                yield _Lines(first, full, content)
            if ended > full:
                blank = blank or first + full
            first += ended

    def _rows(self) -> Iterator[_Lines]:
        """As `_blocks`, without the header."""
        for lines in self._blocks():
            if lines.first == 1:
                _, _, rest = lines.content.partition(b"\n")
                lines = _Lines(2, lines.count - 1, rest)
            if lines.content:
                yield lines

    def _reader(self, wanted: _Wanted) -> Callable[[_Lines], _Block]:
        """What reads a block, or says what is wrong with it."""
        text = pa.dictionary(pa.int32(), pa.string())
        types = dict.fromkeys(self.columns, text) | dict.fromkeys(wanted.whole, pa.int64())
        plain = types | dict.fromkeys(wanted.channels, pa.uint16())
        forms = [plain, types | dict.fromkeys(wanted.channels, pa.float64())] if wanted.fractions else [plain]

        def read(lines: _Lines) -> _Block:
            for types in list(forms):
                try:
                    found = self._parsed(lines, types, wanted)
                except _Unfit:
                    continue
                if types is forms[-1]:
                    del forms[:-1]  # one decimal seldom comes alone
                return found
            self._explain(lines, wanted)

        return read

    def _parsed(self, lines: _Lines, types: dict[str, pa.DataType], wanted: _Wanted) -> _Block:
        table = self._parse(lines.content, types)
        if len(table) != lines.count or any(column.null_count for column in table.itercolumns()):
            raise _Unfit  # a blank line, a line break within quotes, or an empty cell
        channels = set(wanted.channels)
        whole = set(wanted.whole)
        columns = dict(zip(self.columns, table.itercolumns(), strict=True))
        content = lines.content
        if (b"x" in content or b"X" in content) and re.search(rb"0[xX]", content):  # pyarrow reads 0x10 as 16
            numbers = channels | whole
            as_text = self._parse(content, types | dict.fromkeys(numbers, pa.string()))
            for name, column in zip(self.columns, as_text.itercolumns(), strict=True):
                if name in numbers and pc.any(pc.match_substring_regex(column, "[xX]")).as_py():
                    raise _Unfit
        kind = types[wanted.channels[0]]
        values = np.empty((len(table), len(channels)), np.uint16 if kind == pa.uint16() else np.float64)
        for i, name in enumerate(wanted.channels):
            values[:, i] = columns[name].to_numpy()
        if values.max() > wanted.highest if kind == pa.uint16() else unfit(values, wanted.highest).any():
            raise _Unfit
        if values.max() >= DOUBLE:
            self._compare(content, values, wanted)
        labels: dict[str, np.ndarray | tuple[list[str], np.ndarray]] = {}
        for name, column in columns.items():
            if name in whole:
                labels[name] = column.to_numpy()
            elif name not in channels:
                coded = column.combine_chunks()
                words = [word.strip() for word in coded.dictionary.to_pylist()]
                if any(map(flaw, words)):
                    raise _Unfit
                labels[name] = words, coded.indices.to_numpy()
        return _Block(values.astype(smallest(values), copy=False), labels)

    def _parse(self, content: bytes, types: dict[str, pa.DataType]) -> pa.Table:
        if content.startswith(b"\xef\xbb\xbf"):  # pyarrow would take what is a flaw in a label for the file's mark
            raise _Unfit
        try:
            return pacsv.read_csv(
                pa.BufferReader(content),
                read_options=pacsv.ReadOptions(
                    column_names=self.columns, block_size=len(content) + 1, use_threads=False
                ),
                convert_options=pacsv.ConvertOptions(column_types=types, strings_can_be_null=True, null_values=[""]),
            )
        except pa.ArrowException as e:
            raise _Unfit from e

    def _compare(self, content: bytes, values: np.ndarray, wanted: _Wanted) -> None:
        """Refuse numbers so large that float64 may not be what is written."""
        rows = np.flatnonzero((values >= DOUBLE).any(axis=1))
        text = content.split(b"\n")
        place = {name: i for i, name in enumerate(self.columns)}
        for row in rows:
            cells = _cells(text[row].decode())
            for name, value in zip(wanted.channels, values[row], strict=True):
                if value >= DOUBLE and not _written(cells[place[name]], value):
                    raise _Unfit

    def _explain(self, lines: _Lines, wanted: _Wanted) -> NoReturn:
        """Find the first line that does not fit and say what is wrong with it."""
        place = {name: i for i, name in enumerate(self.columns)}
        whole = [(place[n], n) for n in wanted.whole]
        channels = [(place[n], n) for n in wanted.channels]
        numbers = {*wanted.whole, *wanted.channels}
        labels = [(i, n) for n, i in place.items() if n not in numbers]
        content = lines.content.removesuffix(b"\n")
        for number, raw in enumerate(content.split(b"\n"), start=lines.first):
            where = f"{self.label}, line {number}"
            try:
                cells = _cells(raw.decode())
            except UnicodeDecodeError as e:
                raise InputError(f"{where}: not text in UTF-8; get the file again") from e
            if not cells:
                raise InputError(f"{where}: 0 fields instead of {len(self.columns)}, the line is blank; delete it")
            if len(cells) != len(self.columns):
                raise InputError(
                    f"{where}: {len(cells)} fields instead of {len(self.columns)}; the file is cut off or damaged "
                    "here, get it again or delete the line"
                )
            for i, name in whole:
                if not _is_int64(cells[i].strip(" \t")):
                    what = f"is {quoted(cells[i])}, not a whole number; correct the cell"
                    raise InputError(f"{where}: {short(name)} {what}")
            for i, name in channels:
                if wrong := _value_flaw(cells[i].strip(" \t"), wanted):
                    raise InputError(f"{where}: {short(name)} {wrong}")
            for i, name in labels:
                if wrong := flaw(cells[i].strip()):
                    raise InputError(f"{where}: {short(name)} {wrong}")
            if cells[-1].endswith("\n"):
                raise InputError(f"{where}: the quote of the last cell is not closed; a cell holds no line break")
        raise InputError(
            f"{self.label}, line {lines.first} or after: cannot be read as CSV; check quotes and line ends"
        )


def _parts(path: Path, label: str) -> Iterator[bytes]:
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise InputError(f"{label}: cannot be read (a device or a pipe); give a file")
        with open(path, "rb") as f:
            while part := f.read(BLOCK):
                yield part
    except OSError as e:
        raise InputError(f"{label}: cannot be read ({e.strerror}); check the path") from e


def _ahead(work: Callable, items: Iterable) -> Iterator:
    """The results of ``work`` in order, with as many under way as there are processors."""
    waiting: deque[Future] = deque()
    with ThreadPoolExecutor(pa.cpu_count()) as pool:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > pa.cpu_count():
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _cells(line: str, header: bool = False) -> list[str]:
    """The cells of one line; the last one ends with a line feed if a quote is open.

    Only quotes need the csv module, which takes no cell above 128 KiB.
    """
    if '"' in line:
        try:
            return next(csv.reader([line + "\n"], skipinitialspace=header))
        except csv.Error:
            pass
    return line.split(",") if line else []


def _is_int64(cell: str) -> bool:
    digits = cell.removeprefix("-").lstrip("0") or "0"
    return bool(_INTEGER.fullmatch(cell)) and len(digits) < 20 and int(digits) < 2**63 + cell.startswith("-")


def _written(cell: str, value: float) -> bool:
    return Decimal(cell.strip(" \t")) == Decimal(float(value))


def _value_flaw(cell: str, wanted: _Wanted) -> str:
    """What is wrong with a sensor value, as the end of a message, or nothing."""
    shape, kind = (_NUMBER, "a number") if wanted.fractions else (_INTEGER, "a whole number")
    if not shape.fullmatch(cell):
        return f"is {quoted(cell)}, not {kind}; correct the cell"
    value = float(cell)
    if value < 0 or (cell.startswith("-") and not wanted.fractions):
        return f"is {short(cell, 40)}, below 0; correct the cell"
    if value > wanted.highest:
        return f"is {short(cell, 40)}, above the full scale {wanted.full_scale:g}; correct it or give full_scale="
    if value > EXACT and (unfit(np.array([value]), wanted.highest).any() or not _written(cell, value)):
        return f"is {short(cell, 40)}{why(value, wanted.full_scale)}"
    return ""


def capture_starts(labels: pd.DataFrame, frame: np.ndarray, origin: int, label: str, unit: str = "line") -> np.ndarray:
    """Rows at which captures begin: where the frame number is ``origin``; elsewhere it must go up by one.

    Args:
        labels: columns that stay the same within a capture.
        frame: frame number of each row.
        origin: frame number of the first frame of a capture.
        label: what messages call the file.
        unit: what they call a row: ``line`` where the header is line 1, else ``row``.

    Raises:
        InputError: a capture that starts at another frame, a duplicate or a missing frame.
    """
    changed = np.zeros(len(frame), dtype=bool)
    changed[0] = True
    for name in labels:
        codes = pd.factorize(labels[name])[0]
        changed[1:] |= codes[1:] != codes[:-1]
    starts = frame == origin
    step = np.diff(frame, prepend=origin - 1)
    wrong = np.flatnonzero(~starts & (changed | (step != 1)))
    if len(wrong):
        row = wrong[0]
        where, now = f"{label}, {unit} {row + (2 if unit == 'line' else 1)}", frame[row]
        if changed[row]:
            raise InputError(f"{where}: a capture starts at frame {now} instead of {origin}; restore its first frames")
        if step[row] == 0:
            raise InputError(f"{where}: frame {now} stands twice; delete one of the two lines")
        raise InputError(f"{where}: frame {now} follows frame {frame[row - 1]}; restore the frames or renumber them")
    return np.flatnonzero(starts)
