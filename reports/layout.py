"""The templates beside this file, filled in: as one HTML page that loads nothing, or as markdown.

A template such as ``report.jinja`` says what stands in which order, in macros of ``html.jinja`` or ``markdown.jinja``.
"""

from __future__ import annotations

import itertools
import re
from importlib.resources import files
from pathlib import Path

from jinja2 import pass_eval_context
from jinja2.nodes import EvalContext
from markupsafe import Markup, escape

from bench.reports.figures import SYNTHETIC, Picture
from bench.sentences import environment

ROOM = files("bench.reports")


def page(template: str | Path, title: str, **values: object) -> str:
    """A template as one HTML page: styles and figures are in it, nothing is loaded from anywhere.

    Its contents stand behind the first section, unless its sections are closed. A template of another package is a
    path.
    """
    body = _filled(template, "html", values | {"title": title})
    heads = re.findall(r'^<h2 id="(.*?)">(.*?)</h2>', body, re.MULTILINE)
    if len(heads) > 2:
        links = "".join(f'<li><a href="#{name}">{text}</a></li>' for name, text in heads)
        second = f'<h2 id="{heads[1][0]}">'
        body = body.replace(second, f'<nav aria-label="Contents"><ul>{links}</ul></nav>\n{second}', 1)
    body, classes = _classes(body)
    style = Markup(ROOM.joinpath("page.css").read_text(encoding="utf-8") + classes)
    return _filled("page.jinja", "html", {"title": title, "body": Markup(body), "style": style})


def _classes(body: str) -> tuple[str, str]:
    """A page whose figures have classes in place of styles, of which most are the same; and these classes."""
    names: dict[str, str] = {}

    def named(found: re.Match[str]) -> str:
        name = names.setdefault(found[1], f"s{len(names)}")
        return f' class="{name}"'

    body = re.sub(r'(?<=[\w"]) style="((?!fill: #ffffff")[^"]*)"', named, body)
    return body, "".join(f".{name}{{{words}}}" for words, name in names.items())


def markdown(template: str, **values: object) -> str:
    """A template as markdown; figures are linked from the folder above theirs."""
    text = _filled(template, "markdown", values)
    return re.sub(r"\n\s*\n", "\n\n", text).strip() + "\n"


def _filled(template: str | Path, form: str, values: dict[str, object]) -> str:
    """A template filled in, in one of the two forms."""
    env = environment(ROOM / "templates", Path(template).parent, html=form == "html")
    count = itertools.count(1)
    env.globals |= {"form": form, "next_number": lambda: next(count)}
    env.filters |= {"anchor": anchor, "md": md_escape, "code": _code, "svg": inline_svg}
    env.filters["sentence"] = _sentence
    return env.get_template(Path(template).name).render(values)


@pass_eval_context
def _sentence(context: EvalContext, text: str) -> str:
    """Words that a template breaks into lines, as one line."""
    line = " ".join(str(text).split())
    return Markup(line) if context.autoescape and isinstance(text, Markup) else line


def anchor(text: str) -> str:
    """A heading's id."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def md_escape(text: object) -> str:
    """Text that markdown takes as it is; a bar would end a cell, a line break the table."""
    return re.sub(r"([\\`*_{}\[\]<>|#~])", r"\\\1", " ".join(str(text).split()))


def _code(text: object) -> str:
    """A command in markdown, which may hold bars and backticks."""
    line = str(text).replace("|", r"\|")
    return f"`` {line} ``" if "`" in line else f"`{line}`"


def inline_svg(picture: Picture, number: int) -> Markup:
    """A matplotlib drawing to embed in a page: as little text as draws the same, with names of its own.

    Its width is given in inches, so that the page draws all on one scale and their text in one size.
    """
    text = picture.path.read_text(encoding="utf-8")
    text = " ".join(text[text.index("<svg") :].split())
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>| transform=\"rotate\(-0[^\"]*\"", "", text)
    text = re.sub("<[^>]*>", lambda tag: _short(tag[0]), re.sub(r"> <", "><", text))
    used = {
        name: f"f{number}-{i}" for i, name in enumerate(dict.fromkeys(re.findall(r'(?:url\(|href=")#([^)"]+)', text)))
    }
    text = re.sub(r' id="([^"]*)"', lambda m: f' id="{used[m[1]]}"' if m[1] in used else "", text)
    text = re.sub(r'(url\(|href=")#([^)"]+)', lambda m: f"{m[1]}#{used[m[2]]}", text).replace("xlink:href", "href")
    nested = 1
    while nested:
        text, nested = re.subn(r"<g>((?:(?!</?g[ >]).)*)</g>", r"\1", text)
    width = re.match(r'<svg[^>]*? width="([\d.]+)pt"', text)
    style = f' style="--inches: {float(width[1]) / 72:.2f}"' if width else ""
    first, *more = picture.caption.removesuffix(".").split(". ")
    about = ". ".join([first, *(sentence for sentence in more if SYNTHETIC in sentence)])
    label = f'<svg role="img" aria-label="{escape(about)}."{style} '
    return Markup(text.replace("<svg ", label, 1).strip())


def _short(tag: str) -> str:
    """A tag of a drawing with numbers to a tenth of a point, and without what the page says for all drawings."""
    tag = re.sub(r"(?<=\d)(?:\.0+|(\.\d)\d+)(?=[ \",)])", lambda m: (m[1] or "").removesuffix(".0"), tag)
    return re.sub(r" L(?= )| (?=\")|font-family:[^;\"]*;? ?| xmlns(?::xlink)?=\"[^\"]*\"| version=\"[^\"]*\"", "", tag)
