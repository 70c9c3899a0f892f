"""Footnotes of tables and figures, and lists of names in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from bench.ground.machine import BUSY_SLOWDOWN
from bench.values import few
from bench.values.measures import value_or_none
from bench.values.result import Result, Row, footnotes_of_system


def few_subjects_notes(results: Sequence[Result]) -> list[str]:
    """A sentence for each number of subjects that is too small for an interval."""
    counts = {int(r["subjects"]) for r in results if "subjects" in r}
    return [f"{few.too_few_sentence(n)}." for n in sorted(counts) if n < few.FEWEST_FOR_INTERVAL]


def busy_machine_notes(row: Row) -> list[str]:
    """The footnote of a run that was made on a busy machine; none for other runs."""
    if (value_or_none(row.get("slowdown")) or 1) <= BUSY_SLOWDOWN:
        return []
    return [
        "Times were measured beside other programs and are converted to those of the quiet machine."
    ]


def add_note_column(
    table: pd.DataFrame,
    data_of_group: Mapping[str, str] | None = None,
    people_of_group: Mapping[str, int] | None = None,
) -> pd.DataFrame:
    """A table of systems with footnotes in a column ``note``; unchanged without any."""
    names = [name for name in ("system", "other", "choice") if name in table]
    if not names or "note" in table:
        return table
    groups = table.get("group", pd.Series(index=table.index, dtype=object))
    data = table["data"] if "data" in table else groups.map(data_of_group or {})
    people = table["subjects"] if "subjects" in table else groups.map(people_of_group or {})
    notes = []
    for *systems, corpus, count in zip(*(table[name] for name in names), data, people, strict=True):
        lines = (
            [f"{few.too_few_sentence(int(count))}."] if count < few.FEWEST_FOR_TEST else []
        )  # NaN: unknown
        for system in systems:
            lines += footnotes_of_system(str(system), str(corpus))
        notes.append(" ".join(dict.fromkeys(lines)))
    return table.assign(note=notes) if any(notes) else table


def join_names(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence; of many the first, and how many more there are."""
    if not names:
        return ""
    first = [*names[:most]]
    if rest := len(names) - len(first):
        first.append(f"{rest} other{'s' * (rest > 1)}")
    return first[0] if len(first) == 1 else f"{', '.join(first[:-1])} and {first[-1]}"
