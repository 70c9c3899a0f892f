"""Sentences from Jinja templates, shared by terminal, page and Markdown."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING

from bench.values.result import format_count

# White space of values is hidden while that of templates is joined.
HIDDEN = {ord(space): 0xE000 + i for i, space in enumerate(" \t\n")}
SHOWN = {hidden: space for space, hidden in HIDDEN.items()}

if TYPE_CHECKING:
    from jinja2 import Environment


def template_environment(*folders: Traversable | Path, html: bool = False) -> Environment:
    """Load the templates of folders; a variable without a value is an error."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # not before it is needed

    environment = Environment(
        loader=FileSystemLoader([str(folder) for folder in folders]),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "several": format_count,
        "percent": lambda number: f"{number:.1f} %",
        "shortened": shorten_list,
    }
    return environment


@cache
def _package_templates(package: str) -> Environment:
    environment = template_environment(files(package) / "templates")
    environment.finalize = lambda value: str(value).translate(HIDDEN)
    return environment


def shorten_list(texts: Sequence[str], count: int) -> str:
    """Join the first texts, and say how many more there are."""
    more = f"; and {len(texts) - count} more" if len(texts) > count else ""
    return "; ".join(texts[:count]) + more


def render_sentences(package: str, template: str, block: str, **values: object) -> list[str]:
    """Render the paragraphs of a block of a template, a line each; an empty line ends one."""
    source = _package_templates(package).get_template(f"{template}.jinja")
    text = "".join(source.blocks[block](source.new_context(values)))
    paragraphs = (" ".join(part.split()) for part in re.split(r"\n\s*\n", text))
    return [paragraph.translate(SHOWN) for paragraph in paragraphs if paragraph]
