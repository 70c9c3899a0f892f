"""Sections of the page, a part for each set of comparable results; footnotes and lists of names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from bench.ground.words import BUSY
from bench.reading.frame import grouped
from bench.reports.figures import Picture, save
from bench.values import few
from bench.values.measures import known, text
from bench.values.result import Result, Row, notes_on, seed_number
from bench.values.table import Table

CONTEXTS = 3  # captures-and-protocol groups that are drawn
METHODS = 10  # of a context


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


def section(view: Any, results: Sequence[Result], folder: Path) -> Section | None:
    """The figure and the table of a `View`, for each set of comparable results that it holds."""
    parts = []
    drawn, caption = view.captions()
    for i, (context, members) in enumerate(contexts(results, view.alike, view.score, view.more), 1):
        figure, picture = view.drawn(members), None
        if figure is not None:
            picture = save(figure, folder, f"0-{view.key}-{i}", context, f"{context}: {drawn}")
        columns = [text("system", read=lambda r: r.method), *view.on_page(members)]
        remarks = [notes_on(r["system"], str(r["data"])) for r in members]
        sentences = scarce(members) if view.intervals else []
        parts.append(
            Part(
                picture,
                Table(columns, members, remarks=remarks),
                f"{context}: {caption}",
                sentences,
            )
        )
    heading = view.section_heading or view.heading or view.noun.capitalize() or view.key
    return Section(heading, parts, view.line) if parts else None


def contexts(
    results: Sequence[Result],
    same: Mapping[str, tuple[str, str]] | None = None,
    score: str = "accuracy",
    more: str = "",
) -> list[tuple[str, list[Result]]]:
    """At most `CONTEXTS` groups of comparable results, in words, each with its `METHODS` most accurate systems.

    Of each system it is the newest complete result of the lowest seed; one with more numbers whose names begin with
    ``more`` stands before a newer one. Comparable results share the parameters ``same``, and ``score`` orders them.
    """
    counted = lambda r: sum(name.startswith(more) for name in r.metrics) if more else 0  # noqa: E731
    complete = [r for r in results if r.complete][::-1]  # the newest first
    groups = []
    for words, runs in grouped(
        sorted(complete, key=lambda r: (seed_number(r["seed"]), -counted(r))), same
    ).items():
        first: dict[str, Result] = {}
        for r in runs:
            first.setdefault(r["system"], r)
        groups.append(
            (words, [*first.values()], any(first[r["system"]]["seed"] != r["seed"] for r in runs))
        )
    named = []
    for words, members, several in sorted(groups, key=lambda g: (g[1][0]["synthetic"], -len(g[1])))[
        :CONTEXTS
    ]:
        best = sorted(members, key=lambda r: -r[score])[:METHODS]
        left = len(members) - len(best)
        told = f", {left} less accurate systems left out" * bool(left)
        named.append((words + told + ", only the lowest seed of each system" * several, best))
    return named


def scarce(results: Sequence[Result]) -> list[str]:
    """A sentence for each number of subjects of some results that is too small for an interval."""
    people = sorted(
        {int(r["subjects"]) for r in results if r.get("subjects", few.INTERVAL) < few.INTERVAL}
    )
    return [f"{few.too_few(n)}." for n in people]


def noted(
    table: pd.DataFrame,
    data_of: Mapping[str, str] | None = None,
    people_of: Mapping[str, int] | None = None,
) -> pd.DataFrame:
    """A table of systems with footnotes in a column ``note``, also on too few subjects; as it is without any."""
    names = [name for name in ("system", "other", "choice") if name in table]
    if not names or "note" in table:
        return table
    group = table.get("group", pd.Series(index=table.index, dtype=object))
    data = table["data"] if "data" in table else group.map(data_of or {})
    people = table["subjects"] if "subjects" in table else group.map(people_of or {})
    notes = []
    for *systems, on, n in zip(*(table[name] for name in names), data, people, strict=True):
        words = [f"{few.too_few(int(n))}."] if n < few.TEST else []  # False where it is unknown
        notes.append(
            " ".join(
                dict.fromkeys([*words, *(w for s in systems for w in notes_on(str(s), str(on)))])
            )
        )
    return table.assign(note=notes) if any(notes) else table


def busy(row: Row) -> list[str]:
    """The footnote of a run that was made on a busy machine."""
    if (known(row.get("slowdown")) or 1) <= BUSY:
        return []
    return [
        "Times were measured beside other programs and are converted to those of the quiet machine."
    ]


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence; of many the first, and how many more there are."""
    kept = [*names[:most]]
    if len(names) > most:
        kept.append(f"{len(names) - most} other{'s' * (len(names) > most + 1)}")
    return kept[0] if len(kept) == 1 else f"{', '.join(kept[:-1])} and {kept[-1]}"
