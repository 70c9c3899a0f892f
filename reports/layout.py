"""The report as a list of blocks, and the two ways to write them: markdown, and one HTML page that loads nothing."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Collection
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path

import pandas as pd

from reports.figures import Picture

POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


@dataclass(frozen=True)
class Heading:
    """A title; ``level`` 1 is the page's."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Text:
    """A paragraph; a ``warning`` stands out."""

    text: str
    warning: bool = False


@dataclass(frozen=True)
class Table:
    """A table of text with a caption.

    Attributes:
        frame: text by column.
        caption: what it shows; one of generated captures says so.
        marks: for each row, the numbers of its footnotes.
        notes: the footnotes, from 1.
        code: columns that hold commands.
    """

    frame: pd.DataFrame
    caption: str
    marks: list[list[int]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    code: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chart:
    """The interactive chart of `reports.speed.chart_data`."""

    data: dict[str, object]


@dataclass(frozen=True)
class Animation:
    """A GIF with a caption."""

    path: Path
    caption: str


Block = Heading | Text | Table | Picture | Chart | Animation


def footnotes(texts: list[list[str]]) -> tuple[list[list[int]], list[str]]:
    """Number the remarks on each row of a table; equal ones share a number."""
    notes = list(dict.fromkeys(t for row in texts for t in row))
    return [[notes.index(t) + 1 for t in row] for row in texts], notes


def markdown(blocks: list[Block], folder: Path) -> str:
    """The blocks as markdown; figures are linked relative to ``folder``, the interactive chart is left out."""
    return "\n\n".join(_markdown(b, folder) for b in blocks if not isinstance(b, Chart)) + "\n"


def _markdown(block: Block, folder: Path) -> str:
    match block:
        case Heading():
            return "#" * block.level + " " + md_escape(block.text)
        case Text():
            return ("> **Warning:** " if block.warning else "") + md_escape(block.text)
        case Picture() | Animation():
            path = block.path if isinstance(block, Animation) else block.paths[0]
            return f"![{md_escape(block.caption)}]({path.relative_to(folder).as_posix()})"
    lines = [md_escape(block.caption), "", md_table(_with_marks(block), block.code)]
    if block.notes:
        lines += ["", *(f"{i}. {md_escape(note)}" for i, note in enumerate(block.notes, 1))]
    return "\n".join(lines)


def md_table(frame: pd.DataFrame, code: Collection[str] = ()) -> str:
    """A table in markdown; ``code`` are columns that hold commands."""
    rows = [frame.columns.tolist(), ["---"] * len(frame.columns)]
    rows += [
        [_code(c) if k in code else md_escape(c) for k, c in zip(frame, row, strict=True)]
        for row in frame.values.tolist()
    ]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def md_escape(text: str) -> str:
    """Text that markdown takes as it is; a bar would end a cell, a line break the table."""
    return re.sub(r"([\\`*_{}\[\]<>|#~])", r"\\\1", " ".join(str(text).split()))


def _code(text: str) -> str:
    """A command that may hold bars and backticks, as code."""
    text = text.replace("|", r"\|")
    return f"`` {text} ``" if "`" in text else f"`{text}`"


def _with_marks(block: Table) -> pd.DataFrame:
    if not any(block.marks):
        return block.frame
    return block.frame.assign(notes=[", ".join(map(str, m)) for m in block.marks])


def page(blocks: list[Block], title: str) -> str:
    """The blocks as one HTML page: styles, script and figures are in it, nothing is loaded from anywhere."""
    room = files("reports")
    headings = [b for b in blocks if isinstance(b, Heading) and b.level == 2]
    links = "".join(f'<li><a href="#{anchor(h.text)}">{escape(h.text)}</a></li>' for h in headings)
    body = "\n".join(_html(b, i) for i, b in enumerate(blocks))
    first, _, rest = body.partition("</h1>")
    return (
        "<!doctype html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f"<style>\n{room.joinpath('page.css').read_text(encoding='utf-8')}</style></head><body>\n"
        f"{first}</h1><nav><ul>{links}</ul></nav>{rest}\n"
        f"<script>\n{room.joinpath('chart.js').read_text(encoding='utf-8')}</script>\n</body></html>\n"
    )


def anchor(text: str) -> str:
    """A heading's id."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def _html(block: Block, number: int) -> str:
    match block:
        case Heading():
            name = f' id="{anchor(block.text)}"' if block.level == 2 else ""
            return f"<h{block.level}{name}>{escape(block.text)}</h{block.level}>"
        case Text():
            return f'<p class="warning">{escape(block.text)}</p>' if block.warning else f"<p>{escape(block.text)}</p>"
        case Picture():
            drawing = inline_svg(block.paths[1].read_text(encoding="utf-8"), f"f{number}-", block.caption)
            return _figure(drawing, block.caption)
        case Animation():
            content = base64.b64encode(block.path.read_bytes()).decode()
            drawing = f'<img src="data:image/gif;base64,{content}" alt="{escape(block.caption)}">'
            return _figure(drawing, block.caption)
        case Chart():
            data = json.dumps(block.data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
            return (
                f'<script type="application/json" id="chart-data">{data}</script>\n'
                '<div id="chart" class="chart"><noscript>This chart needs JavaScript; the figures of each group show '
                "the same.</noscript></div>"
            )
    return _table(block, number)


def _figure(drawing: str, caption: str) -> str:
    return f'<figure><div class="scroll paper">{drawing}</div><figcaption>{escape(caption)}</figcaption></figure>'


def inline_svg(text: str, prefix: str, caption: str) -> str:
    """A drawing of matplotlib to stand among others in one page: without prologue and metadata, names of its own."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r">\s+<", "><", text)
    text = re.sub(r'((?<![\w-])id="|url\(#|href="#)', rf"\g<1>{prefix}", text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', 1).strip()


def _table(block: Table, number: int) -> str:
    names = [*block.frame.columns] + (["notes"] if any(block.marks) else [])
    head = "".join(f'<th scope="col">{escape(str(n))}</th>' for n in names)
    rows = []
    for position, row in enumerate(block.frame.values.tolist()):
        cells = [
            f"<td><code>{escape(str(c))}</code></td>" if k in block.code else f"<td>{escape(str(c))}</td>"
            for k, c in zip(block.frame, row, strict=True)
        ]
        if any(block.marks):
            cells.append(
                "<td>" + ", ".join(f'<a href="#t{number}-{m}">{m}</a>' for m in block.marks[position]) + "</td>"
            )
        rows.append("<tr>" + "".join(cells) + "</tr>")
    notes = "".join(f'<li id="t{number}-{i}">{escape(n)}</li>' for i, n in enumerate(block.notes, 1))
    return (
        f'<div class="scroll" tabindex="0"><table><caption>{escape(block.caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead><tbody>\n"
        + "\n".join(rows)
        + "\n</tbody></table></div>"
        + (f'<ol class="notes">{notes}</ol>' if notes else "")
    )
