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
        groups: for each row, what it shares with its neighbours, which stands above them.
        away: for each row, whether the page shows it only when asked to.
        switch: the words to ask with.
    """

    frame: pd.DataFrame
    caption: str
    marks: list[list[int]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    code: tuple[str, ...] = ()
    groups: list[str] = field(default_factory=list)
    away: list[bool] = field(default_factory=list)
    switch: str = ""


@dataclass(frozen=True)
class Answer:
    """What a reader came for: a sentence, its reasons, and the command that gives the same."""

    title: str
    lines: list[str]
    command: str = ""


@dataclass(frozen=True)
class Briefs:
    """Findings in a sentence each, by the heading under which there is more."""

    sentences: list[tuple[str, str]]


@dataclass(frozen=True)
class Chart:
    """The interactive chart of `reports.candidates.chart_data`; where there is no script, pictures stand for it."""

    data: dict[str, object]
    pictures: list[Picture] = field(default_factory=list)


@dataclass(frozen=True)
class Animation:
    """A GIF with a caption."""

    path: Path
    caption: str


Block = Heading | Text | Answer | Briefs | Table | Picture | Chart | Animation


def footnotes(texts: list[list[str]]) -> tuple[list[list[int]], list[str]]:
    """Number the remarks on each row of a table; equal ones share a number."""
    notes = list(dict.fromkeys(t for row in texts for t in row))
    return [[notes.index(t) + 1 for t in row] for row in texts], notes


def markdown(blocks: list[Block], folder: Path) -> str:
    """The blocks as markdown; figures are linked relative to ``folder``, pictures stand for the interactive chart."""
    return "\n\n".join(filter(None, (_markdown(b, folder) for b in blocks))) + "\n"


def _markdown(block: Block, folder: Path) -> str:
    match block:
        case Heading():
            return "#" * block.level + " " + md_escape(block.text)
        case Text():
            return ("> **Warning:** " if block.warning else "") + md_escape(block.text)
        case Picture() | Animation():
            path = block.path if isinstance(block, Animation) else block.paths[0]
            return f"![{md_escape(block.caption)}]({path.relative_to(folder).as_posix()})"
        case Chart():
            return "\n\n".join(_markdown(picture, folder) for picture in block.pictures)
        case Answer():
            said = [f"**{md_escape(block.title)}**", *map(md_escape, block.lines)]
            return "\n\n".join(said + ([_code(block.command)] if block.command else []))
        case Briefs():
            return "\n".join(f"- **{md_escape(topic)}.** {md_escape(text)}" for topic, text in block.sentences)
    lines = [md_escape(block.caption), "", md_table(_with_marks(block), block.code)]
    if block.notes:
        lines += ["", *(f"{i}. {md_escape(note)}" for i, note in enumerate(block.notes, 1))]
    return "\n".join(lines)


def md_table(frame: pd.DataFrame, code: Collection[str] = ()) -> str:
    """A table in markdown; ``code`` are columns that hold commands."""
    rows = [[md_escape(name) for name in frame], ["---"] * len(frame.columns)]
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
    """The table as plain rows: what groups them is a column, so are the numbers of footnotes."""
    frame = block.frame.assign(notes=[", ".join(map(str, m)) for m in block.marks]) if any(block.marks) else block.frame
    if not block.groups:
        return frame
    return pd.concat([pd.Series(block.groups, frame.index, name="on"), frame], axis=1)


def page(blocks: list[Block], title: str) -> str:
    """The blocks as one HTML page: styles, script and figures are in it, nothing is loaded from anywhere.

    Its contents stand behind the first section, so that nothing comes before what a reader came for.
    """
    room = files("reports")
    named = [b for b in blocks if isinstance(b, Heading) and b.level == 2]
    links = "".join(f'<li><a href="#{anchor(h.text)}">{escape(h.text)}</a></li>' for h in named)
    body = [_html(b, i, named) for i, b in enumerate(blocks)]
    if len(named) > 2:
        body.insert(blocks.index(named[1]), f'<nav aria-label="Contents"><ul>{links}</ul></nav>')
    text = "\n".join(body)
    return (
        "<!doctype html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f"<style>\n{room.joinpath('page.css').read_text(encoding='utf-8')}</style></head><body><main>\n"
        f"{text}\n</main>\n"
        f"<script>\n{room.joinpath('chart.js').read_text(encoding='utf-8')}</script>\n</body></html>\n"
    )


def anchor(text: str) -> str:
    """A heading's id."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def _html(block: Block, number: int, named: list[Heading]) -> str:
    match block:
        case Heading():
            name = f' id="{anchor(block.text)}"' if block.level == 2 else ""
            return f"<h{block.level}{name}>{escape(block.text)}</h{block.level}>"
        case Text():
            return f'<p class="warning">{escape(block.text)}</p>' if block.warning else f"<p>{escape(block.text)}</p>"
        case Answer():
            first, *rest = block.lines
            told = "".join(f"<p>{escape(line)}</p>" for line in rest)
            again = f"<p>The same in a terminal: <code>{escape(block.command)}</code></p>" if block.command else ""
            return (
                f'<div class="answer"><h3>{escape(block.title)}</h3>'
                f'<p class="first">{escape(first)}</p>{told}{again}</div>'
            )
        case Briefs():
            there = {h.text for h in named}
            items = "".join(
                f"<li><strong>{escape(topic)}.</strong> {escape(text)}"
                + (f' <a href="#{anchor(topic)}">More on {escape(topic.lower())}</a>' if topic in there else "")
                + "</li>"
                for topic, text in block.sentences
            )
            return f'<ul class="briefs">{items}</ul>'
        case Picture():
            drawing = inline_svg(block.paths[1].read_text(encoding="utf-8"), f"f{number}-", block.caption)
            return _figure(drawing, block.caption)
        case Animation():
            content = base64.b64encode(block.path.read_bytes()).decode()
            drawing = f'<img src="data:image/gif;base64,{content}" alt="{escape(block.caption)}">'
            return _figure(drawing, block.caption)
        case Chart():
            data = json.dumps(block.data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
            there = ", ".join(f"figures/{picture.paths[1].name}" for picture in block.pictures)
            return (
                f'<div id="chart" class="chart"><noscript>This chart needs JavaScript; beside this page lie '
                f"{escape(there)}.</noscript></div>\n"
                f'<script type="application/json" id="chart-data">{data}</script>'
            )
    return _table(block, number)


def _figure(drawing: str, caption: str) -> str:
    return (
        f'<figure><div class="scroll paper" tabindex="0">{drawing}</div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def inline_svg(text: str, prefix: str, caption: str) -> str:
    """A drawing of matplotlib to stand among others in one page: without prologue and metadata, names of its own.

    Its width is given in inches, so that the page draws all on one scale and their text in one size.
    """
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r">\s+<", "><", text)
    text = re.sub(r'((?<![\w-])id="|url\(#|href="#)', rf"\g<1>{prefix}", text)
    found = re.match(r'<svg[^>]*? width="([\d.]+)pt"', text)
    width = f' style="--inches: {float(found[1]) / 72:.2f}"' if found else ""
    return text.replace("<svg ", f'<svg role="img" aria-label="{escape(caption)}"{width} ', 1).strip()


def _table(block: Table, number: int) -> str:
    names = [*block.frame.columns] + (["notes"] if any(block.marks) else [])
    away = block.away or [False] * len(block.frame)
    head = "".join(f'<th scope="col">{escape(str(n))}</th>' for n in names)
    parts: list[str] = []
    before = ""
    for position, row in enumerate(block.frame.values.tolist()):
        group = block.groups[position] if block.groups else ""
        if not position or (group, away[position]) != (before, away[position - 1]):
            parts.append(f"</tbody><tbody{_away(away[position])}>")
            if group:
                spans = f'colspan="{len(names)}" scope="rowgroup"'
                parts.append(f'<tr class="group"><th {spans}><span>{escape(group)}</span></th></tr>')
        before = group
        first, *rest = (
            f"<code>{escape(str(c))}</code>" if k in block.code else escape(str(c))
            for k, c in zip(block.frame, row, strict=True)
        )
        if any(block.marks):
            rest.append(", ".join(f'<a href="#t{number}-{m}">{m}</a>' for m in block.marks[position]))
        parts.append(f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{c}</td>" for c in rest) + "</tr>")
    body = "\n".join(parts).removeprefix("</tbody>") + "</tbody>" if parts else ""
    shown = {m for marks, hidden in zip(block.marks, away, strict=False) if not hidden for m in marks}
    notes = "".join(
        f'<li id="t{number}-{i}" value="{i}"{_away(i not in shown)}>{escape(n)}</li>'
        for i, n in enumerate(block.notes, 1)
    )
    table = (
        f'<div class="scroll" tabindex="0" role="group" aria-labelledby="c{number}">'
        f'<table><caption id="c{number}">{escape(block.caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead>{body}</table></div>" + (f'<ol class="notes">{notes}</ol>' if notes else "")
    )
    if not block.switch:
        return table
    switch = f'<input type="checkbox" id="s{number}"><label for="s{number}">{escape(block.switch)}</label>'
    return f'<div class="switched">{switch}\n{table}</div>'


def _away(hidden: bool) -> str:
    return ' class="away"' if hidden else ""
