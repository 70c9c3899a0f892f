"""Numbers as the report writes them: percent, points and p-values; ``-`` where there is none."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pandas as pd

from bench.outcomes.comparable import MARK, MARKED

DESIGNED = (
    "The system reflex and the features touch were designed on seven of HAART's ten people, the training subjects of "
    "its challenge split. LOSO tests on these seven, too."
)


def notes_on(system: str, data: str) -> list[str]:
    """What a reader must know of a system that a table names: footnotes.

    Args:
        system: as tables name it.
        data: name of the corpus.
    """
    own = data == "haart" and re.search(r"(?<![\w.])(reflex|touch)(?![\w.])", system) is not None
    return [DESIGNED] * own + [MARKED] * system.endswith(MARK)


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence; of many the first, and how many more there are."""
    kept = [*names[:most]]
    if len(names) > most:
        kept.append(f"{len(names) - most} other{'s' * (len(names) > most + 1)}")
    return kept[0] if len(kept) == 1 else f"{', '.join(kept[:-1])} and {kept[-1]}"


def sized(features: object, n: float) -> str:
    """Features, and how many numbers they are."""
    words = features if isinstance(features, str) else "-"
    return words if pd.isna(n) else f"{words} ({n:.0f})"


def with_sd(value: float, sd: float) -> str:
    """A published number as it was printed, with its SD."""
    return "-" if pd.isna(value) else f"{value:g}" + ("" if pd.isna(sd) else f" ± {sd:g}")


def one(value: float) -> str:
    """With one decimal place."""
    return "-" if pd.isna(value) else f"{value:.1f}"


def two(value: float) -> str:
    """With two."""
    return "-" if pd.isna(value) else f"{value:.2f}"


def count(value: float) -> str:
    """A whole number."""
    return "-" if pd.isna(value) else f"{value:.0f}"


def signed(value: float) -> str:
    """With a sign."""
    return "-" if pd.isna(value) else f"{value:+.1f}"


def p_value(value: float) -> str:
    """A p-value."""
    return "-" if pd.isna(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def span(low: float, high: float) -> str:
    """An interval."""
    return "-" if pd.isna(low) else f"[{low:+.1f}, {high:+.1f}]"


def bounded(value: float, low: float, high: float, sign: bool = False, digits: int = 1) -> str:
    """A number with its interval."""
    form = f"{'+' if sign else ''}.{digits}f"
    return "-" if pd.isna(value) else f"{value:{form}}" + ("" if pd.isna(low) else f" [{low:{form}}, {high:{form}}]")
