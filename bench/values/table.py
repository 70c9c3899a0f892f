"""Tables of results or other rows, with measures as columns, for every output."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.values.measures import CODE, TEXT, UNKNOWN, Interval, Measure, Row

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

WORDS = 34  # width of text in a terminal above which it takes more lines
NO_BREAK = "\N{NO-BREAK SPACE}"  # within a value
PAGE = 9  # columns of a table on the page
FORMULA = tuple("=+-@\t\r")  # each begins a formula at the start of a cell of a spreadsheet


@dataclass(frozen=True)
class Table:
    """Rows of values, with measures as columns."""

    columns: Sequence[Measure]  # one with ``spare`` is not shown if it has no value in any row
    rows: Sequence[Row]  # values by name
    title: str = ""
    bold: Collection[int] = ()  # indices of highlighted rows
    remarks: list[list[str]] = field(default_factory=list)  # footnotes of each row
    groups: list[str] = field(default_factory=list)  # heading of each row, shared with neighbours

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def texts(self) -> list[dict[str, str]]:
        """Cells of each row by heading."""
        cells = {m.name: [m.as_text(row) for row in self.rows] for m in self.columns}
        spare = {m.name for m in self.columns if m.spare}
        empty = {name for name in spare if {*cells[name]} <= {UNKNOWN, ""}}
        shown = {name: column for name, column in cells.items() if name not in empty}
        return [{name: shown[name][i] for name in shown} for i in range(len(self))]

    @cached_property
    def headings(self) -> list[str]:
        """Headings of the shown columns."""
        return [*self.texts[0]] if self.texts else [measure.name for measure in self.columns]

    @cached_property
    def heading_blocks(self) -> list[list[str]]:
        """Headings in blocks of similar size, at most `PAGE`; each begins with the first one."""
        first, *rest = self.headings
        number = max(1, -(-len(rest) // (PAGE - 1)))
        size = -(-len(rest) // number)
        return [[first, *rest[size * i : size * (i + 1)]] for i in range(number)]

    @cached_property
    def code_headings(self) -> set[str]:
        """Headings of columns that hold commands."""
        return {measure.name for measure in self.columns if measure.form == CODE}

    @cached_property
    def footnotes(self) -> list[str]:
        """Footnotes in the order of their numbers, which begin at 1."""
        return list(dict.fromkeys(note for row in self.remarks for note in row))

    @cached_property
    def template_rows(self) -> list[dict[str, Any]]:
        """Each row for templates: its cells by heading, its group, the numbers of its footnotes."""
        remarks, groups = self.remarks or [[]] * len(self), self.groups or [""] * len(self)
        numbers = {note: i for i, note in enumerate(self.footnotes, 1)}
        marks = [[numbers[note] for note in notes] for notes in remarks]
        rows = zip(self.texts, groups, marks, strict=True)
        return [dict(zip(("cells", "group", "marks"), row, strict=True)) for row in rows]

    def fit_columns(self, width: int) -> tuple[dict[str, int], list[str], str]:
        """Fit the columns into a terminal, at least the first one.

        Columns with ``spare`` are left out first. Then columns of numbers go under the row, from
        the right; then those of text.

        Returns:
            Width of each column side by side, headings of those under each row, and a sentence on
            columns left out.
        """
        from rich.cells import cell_len

        needed = {}
        for name in self.headings:
            needed[name] = max(map(cell_len, (name, *(row[name] for row in self.texts))))
        shown = [m for m in self.columns if m.name in needed]
        widths = {m.name: needed[m.name] for m in shown}
        widths |= {m.name: min(needed[m.name], WORDS) for m in shown if m.is_text}
        spare = sorted((m for m in shown[1:] if m.spare), key=lambda m: -m.spare)
        fixed = sorted((m for m in shown[:0:-1] if not m.spare), key=lambda m: m.is_text)
        full_width, left_out, under = -_free_width(widths, 0), list[str](), list[str]()
        for measure in (*spare, *fixed):
            if _free_width(widths, width) >= 0:
                break
            (left_out if measure.spare else under).append(measure.name)
            del widths[measure.name]
        for name in widths:  # text takes the rest; a first column alone may be too wide
            widest = widths[name] + _free_width(widths, width)
            widths[name] = max(1, min(needed[name], widest))
        sentence = ""
        if left_out:
            sentence = f"columns left out: {', '.join(left_out)}"
            sentence += f"; a terminal of {full_width} columns shows them"
        return widths, [name for name in needed if name in under], sentence

    def print(self, out: Console) -> None:
        """Print it so that it fits (`fit_columns`)."""
        from rich.box import HEAVY_HEAD
        from rich.cells import set_cell_size
        from rich.text import Text

        widths, under, left_out = self.fit_columns(out.width)
        right = {m.name for m in self.columns if not m.is_text}
        box, inner_width = HEAVY_HEAD.substitute(out.options), -_free_width(widths, 0) - 4

        def row_lines(cells: Mapping[str, str], style: str, *borders: str) -> Iterator[Text]:
            left, between, end = borders
            wrapped = [_wrap_cell(out, cells[n], width, n in right) for n, width in widths.items()]
            for parts in itertools.zip_longest(*wrapped):
                padded = zip(parts, widths.values(), strict=True)
                line = [Text(part or " " * width, style) for part, width in padded]
                yield Text.assemble(f"{left} ", Text(f" {between} ").join(line), f" {end}")

        rules = [width + 2 for width in widths.values()]
        heads = (box.head_left, box.head_vertical, box.head_right)
        lines = [Text(box.get_top(rules)), *row_lines({n: n for n in widths}, "bold", *heads)]
        lines.append(Text(box.get_row(rules, "head")))
        for i, cells in enumerate(self.texts):
            style = "bold" if i in self.bold else ""
            lines += row_lines(cells, style, box.mid_left, box.mid_vertical, box.mid_right)
            known = [f"{n} {cells[n]}" for n in under if cells[n] not in (UNKNOWN, "")]
            text = ", ".join(value.replace(" ", NO_BREAK) for value in known)
            for line in textwrap.wrap(
                text, inner_width, initial_indent="  ", subsequent_indent="  "
            ):
                padded_line = set_cell_size(line.replace(NO_BREAK, " "), inner_width)
                lines.append(Text(f"{box.mid_left} {padded_line} {box.mid_right}"))
        out.print(self.title, style="bold", markup=False, highlight=False)
        out.print(Text("\n").join([*lines, Text(box.get_bottom(rules))]), soft_wrap=True)
        if left_out:
            out.print(left_out, style="dim", markup=False, highlight=False)

    def to_frame(self) -> pd.DataFrame:
        """Values by key; an interval takes ``<key>``, ``<key>_low`` and ``<key>_high``."""
        import pandas as pd

        rows = []
        for row in self.rows:
            values: dict[str, Any] = {}
            for measure in self.columns:
                value, key = measure.value_of_row(row), measure.key
                if isinstance(value, Interval):
                    values |= dict(zip((key, f"{key}_low", f"{key}_high"), value, strict=True))
                elif isinstance(value, tuple) and isinstance(measure.source, tuple):
                    values |= dict(zip(measure.source, value, strict=True))
                else:
                    values[key] = value
            rows.append(values)
        return pd.DataFrame(rows, columns=None if rows else [m.key for m in self.columns])

    def to_text_frame(self) -> pd.DataFrame:
        """Cells as text, by heading."""
        import pandas as pd

        return pd.DataFrame(self.texts, columns=self.headings)


def _free_width(widths: Mapping[str, int], terminal: int) -> int:
    """Width that columns leave free in a terminal; negative if they do not fit."""
    return terminal - 1 - sum(width + 3 for width in widths.values())


def _wrap_cell(out: Console, text: str, width: int, right: bool) -> list[str]:
    """Wrap and pad a cell to lines of its width."""
    from rich.cells import cell_len, set_cell_size
    from rich.text import Text

    lines = [text]
    if cell_len(text) > width or "\n" in text:
        lines = [line.plain.rstrip() for line in Text(text).wrap(out, width, overflow="fold")]
    return [
        " " * (width - cell_len(line)) + line if right else set_cell_size(line, width)
        for line in lines
    ]


def text_table(frame: pd.DataFrame, code: Collection[str] = ()) -> Table:
    """Make a table of the cells of a DataFrame as they are."""
    columns = [Measure(str(name), form=CODE if name in code else TEXT) for name in frame]
    return Table(columns, rows_of_frame(frame))


def write_sheet(table: pd.DataFrame, path: Path, float_format: str | None = None) -> None:
    """Write a CSV file for people: an apostrophe precedes text that would be a formula."""
    from pandas.api.types import is_numeric_dtype

    escaped = table.apply(lambda x: x if is_numeric_dtype(x) else x.map(_escape_formula))
    escaped.rename(columns=_escape_formula).to_csv(path, index=False, float_format=float_format)


def _escape_formula(value: object) -> object:
    """Escape text that would be a formula; a number as text and `UNKNOWN` are none."""
    if not isinstance(value, str) or not value.startswith(FORMULA) or value == UNKNOWN:
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def rows_of_frame(table: pd.DataFrame) -> list[Row]:
    """Rows of a DataFrame, by text names."""
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]
