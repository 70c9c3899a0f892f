"""A table: its columns are measures, its rows are results or other values; one path writes it to every output."""

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

WORDS = 34  # columns of a terminal for text, before it takes more lines rather than the place of another column
HELD = "\N{NO-BREAK SPACE}"  # within a value, so that a line ends between two of them
PAGE = 9  # columns of a table on the page
FORMULA = (
    "=",
    "+",
    "-",
    "@",
    "\t",
    "\r",
)  # begins a formula in a spreadsheet, at the start of a cell


@dataclass(frozen=True)
class Table:
    """Rows of values with the measures that are their columns."""

    columns: Sequence[
        Measure
    ]  # measures; a column with ``spare`` that has no value in any row is not shown
    rows: Sequence[Row]  # values by name
    title: str = ""  # heading
    bold: Collection[int] = ()  # numbers of highlighted rows
    remarks: list[list[str]] = field(
        default_factory=list
    )  # footnotes of each row; equal remarks share a number
    groups: list[str] = field(
        default_factory=list
    )  # heading of each row, shared with its neighbours

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def texts(self) -> list[dict[str, str]]:
        """The cells of each row by heading."""
        every = [
            {measure.name: measure.as_text(row) for measure in self.columns} for row in self.rows
        ]
        empty = [
            m.name
            for m in self.columns
            if m.spare and all(row[m.name] in (UNKNOWN, "") for row in every)
        ]
        return [{name: cell for name, cell in row.items() if name not in empty} for row in every]

    @cached_property
    def headings(self) -> list[str]:
        """Headings of the shown columns."""
        return [*self.texts[0]] if self.texts else [measure.name for measure in self.columns]

    @cached_property
    def heading_blocks(self) -> list[list[str]]:
        """The headings in blocks of at most `PAGE`, about equally many each; every block begins with the first one."""
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
        """The footnotes, numbered from 1."""
        return list(dict.fromkeys(note for row in self.remarks for note in row))

    @cached_property
    def template_rows(self) -> list[dict[str, Any]]:
        """Each row for templates: its cells by heading, its group, the numbers of its footnotes."""
        remarks, groups = self.remarks or [[]] * len(self), self.groups or [""] * len(self)
        rows = zip(self.texts, groups, remarks, strict=True)
        marks = {note: i for i, note in enumerate(self.footnotes, 1)}
        return [
            {"cells": cells, "group": g, "marks": [marks[note] for note in notes]}
            for cells, g, notes in rows
        ]

    def fit_columns(self, width: int) -> tuple[dict[str, int], list[str], str]:
        """Widths of the columns side by side, headings of those under each row, and a line on columns left out.

        Columns with ``spare`` are left out first. Then numbers go under the row, from the right; then text.
        """
        from rich.cells import cell_len

        full = {
            n: max(cell_len(cell) for cell in (n, *(row[n] for row in self.texts)))
            for n in self.headings
        }
        shown = [m for m in self.columns if m.name in full]
        wide = {m.name: min(full[m.name], WORDS) if m.is_text else full[m.name] for m in shown}
        spare = sorted((m for m in shown[1:] if m.spare), key=lambda m: -m.spare)
        fixed = sorted((m for m in shown[:0:-1] if not m.spare), key=lambda m: m.is_text)
        needed, left_out, under = -_free_columns(wide, 0), list[str](), list[str]()
        for measure in (*spare, *fixed):
            if _free_columns(wide, width) >= 0:
                break
            (left_out if measure.spare else under).append(measure.name)
            del wide[measure.name]
        for name in wide:  # text takes the room that is left; a first column alone may be too wide
            wide[name] = max(1, min(full[name], wide[name] + _free_columns(wide, width)))
        line = (
            f"columns left out: {', '.join(left_out)}; a terminal of {needed} columns shows them"
            if left_out
            else ""
        )
        return wide, [name for name in full if name in under], line

    def print(self, out: Console) -> None:
        """Print it so that it fits: columns without room follow in lines under each row, spare ones are named below."""
        from rich.box import HEAVY_HEAD
        from rich.cells import set_cell_size
        from rich.text import Text

        wide, under, left_out = self.fit_columns(out.width)
        right = {m.name for m in self.columns if not m.is_text}
        box, inner, widths = (
            HEAVY_HEAD.substitute(out.options),
            -_free_columns(wide, 0) - 4,
            [w + 2 for w in wide.values()],
        )

        def row(
            cells: Mapping[str, str], style: str, left: str, between: str, end: str
        ) -> Iterator[Text]:
            folded = [
                _wrap_cell(out, cells[name], width, name in right) for name, width in wide.items()
            ]
            for parts in itertools.zip_longest(*folded):
                shown = [
                    Text(part or " " * width, style)
                    for part, width in zip(parts, wide.values(), strict=True)
                ]
                yield Text.assemble(f"{left} ", Text(f" {between} ").join(shown), f" {end}")

        lines = [Text(box.get_top(widths))]
        lines += row(
            {name: name for name in wide}, "bold", box.head_left, box.head_vertical, box.head_right
        )
        lines.append(Text(box.get_row(widths, "head")))
        for i, cells in enumerate(self.texts):
            style = "bold" if i in self.bold else ""
            lines += row(cells, style, box.mid_left, box.mid_vertical, box.mid_right)
            rest = ", ".join(
                f"{n} {cells[n]}".replace(" ", HELD) for n in under if cells[n] not in (UNKNOWN, "")
            )
            for line in textwrap.wrap(rest, inner, initial_indent="  ", subsequent_indent="  "):
                kept = set_cell_size(line.replace(HELD, " "), inner)
                lines.append(Text(f"{box.mid_left} {kept} {box.mid_right}"))
        out.print(self.title, style="bold", markup=False, highlight=False)
        out.print(Text("\n").join([*lines, Text(box.get_bottom(widths))]), soft_wrap=True)
        if left_out:
            out.print(left_out, style="dim", markup=False, highlight=False)

    def to_frame(self) -> pd.DataFrame:
        """The numbers by key; an interval takes three columns, ``<key>``, ``<key>_low`` and ``<key>_high``."""
        import pandas as pd

        rows = []
        for row in self.rows:
            values: dict[str, Any] = {}
            for measure in self.columns:
                cell, key = measure.value_of_row(row), measure.key
                if isinstance(cell, Interval):
                    values |= dict(zip((key, f"{key}_low", f"{key}_high"), cell, strict=True))
                elif isinstance(cell, tuple) and isinstance(measure.source, tuple):
                    values |= dict(zip(measure.source, cell, strict=True))
                else:
                    values[key] = cell
            rows.append(values)
        return pd.DataFrame(rows, columns=None if rows else [m.key for m in self.columns])

    def to_text_frame(self) -> pd.DataFrame:
        """The cells as text."""
        import pandas as pd

        return pd.DataFrame(self.texts, columns=self.headings)


