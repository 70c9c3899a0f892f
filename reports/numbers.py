"""Numbers and names as the report writes them: percent, points, intervals, p-values; ``-`` where there is none."""

from __future__ import annotations

import re
from collections.abc import Sequence

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
    designed = ours and "haart" in data.split("+")
    return [DESIGNED] * designed + [MAYBE_TWICE] * ("+" in data) + [MARKED] * system.endswith(MARK)


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence; of many the first, and how many more there are."""
    kept = [*names[:most]]
    if len(names) > most:
        kept.append(f"{len(names) - most} other{'s' * (len(names) > most + 1)}")
    return kept[0] if len(kept) == 1 else f"{', '.join(kept[:-1])} and {kept[-1]}"


def number(value: float, digits: int = 1, sign: bool = False) -> str:
    """A number with so many decimal places, and optionally with its sign."""
    return "-" if pd.isna(value) else f"{value:{'+' * sign}.{digits}f}"


def bounded(value: float, low: float, high: float, digits: int = 1, sign: bool = False) -> str:
    """A number with its interval in brackets, if it has one."""
    ends = "" if pd.isna(low) else f" [{number(low, digits, sign)}, {number(high, digits, sign)}]"
    return number(value, digits, sign) + ends


def span(low: float, high: float) -> str:
    """The interval of a difference alone."""
    return "-" if pd.isna(low) else f"[{low:+.1f}, {high:+.1f}]"


def with_sd(value: float, sd: float, form: str = ".1f") -> str:
    """A number with its standard deviation, if it has one."""
    return "-" if pd.isna(value) else f"{value:{form}}" + ("" if pd.isna(sd) else f" ± {sd:{form}}")


def whole(value: float) -> str:
    """A whole number with spaces between the thousands."""
    return "-" if pd.isna(value) else f"{value:,.0f}".replace(",", " ")


def percent(share: float) -> str:
    """A share in percent."""
    return number(100 * share)


def p_value(value: float) -> str:
    """A p-value."""
    return "-" if pd.isna(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"
