"""Footnotes and lists of names, as the report writes them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import pandas as pd

from bench.comparable import MARK, MARKED

DESIGNED = (
    "The systems reflex, touchnet and rocket and the features touch were designed on seven of HAART's ten people, the "
    "training subjects of its challenge split. LOSO tests on these seven, too."
)
MAYBE_TWICE = "Whether a person is in more than one of the joined corpora is unknown; each counts as another."


def notes_on(system: str, data: str) -> list[str]:
    """The footnotes of a system that a table names.

    Args:
        system: system name as in tables.
        data: name of the corpus.
    """
    ours = re.search(r"(?<![\w.])(reflex|rocket|touch|touchnet)(?![\w.])", system) is not None
    designed = ours and any(part.split("-")[0] == "haart" for part in data.split("+"))
    return [DESIGNED] * designed + [MAYBE_TWICE] * ("+" in data) + [MARKED] * system.endswith(MARK)


def noted(table: pd.DataFrame, data_of: Mapping[str, str] | None = None) -> pd.DataFrame:
    """A table of systems with their footnotes in a column ``note``; the same where none of them has any.

    Args:
        table: a table, with ``system`` (and ``other``, or ``choice``) and the corpus in ``data``, or else ``group``.
        data_of: corpus by group.
    """
    names = [name for name in ("system", "other", "choice") if name in table]
    data = table["data"] if "data" in table else table.get("group", pd.Series(index=table.index)).map(data_of or {})
    every = zip(*(table[name] for name in names), data, strict=True) if names and "note" not in table else ()
    notes = [" ".join(dict.fromkeys(n for s in systems for n in notes_on(str(s), str(on)))) for *systems, on in every]
    return table.assign(note=notes) if any(notes) else table


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence; of many the first, and how many more there are."""
    kept = [*names[:most]]
    if len(names) > most:
        kept.append(f"{len(names) - most} other{'s' * (len(names) > most + 1)}")
    return kept[0] if len(kept) == 1 else f"{', '.join(kept[:-1])} and {kept[-1]}"
