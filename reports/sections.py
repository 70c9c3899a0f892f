"""What kinds of run and circumstances show on the page, in the order of their registry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from bench.comparable import notes_on
from bench.options import makers
from bench.outcomes.candidates import repeated
from bench.registry import views
from bench.reports.new_person import gained, new_person_section
from bench.reports.part import Part, Section
from bench.result import Result
from bench.words import typed


def shown(results: Sequence[Result]) -> Iterator[tuple[Any, list[Result]]]:
    """The view of captures, and of each study and circumstance that there is a result of, with these results."""
    for view in views().values():
        if members := [r for r in results if view.holds(r)]:
            yield view, members


def sections(results: Sequence[Result], folder: Path) -> list[Section]:
    """The sections of the page; figures are written into a folder."""
    every = [view.section(members, folder) for view, members in shown(results)]
    every.append(new_person_section([r for r in results if "protocol.shots" in r]))
    return [replace(section, parts=[*map(_noted, section.parts)]) for section in every if section]


def unmeasured(results: Sequence[Result], arguments: str) -> list[tuple[str, str]]:
    """Commands that would measure what no result has, each with its summary."""
    held = {view.key for view, _ in shown(results)}
    words = repeated(arguments, impersonal=True)
    return [(typed(name, words), one.summary) for name, one in makers().items() if one.makes not in held]


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
    every = [view.brief(members) for view, members in shown(results)]
    every.append(gained([r for r in results if "protocol.shots" in r]))
    return [brief for brief in every if brief]


def sheets(results: Sequence[Result]) -> dict[str, pd.DataFrame]:
    """Tables of CSV files, by name."""
    every = {name: table for view, members in shown(results) for name, table in view.sheets(members).items()}
    return {name: table for name, table in every.items() if len(table)}
