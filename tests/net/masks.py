"""Texts, tables, pages and objects as golden lines: without what depends on time, place, memory, identity and machine.

Floats of data are rounded to nine digits, as other processors add in another order; `tests.net.stores` compares all.
"""

from __future__ import annotations

import base64
import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd

MASKED = re.compile(  # headings of columns of times, memory, identity and versions, in all formats
    "((predict|decision|decide|replay|reference|window_decision|(touch \\+ )?computing|system hop)(_wall)?[ _]ms|fit s)"
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
    return _without_budgets_of_time("\n".join(lines) + "\n")


def _without_budgets_of_time(text: str) -> str:
    """The same without the choices for budgets of computing time, which depend on the machine."""
    text = re.sub(r"(?m)^\| computing time \| from .*\n", "", text)
    return re.sub(r"(?m)^(\| computing time \|\n)(\| from .*\n)+", r"\1", text)


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
    """Visible text by line, tables as rows of cells, data of scripts."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.lines: list[str] = []
        self.text, self.hidden, self.data, self.cells = "", "", None, []
        self.depth = 0  # drawings within a drawing

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if self.hidden:
            self.depth += tag == self.hidden
            return
        if tag == "script" and given.get("type") == "application/json":
            self.data = ""
        elif tag in ("script", "style", "svg"):
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
        elif tag == "script" and self.data is not None:
            self.lines += data_lines(self.data)
            self.data = None
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
        if self.data is not None:
            self.data += data
        elif not self.hidden:
            self.text += data

    def _end(self) -> None:
        if text := " ".join(self.text.split()):
            self.lines.append(text)
        self.text = ""


def page_of(html: str, folders: tuple[Path, ...] = ()) -> str:
    """The text of a page by line, tables as in Markdown, data of its scripts."""
    page = _Page()
    page.feed(html)
    page._end()
    return lines_of("\n".join(page.lines), folders)


def data_lines(text: str) -> list[str]:
    """Data of a script in lines; costs of time masked, numbers in base64 as their count and weighted sum."""
    data = json.loads(text)
    costs = [c.get("key", "") if isinstance(c, dict) else c for c in data.get("costs", [])]
    timed = {i for i, name in enumerate(costs) if name == "predict" or name.startswith("ms to compute")}
    return [f"data {line}" for line in _walk("", _masked(data, timed))]


def _masked(data: object, timed: set[int]) -> object:
    if isinstance(data, dict):
        own = {k for k in ("x", "costs") if isinstance(data.get(k), list) and len(data[k]) > max(timed, default=0)}
        out = {k: _masked(v, timed) for k, v in data.items()}
        for k in own:
            if not any(isinstance(v, dict | str) for v in data[k]):
                out[k] = ["#" if i in timed and v is not None else v for i, v in enumerate(out[k])]
        return out
    if isinstance(data, list):
        return [_masked(v, timed) for v in data]
    if isinstance(data, float):
        return float(f"{data:.6g}")
    if isinstance(data, str) and len(data) > 80 and re.fullmatch("[A-Za-z0-9+/=]+", data):
        numbers = np.frombuffer(base64.b64decode(data)[: len(data) * 3 // 4 // 4 * 4], "<f4").astype(float)
        return f"{len(numbers)} numbers, {np.nansum(numbers * np.arange(len(numbers))):.6g}"
    return data


def _walk(name: str, data: object) -> list[str]:
    """A line for each dictionary without dictionaries inside, and for each other value."""
    text = json.dumps(data, ensure_ascii=False)
    if isinstance(data, dict) and len(text) > 300:
        return [line for k, v in data.items() for line in _walk(f"{name}.{k}".lstrip("."), v)]
    if isinstance(data, list) and len(text) > 300 and any(isinstance(v, dict) for v in data):
        return [line for i, v in enumerate(data) for line in _walk(f"{name}[{i}]", v)]
    return [f"{name}: {text}"]
