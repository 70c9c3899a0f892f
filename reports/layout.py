"""The templates beside this file, filled in: as one HTML page that loads nothing, or as markdown.

A template such as ``report.jinja`` says what stands in which order, in macros of ``html.jinja`` or
``markdown.jinja``.
"""

from __future__ import annotations

import hashlib
import itertools
import re
from base64 import b64encode
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, pass_eval_context
from jinja2.nodes import EvalContext
from markupsafe import Markup

from bench.reports.embedded import embed_svg
from bench.reports.figures import SYNTHETIC, Picture
from bench.values.sentences import template_environment

ROOM = files("bench.reports")
UNNAMED = re.compile(
    r'(<svg class="mark(?![^"]* named)[^"]*".*?)<text [^>]*>[^<]*</text></svg>'
)  # marks of a chart
ESCAPED = {ord(sign): f"\\{sign}" for sign in "\\`*_{}[]<>|#~"}  # in markdown


def render_page(template: str | Path, title: str, script: str = "", **values: object) -> str:
    """A template as one HTML page, with styles, script and figures; it loads nothing.

    A template of another package is a path. Only the ``script`` of this room runs: the page has its
    digest.
    """
    styles: dict[str, str] = {}
    body = Markup(
        fill_template(
            template, "html", values | {"title": title}, partial(inline_svg, styles=styles)
        )
    )
    style, code = (
        Markup(ROOM.joinpath(f).read_text(encoding="utf-8")) if f else ""
        for f in ("page.css", script)
    )
    style += Markup("".join(f".{name}{{{rule}}}" for rule, name in styles.items()))
    digest = b64encode(hashlib.sha256(code.encode()).digest()).decode() if code else ""
    return fill_template(
        "page.jinja",
        "html",
        {"title": title, "body": body, "style": style, "code": code, "digest": digest},
    )


def render_fragment(template: str, **values: object) -> str:
    """A template as a part of a page, such as a drawing."""
    return fill_template(template, "html", values)


def render_markdown(template: str, **values: object) -> str:
    """A template as markdown; figures are linked from the folder above theirs."""
    text = fill_template(template, "markdown", values)
    return re.sub(r"\n\s*\n", "\n\n", text).strip() + "\n"


def fill_template(
    template: str | Path,
    form: str,
    values: dict[str, object],
    drawing: Callable[[Picture], Markup] | None = None,
) -> str:
    """A template filled in, in one of the two forms; ``drawing`` embeds a figure."""
    path = Path(template)
    env = _load_environment(path.parent, form)
    count = itertools.count(1)
    env.filters["svg"] = drawing
    return env.get_template(path.name).render(values, form=form, next_number=lambda: next(count))


@cache  # a page has dozens of charts, and a template takes longer to read than to fill in
def _load_environment(folder: Path, form: str) -> Environment:
    env = template_environment(ROOM / "templates", folder, html=form == "html")
    env.filters |= {
        "anchor": slugify,
        "md": escape_markdown,
        "code": _format_code,
        "sentence": _join_lines,
    }
    return env


@pass_eval_context
def _join_lines(context: EvalContext, text: str) -> str:
    """Words that a template breaks into lines, as one line."""
    line = " ".join(str(text).split())
    return Markup(line) if context.autoescape and isinstance(text, Markup) else line


def slugify(text: str, most: int = 48) -> str:
    """Words for the name of a file, or of a place on the page."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:most].strip("-")


def escape_markdown(text: object) -> str:
    """Text that markdown takes as it is; a bar would end a cell, a line break the table."""
    return " ".join(str(text).split()).translate(ESCAPED)


def _format_code(text: object) -> str:
    """A command in markdown, which may hold bars and backticks."""
    line = str(text).replace("|", r"\|")
    return f"`` {line} ``" if "`" in line else f"`{line}`"


def inline_svg(picture: Picture, styles: dict[str, str]) -> Markup:
    """A drawing to embed in a page, about a third as long as its file.

    Its width is in inches, so that the page draws all of them on one scale.
    """
    text = picture.path.read_text(encoding="utf-8")
    if (
        'class="fluid"' in text[:200]
    ):  # as wide as there is room, and with a label; the script names the marks
        return Markup(UNNAMED.sub(r"\1</svg>", text).replace(' role="img" tabindex="-1"', ""))
    first, *more = picture.caption.removesuffix(".").split(". ")
    about = ". ".join([first, *(sentence for sentence in more if SYNTHETIC in sentence)])
    return Markup(embed_svg(text, f"{about}.", styles))
