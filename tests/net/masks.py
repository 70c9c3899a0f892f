"""Texts, tables, pages and objects as golden lines: without what depends on time, place, memory, identity and machine.

Floats of data are rounded to nine digits, as other processors add in another order; `tests.net.stores` compares all.
"""

from __future__ import annotations

import csv
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd

MASKED = re.compile(  # headings of columns of times, memory, identity and versions, in all formats
    "((predict|decision|decide|replay|reference|window_decision|(touch \\+ )?computing)(_wall)?[ _]ms|fit s)"
    "([ _].*)?|slowdown|quiet_ms|(.*_)?seconds|fit s"
    "|decisions[ _]per[ _]s(econd)?|predict_relative|predict|peak_rss_bytes|started|artifacts"
    "|touchbench[.]cell|run|run_id|git|cpu|simd|CPU, threads|threads|version[.].*"
    "|numpy|optuna|pandas|python|scikit-learn|scipy|torch|touchbench|xgboost(-cpu)?"
)
LATEX = re.compile(f"{MASKED.pattern}|ms")
LINKED = re.compile(  # sizes and instructions, which depend on the compiler
    rf"{MASKED.pattern}|flash( kB)?|(library |program )?RAM kB|ram|stack B|instructions a frame|in a touch"
    "|at most|cycles"
)
SAME = {  # what depends on time, place, memory and identity
    r"file://\S*?/(?=\w+/index)": "file://~/",
    r"/[^\s'\"]*/(?=mine\.py)": "~/",
    r"(m-|(?<![0-9a-f]))[0-9a-f]{32}(?![0-9a-f])": "#",
    r"; \d+\.\d s$": "; # s",
    r"in \d+\.\d\d s": "in # s",
    r"saved \(\d+ kB\)": "saved (# kB)",
    r"time x\d+\.\d+": "time x#",
    r"[━─]+[┳╇┷┴┓┩┘━─]*": "─",
    r" {2,}(?=[│┃])|(?<=[│┃]) {2,}": " ",
}
ROWS = 12  # of a table of the API
BLOCKS = {"p", "h1", "h2", "h3", "li", "tr", "div", "figcaption", "summary", "caption", "title", "noscript", "table"}


def lines_of(text: str, folders: tuple[Path, ...] = (), masked: re.Pattern = MASKED) -> str:
    """What a command prints, a Markdown or a LaTeX file; tables without their padding."""
    for folder in folders:
        text = text.replace(str(folder), "~")
    hidden: list[int] = []
    lines, before = [], ""
    for line in text.splitlines():
        edge = next((e for e in ("┃", "│", "|") if line.startswith(e)), "&" if " & " in line else "")
        if edge:
            cells = re.split(r"(?<!\\)" + re.escape(edge), line)
            if edge == "┃" or (edge == "|" != before) or before == r"\toprule":
                headings = LATEX if edge == "&" else masked
                hidden = [i for i, cell in enumerate(cells) if headings.fullmatch(_plain(cell))]
            elif not set(line) <= set("| -:"):
                end = r" \\" * line.endswith(r"\\")
                cells = [" # " if i in hidden and cell.strip() else cell for i, cell in enumerate(cells)]
                cells[-1] = cells[-1].removesuffix(end) + end
            line = edge.join(cells)
        before = edge or line
        for pattern, word in SAME.items():
            line = re.sub(pattern, word, line)
        lines.append(line.rstrip())
    return "\n".join(lines) + "\n"


def chip_of(text: str, folders: tuple[Path, ...] = ()) -> str:
    """The same of commands that print sizes and instructions of linked C."""
    return re.sub(r"\d[\d.,]*(?= k?B\b| k?cycles| (k )?instructions)", "#", lines_of(text, folders, LINKED))


def _plain(cell: str) -> str:
    return re.sub(r"[\\`*]", "", cell).strip()


def csv_of(text: str, folders: tuple[Path, ...] = ()) -> str:
    """A CSV file, its floats to nine digits."""
    for folder in folders:
        text = text.replace(str(folder), "~")
    head, *rows = csv.reader(io.StringIO(text))
    hidden = [bool(MASKED.fullmatch(name)) for name in head]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([["#" if h and c else _nine(c) for h, c in zip(hidden, row, strict=True)] for row in rows])
    return "".join(_same(line) for line in out.getvalue().splitlines(keepends=True))


def _same(line: str) -> str:
    for pattern, word in SAME.items():
        line = re.sub(pattern, word, line)
    return line


def _nine(cell: str) -> str:
    return f"{float(cell):.9g}" if re.fullmatch(r"-?\d+\.\d+(e-?\d+)?", cell) else cell


def table_of(table: pd.DataFrame, folders: tuple[Path, ...] = ()) -> str:
    """A table as its columns with their types, its number of rows, and the first of them."""
    types = ", ".join(f"{name}: {kind}" for name, kind in table.dtypes.items())
    return f"{len(table)} rows; {types}\n{csv_of(table[:ROWS].to_csv(index=False), folders)}"


class _Page(HTMLParser):
    """Visible text by line, tables as rows of cells."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.lines: list[str] = []
        self.text, self.hidden, self.cells = "", "", []
        self.depth = 0  # drawings within a drawing

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if self.hidden:
            self.depth += tag == self.hidden
            return
        if tag in ("script", "style", "svg"):
            self.hidden = tag
            if tag == "svg" and given.get("aria-label"):
                self.lines.append(f"(figure: {given['aria-label']})")
        elif tag in BLOCKS:
            self._end()
        elif tag == "img":
            self._end()
            self.lines.append(f"(figure: {given.get('alt', '')})")
        elif tag in ("td", "th"):
            self.text = self.text.strip()
            self.cells.append("")
        if tag == "tr":
            self.cells = []

    def handle_endtag(self, tag: str) -> None:
        if tag == self.hidden and self.depth:
            self.depth -= 1
        elif tag == self.hidden:
            self.hidden = ""
        elif tag in ("td", "th") and self.cells:
            self.cells[-1], self.text = " ".join(self.text.split()), ""
        elif tag == "tr" and self.cells:
            self.lines.append(f"| {' | '.join(c.replace('|', chr(92) + '|') for c in self.cells)} |")
            self.cells, self.text = [], ""
        elif tag == "table":
            self.lines.append("")
        elif tag in BLOCKS:
            self._end()

    def handle_data(self, data: str) -> None:
        if not self.hidden:
            self.text += data

    def _end(self) -> None:
        if text := " ".join(self.text.split()):
            self.lines.append(text)
        self.text = ""


def page_of(html: str, folders: tuple[Path, ...] = ()) -> str:
    """The text of a page by line, tables as in Markdown."""
    page = _Page()
    page.feed(html)
    page._end()
    return lines_of("\n".join(page.lines), folders)
