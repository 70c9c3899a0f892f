"""Parts of the page, as kinds of run and circumstances give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bench.reports.figures import Picture
    from bench.table import Table


@dataclass(frozen=True)
class Part:
    """A figure, a table with its caption, and sentences on one set of comparable runs; each may be absent."""

    picture: Picture | None = None
    table: Table | None = None
    caption: str = ""
    sentences: Sequence[str] = ()


@dataclass(frozen=True)
class Section:
    """A section of the page; those with one heading are shown as one."""

    heading: str
    parts: list[Part] = field(default_factory=list)
    line: str = ""  # beside the heading, while the section is closed
