"""Long CSV files of touch frames: read fast when they are good, explained to the line when they are not."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv

from bench.corpora.cells import Wanted, cells_of, explain, is_written
from bench.corpora.labels import Words
from bench.corpora.limits import check_conditions, check_names, flaw, quoted
from bench.corpora.lines import Lines, blocks, parts_of
from bench.corpora.values import smallest, unfit
from bench.errors import InputError

DOUBLE = 1 << 53  # float64 holds every whole number up to here


@dataclass
class _Block:
    """What was read of some lines: sensor values [rows, channels], and by name whole numbers or words and codes."""

    values: np.ndarray
    labels: dict[str, np.ndarray | tuple[list[str], np.ndarray]]


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
        self.source = partial(parts_of, source, label) if isinstance(source, Path) else source
        self.label = label
        lines = next(blocks(self.source(), label), None)
        if lines is None:
            raise InputError(f"{label}: the file is empty; give a file with a header line and one line per frame")
        try:
            header = lines.content.partition(b"\n")[0].decode("utf-8-sig")
        except UnicodeDecodeError as e:
            raise InputError(f"{label}: not a text file in UTF-8; give the CSV file itself") from e
        if not header.strip():
            raise InputError(f"{label}, line 1: blank; begin the file with its header")
        cells = cells_of(header, header=True)
        if cells[-1].endswith("\n"):
            raise InputError(f"{label}, line 1: the quote of the last cell is not closed; a cell holds no line break")
        self.columns = [name.strip().strip('"').strip() for name in cells]
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
        wanted = Wanted(whole, channels, full_scale, fractions)
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

    def _rows(self) -> Iterator[Lines]:
        """All lines but the header."""
        for lines in blocks(self.source(), self.label):
            if lines.first == 1:
                _, _, rest = lines.content.partition(b"\n")
                lines = Lines(2, lines.count - 1, rest)
            if lines.content:
                yield lines

    def _reader(self, wanted: Wanted) -> Callable[[Lines], _Block]:
        """What reads a block, or says what is wrong with it."""
        text = pa.dictionary(pa.int32(), pa.string())
        types = dict.fromkeys(self.columns, text) | dict.fromkeys(wanted.whole, pa.int64())
        plain = types | dict.fromkeys(wanted.channels, pa.uint16())
        forms = [plain, types | dict.fromkeys(wanted.channels, pa.float64())] if wanted.fractions else [plain]

        def read(lines: Lines) -> _Block:
            for types in list(forms):
                try:
                    found = self._parsed(lines, types, wanted)
                except _Unfit:
                    continue
                if types is forms[-1]:
                    del forms[:-1]  # one decimal seldom comes alone
                return found
            explain(lines, self.columns, wanted, self.label)

        return read

    def _parsed(self, lines: Lines, types: dict[str, pa.DataType], wanted: Wanted) -> _Block:
        table = self._parse(lines.content, types)
        if len(table) != lines.count or any(column.null_count for column in table.itercolumns()):
            raise _Unfit  # a blank line, a line break within quotes, or an empty cell
        if (b"x" in lines.content or b"X" in lines.content) and re.search(rb"0[xX]", lines.content):
            self._refuse_hexadecimal(lines.content, types, wanted)
        columns = dict(zip(self.columns, table.itercolumns(), strict=True))
        whole_values = types[wanted.channels[0]] == pa.uint16()
        values = np.empty((len(table), len(wanted.channels)), np.uint16 if whole_values else np.float64)
        for i, name in enumerate(wanted.channels):
            values[:, i] = columns.pop(name).to_numpy()
        if values.max() > wanted.highest if whole_values else unfit(values, wanted.highest).any():
            raise _Unfit
        if values.max() >= DOUBLE:
            self._refuse_rounded(lines.content, values, wanted)
        whole = set(wanted.whole)
        labels = {n: column.to_numpy() if n in whole else _words(column) for n, column in columns.items()}
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

    def _refuse_hexadecimal(self, content: bytes, types: dict[str, pa.DataType], wanted: Wanted) -> None:
        """Find numbers such as 0x10, which pyarrow reads as 16, among labels that may be called so."""
        numbers = {*wanted.channels, *wanted.whole}
        table = self._parse(content, types | dict.fromkeys(numbers, pa.string()))
        for name, column in zip(self.columns, table.itercolumns(), strict=True):
            if name in numbers and pc.any(pc.match_substring_regex(column, "[xX]")).as_py():
                raise _Unfit

    def _refuse_rounded(self, content: bytes, values: np.ndarray, wanted: Wanted) -> None:
        """Find numbers so large that float64 is not what is written."""
        text = content.split(b"\n")
        place = {name: i for i, name in enumerate(self.columns)}
        for row in np.flatnonzero((values >= DOUBLE).any(axis=1)):
            cells = cells_of(text[row].decode())
            for name, value in zip(wanted.channels, values[row], strict=True):
                if value >= DOUBLE and not is_written(cells[place[name]], value):
                    raise _Unfit


def _words(column: pa.ChunkedArray) -> tuple[list[str], np.ndarray]:
    """The words of a column without spaces around them, and the code of each row."""
    coded = column.combine_chunks()
    words = [word.strip() for word in coded.dictionary.to_pylist()]
    if any(map(flaw, words)):
        raise _Unfit
    return words, coded.indices.to_numpy()


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