def _free_columns(widths: Mapping[str, int], width: int) -> int:
    """Columns of a terminal that a table with such columns leaves free; negative where it does not fit."""
    return width - 1 - sum(wide + 3 for wide in widths.values())


def _wrap_cell(out: Console, text: str, width: int, right: bool) -> list[str]:
    """The lines of a cell, of its width."""
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
    """A table of text as it is."""
    return Table(
        [Measure(str(name), form=CODE if name in code else TEXT) for name in frame],
        rows_of_frame(frame),
    )


def write_sheet(table: pd.DataFrame, path: Path, float_format: str | None = None) -> None:
    """Write a table for people, not for programs: an apostrophe leads a text that would start a formula."""
    from pandas.api.types import is_numeric_dtype

    harmless = table.apply(
        lambda column: column if is_numeric_dtype(column) else column.map(_escape_formula)
    )
    harmless.rename(columns=_escape_formula).to_csv(path, index=False, float_format=float_format)


def _escape_formula(value: object) -> object:
    """The same, unless a text calculates something, as a number typed as text and a dash for nothing do not."""
    if not isinstance(value, str) or not value.startswith(FORMULA) or value == UNKNOWN:
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def rows_of_frame(table: pd.DataFrame) -> list[Row]:
    """The rows of a DataFrame."""
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]
