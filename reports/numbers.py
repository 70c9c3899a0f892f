"""Footnotes and lists of names, as the report writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bench.comparable import MARK, MARKED
from bench.measures import Row, known
from bench.usual import BUSY

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
    designed = ours and "haart" in data.split("+")
    return [DESIGNED] * designed + [MAYBE_TWICE] * ("+" in data) + [MARKED] * system.endswith(MARK)


def busy(row: Row) -> list[str]:
    """The footnote of a run that was made on a busy machine."""
    slower = known(row.get("slowdown"))
    if slower is None or slower <= BUSY:
        return []
    return [f"measured while other programs made this machine {slower:.1f} times slower; its times are converted."]


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence; of many the first, and how many more there are."""
    kept = [*names[:most]]
    if len(names) > most:
        kept.append(f"{len(names) - most} other{'s' * (len(names) > most + 1)}")
    return kept[0] if len(kept) == 1 else f"{', '.join(kept[:-1])} and {kept[-1]}"
