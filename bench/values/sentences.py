"""Sentences from Jinja templates, which stand beside what they speak of; terminal, page and Markdown share them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING

from bench.values.result import format_count

HIDDEN = {
    ord(space): 0xE000 + i for i, space in enumerate(" \t\n")
}  # white space of values, which is theirs
SHOWN = {hidden: space for space, hidden in HIDDEN.items()}

if TYPE_CHECKING:
    from jinja2 import Environment


def template_environment(*folders: Traversable | Path, html: bool = False) -> Environment:
    """The templates of folders; a name that has no value is an error."""
    from jinja2 import (  # commands without sentences need not wait for it
        Environment,
        FileSystemLoader,
        StrictUndefined,
    )

    env = Environment(
        loader=FileSystemLoader([str(folder) for folder in folders]),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters |= {
        "several": format_count,
        "percent": lambda number: f"{number:.1f} %",
        "shortened": shorten_list,
    }
    return env


@cache
def _package_templates(package: str) -> Environment:
    env = template_environment(files(package) / "templates")
    env.finalize = lambda value: str(value).translate(HIDDEN)
    return env


def shorten_list(texts: Sequence[str], count: int) -> str:
    """The first texts, and how many more there are."""
    more = f"; and {len(texts) - count} more" if len(texts) > count else ""
    return "; ".join(texts[:count]) + more


def render_sentences(package: str, template: str, block: str, **values: object) -> list[str]:
    """The paragraphs of a block of a template, a line each: an empty line ends one."""
    found = _package_templates(package).get_template(f"{template}.jinja")
    text = "".join(found.blocks[block](found.new_context(values)))
    parts = (" ".join(part.split()) for part in re.split(r"\n\s*\n", text))
    return [part.translate(SHOWN) for part in parts if part]
