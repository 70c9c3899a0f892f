"""Footnotes and lists of names, as the report writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from bench import few
from bench.comparable import notes_on
from bench.measures import Row, known
from bench.usual import BUSY


def noted(
    table: pd.DataFrame, data_of: Mapping[str, str] | None = None, people_of: Mapping[str, int] | None = None
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
        notes.append(" ".join(dict.fromkeys([*words, *(w for s in systems for w in notes_on(str(s), str(on)))])))
    return table.assign(note=notes) if any(notes) else table


def busy(row: Row) -> list[str]:
    """The footnote of a run that was made on a busy machine."""
    if (known(row.get("slowdown")) or 1) <= BUSY:
        return []
    return ["Times were measured beside other programs and are converted to those of the quiet machine."]


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence; of many the first, and how many more there are."""
    kept = [*names[:most]]
    if len(names) > most:
        kept.append(f"{len(names) - most} other{'s' * (len(names) > most + 1)}")
    return kept[0] if len(kept) == 1 else f"{', '.join(kept[:-1])} and {kept[-1]}"
