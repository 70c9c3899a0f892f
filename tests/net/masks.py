"""Texts, tables, pages and objects as golden lines.

What depends on time, place, memory, identity and machine is masked.

Floats of data are rounded to nine digits, as other processors add in another order.
"""

from __future__ import annotations

import csv
import io
import re
from html import unescape
from pathlib import Path

import pandas as pd

MASKED = re.compile(  # headings of columns of times, memory, identity and versions, in all formats
    "((predict|decision|decide|replay|reference|window_decision|(touch \\+ )?computing)"
    "(_wall)?[ _]ms|fit s)"
    "([ _].*)?|slowdown|quiet_ms|(.*_)?seconds|fit s"
    "|decisions[ _]per[ _]s(econd)?|predict_relative|predict"
    "|processor|peak_rss_bytes|started|artifacts"
    "|touchbench[.]cell|run|run_id|git|cpu|simd|CPU, threads|threads|version[.].*"
    "|numpy|optuna|pandas|python|scikit-learn|scipy|torch|touchbench|xgboost(-cpu)?"
)
LATEX = re.compile(f"{MASKED.pattern}|ms")
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
BLOCKS = "p|h1|h2|h3|li|tr|div|figcaption|summary|caption|title|noscript|table"
TAG = r"""[^>"]*(?:"[^"]*"[^>"]*)*>"""  # behind its name; a text in it may have a ">"
LINE = "\x1e"  # between lines of a page


def lines_of(text: str, folders: tuple[Path, ...] = (), masked: re.Pattern = MASKED) -> str:
    """What a command prints, a Markdown or a LaTeX file; tables without their padding."""
    for folder in folders:
        text = text.replace(str(folder), "~")
    hidden: list[int] = []
    lines, before = [], ""
    for line in text.splitlines():
        edge = next(
            (e for e in ("┃", "│", "|") if line.startswith(e)), "&" if " & " in line else ""
        )
        if edge:
            cells = re.split(r"(?<!\\)" + re.escape(edge), line)
            if edge == "┃" or (edge == "|" != before) or before == r"\toprule":
                headings = LATEX if edge == "&" else masked
                hidden = [i for i, cell in enumerate(cells) if headings.fullmatch(_plain(cell))]
            elif not set(line) <= set("| -:"):
                end = r" \\" * line.endswith(r"\\")
                cells = [
                    " # " if i in hidden and cell.strip() else cell for i, cell in enumerate(cells)
                ]
                cells[-1] = cells[-1].removesuffix(end) + end
            line = edge.join(cells)
        before = edge or line
        lines.append(_same(line).rstrip())
    return "\n".join(lines) + "\n"


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
    writer.writerows(
        [["#" if h and c else _nine(c) for h, c in zip(hidden, row, strict=True)] for row in rows]
    )
    return "".join(_same(line) for line in out.getvalue().splitlines(keepends=True))


def _nine(cell: str) -> str:
    return f"{float(cell):.9g}" if re.fullmatch(r"-?\d+\.\d+(e-?\d+)?", cell) else cell


def _same(line: str) -> str:
    for pattern, word in SAME.items():
        line = re.sub(pattern, word, line)
    return line


def table_of(table: pd.DataFrame, folders: tuple[Path, ...] = ()) -> str:
    """A table as its columns with their types, its number of rows, and the first of them."""
    types = ", ".join(f"{name}: {kind}" for name, kind in table.dtypes.items())
    return f"{len(table)} rows; {types}\n{csv_of(table[:ROWS].to_csv(index=False), folders)}"


def page_of(html: str, folders: tuple[Path, ...] = ()) -> str:
    """The visible text of a page by line, tables as Markdown, and descriptions of figures."""
    html = re.sub(r"<(script|style)\b.*?</\1>", "", html, flags=re.S)
    while "<svg" in html:  # the inner ones first
        html = re.sub(r"<svg\b(?:(?!<svg\b).)*?</svg>", _figure, html, flags=re.S)
    html = re.sub(rf"<img\b{TAG}", _figure, html)
    html = re.sub(
        r"<tr\b.*?(?=<tr\b|</?tbody|</table>)", _row, html, flags=re.S
    )  # which need not be closed
    lines = re.sub(
        rf"</?({BLOCKS})\b{TAG}", LINE, html.replace("</table>", f"{LINE}| {LINE}")
    ).split(LINE)
    lines = [line if line.startswith("| ") else _words(line) for line in lines]
    return lines_of("\n".join("" if line == "| " else line for line in lines if line), folders)


def _words(html: str) -> str:
    return " ".join(unescape(re.sub(f"<{TAG}", "", html)).split())


def _figure(found: re.Match) -> str:
    label = re.search('(?:aria-label|alt)="([^"]*)"', re.match(f"<{TAG}", found[0])[0])
    return f"{LINE}(figure: {label[1]}){LINE}" if label else ""


def _row(found: re.Match) -> str:
    cells = [_words(cell).replace("|", r"\|") for cell in re.split(rf"<t[dh]\b{TAG}", found[0])[1:]]
    return f"{LINE}| {' | '.join(cells)} |{LINE}" if cells else LINE
