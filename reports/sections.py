"""What kinds of run and circumstances show on the page, in the order of their registry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from bench.comparable import notes_on
from bench.outcomes.candidates import repeated
from bench.registry import classes
from bench.reports.part import Part, Section
from bench.result import Result
from bench.words import typed


def shown(results: Sequence[Result]) -> Iterator[tuple[Any, list[Result]]]:
    """Each kind and each circumstance that there is a result of, with these results."""
    for kind in classes("kinds").values():
        if members := [r for r in results if r.kind == kind.tag]:
            yield from kind.views(members)
            yield from kind.unseen(members)


def sections(results: Sequence[Result], folder: Path) -> list[Section]:
    """The sections of the page; figures are written into a folder."""
    every = (view.section(members, folder) for view, members in shown(results))
    return [replace(section, parts=[*map(_noted, section.parts)]) for section in every if section]


def unmeasured(results: Sequence[Result], arguments: str) -> list[tuple[str, str]]:
    """Commands that would measure what no result has, each with its summary.

    Args:
        results: results of all kinds.
        arguments: arguments of a run, as tracked, which the commands repeat.
    """
    held = {view for view, _ in shown(results)}
    made = (one for kind in classes("kinds").values() for one in kind.made_by().items())
    words = repeated(arguments, impersonal=True)
    return [(typed(name, words), spelling.command.summary) for name, (_, view, spelling) in made if view not in held]


def joined(sections: Sequence[Section]) -> list[Section]:
    """Sections with one heading as one."""
    parts: dict[str, list[Part]] = {}
    for section in sections:
        parts.setdefault(section.heading, []).extend(section.parts)
    return [Section(heading, each) for heading, each in parts.items()]


def _noted(part: Part) -> Part:
    """A part whose table of results has the footnotes of their systems."""
    if part.table is None or not all(isinstance(row, Result) for row in part.table.rows):
        return part
    remarks = [notes_on(row["system"], str(row["data"])) for row in part.table.rows]
    return replace(part, table=replace(part.table, remarks=remarks))


def briefs(results: Sequence[Result]) -> list[tuple[str, str]]:
    """Topics and sentences."""
    every = (view.brief(members) for view, members in shown(results))
    return [brief for brief in every if brief]


def sheets(results: Sequence[Result]) -> dict[str, pd.DataFrame]:
    """Tables of CSV files, by name."""
    every = {name: table for view, members in shown(results) for name, table in view.sheets(members).items()}
    return {name: table for name, table in every.items() if len(table)}
